"""Run the service in the foreground: start its processes, show what they say, end them cleanly."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, Protocol

from companion.cli.terminal.progress import say
from companion.cli.terminal.status_view import View, console
from companion.cli.terminal.waiting import RepeatPause
from companion.errors import DeviceError
from companion.records import Record

_DRAW_S = 0.25  # chosen: four times a second reads as steady
_LINE_S = 5.0  # chosen: a log that is read later stays short


class RunningService(Protocol):
    """A service that runs: the live one's processes, or the one in lock-step with its vehicle."""

    def shown(self) -> list[Record]:
        """Records for the display since the last call."""
        ...

    def tend(self) -> list[str]:
        """Look after what runs; sentences of what had to be done."""
        ...

    def failed(self) -> list[str]:
        """Names of the processes that fail again and again, which end the service."""
        ...

    def __enter__(self) -> object:
        """Start it."""
        ...

    def __exit__(self, *_: object) -> None:
        """End it."""
        ...


def run_service(
    service: RunningService,
    view: View,
    ended: Callable[[], bool],
    *,
    live: bool,
    each: Callable[[Record], None] | None = None,
    wait: Callable[[float], None] = time.sleep,
) -> None:
    """Run until ``ended`` says so; show a live view, or a line every few seconds where there is no terminal.

    What is waited for is a line when it changes, and again in growing pauses.

    ``wait`` lets some seconds pass between two looks.

    Raises
    ------
    DeviceError
        A process of the service died again and again.
    """
    began = time.monotonic()
    with service, _screen() if live else _Lines() as screen:
        pause = RepeatPause(_LINE_S)
        while not ended():
            _collect(service, view, each)
            elapsed_s = time.monotonic() - began
            if not live:
                _print(view.sentences(), elapsed_s)
            if service.failed():
                raise DeviceError(f"process {', '.join(service.failed())} keeps dying; its messages are above")
            if live:
                screen.update(view.render(elapsed_s))
            elif pause.due(elapsed_s, view.waiting(elapsed_s)):
                refused = view.refusals()
                _print([] if refused is None else [refused], elapsed_s)
                say(view.line(elapsed_s))
            wait(_DRAW_S)


def _collect(service: RunningService, view: View, each: Callable[[Record], None] | None) -> None:
    """Take what the service shows, and what it had to do."""
    for record in service.shown():
        view.take(record)
        if each is not None:
            each(record)
    for sentence in service.tend():
        view.say(sentence, here=True)


def _screen() -> Any:
    from rich.live import Live  # an extra; plain lines do without

    return Live(console=console(), refresh_per_second=1 / _DRAW_S, transient=True)


def _print(sentences: list[str], elapsed_s: float) -> None:
    for sentence in sentences:
        say(f"{elapsed_s:6.1f} s  {sentence}")


class _Lines:
    """Stands in for the live screen where output goes to a file or a pipe."""

    def __enter__(self) -> _Lines:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def update(self, _: object) -> None:
        """Nothing: lines are printed by the loop."""

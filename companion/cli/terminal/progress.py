"""How far a long command has come, on standard error: one line that is rewritten, or a line every few seconds."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable

from companion.adapters.recordings.logs.tlog import TlogRecording
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.recording import Recording

_LIVE_S = 0.25  # chosen: four times a second reads as steady
_LINE_S = 5.0  # chosen: a log that is read later stays short


def say(sentence: str) -> None:
    """Print a sentence on standard error, at once; where it cannot be written (a full disk, a closed pipe), go on."""
    with contextlib.suppress(OSError):
        print(sentence, file=sys.stderr, flush=True)


class Progress:
    """Feed :meth:`at` as the recording goes by.

    ``length_ns`` is of the whole recording; where it is unknown, ``read_share`` gives the share of the file that has
    been read, 0 to 1, and without both no percentage is shown. ``plain`` prints a line every five seconds, wherever
    standard error goes; otherwise nothing is shown but on a terminal.
    """

    def __init__(
        self, what: str, length_ns: int | None, *, plain: bool, read_share: Callable[[], float] | None = None
    ) -> None:
        self._what, self._length_ns, self._plain, self._read_share = what, length_ns, plain, read_share
        self._shown = plain or sys.stderr.isatty()
        self._every_s = _LINE_S if plain else _LIVE_S
        self._began_s = self._last_s = time.monotonic()
        self._first_ns: int | None = None

    def at(self, now_ns: int) -> None:
        """Say where the recording stands, if it is time to."""
        if self._first_ns is None:
            self._first_ns = now_ns
        if not self._shown or time.monotonic() - self._last_s < self._every_s:
            return
        self._last_s = time.monotonic()
        line = self._line((now_ns - self._first_ns) * 1e-9, self._last_s - self._began_s)
        print(
            line if self._plain else f"\r\033[K{line}", end="\n" if self._plain else "\r", file=sys.stderr, flush=True
        )

    def close(self) -> None:
        """Wipe the rewritten line."""
        if self._shown and not self._plain:
            print("\r\033[K", end="", file=sys.stderr, flush=True)

    def _line(self, done_s: float, took_s: float) -> str:
        fraction = self._fraction(done_s)
        percentage = "" if fraction is None else f"{100.0 * min(1.0, fraction):3.0f} %, "
        return f"{self._what} {percentage}{done_s:.0f} s of flight in {took_s:.0f} s"

    def _fraction(self, done_s: float) -> float | None:
        if self._length_ns:
            return done_s / (1e-9 * self._length_ns)
        return None if self._read_share is None else self._read_share()


def progress_of(recording: Recording, what: str, *, plain: bool) -> Progress:
    """Progress by time where the recording's length is known beforehand, by bytes where only the file's is."""
    by_bytes = (lambda: recording.read_share) if isinstance(recording, TlogRecording) else None
    return Progress(what, length_ns(recording), plain=plain, read_share=by_bytes)


def length_ns(recording: Recording) -> int | None:
    """How much time a recording covers, where its reader knows before it is read."""
    if isinstance(recording, McapRecording):
        first_ns, last_ns = recording.span_ns()
        return last_ns - first_ns or None
    streams = [stream for stream in getattr(recording, "streams", ()) if stream.t_ns.size]
    if not streams:
        return None
    return int(max(stream.t_ns[-1] for stream in streams) - min(stream.t_ns[0] for stream in streams))

"""The option ``--live`` of several commands, and the live view of a command that runs in one process."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from companion.cli.steps.options import state_file
from companion.cli.terminal.progress import say
from companion.live.about import INTERRUPTIONS
from companion.live.broadcaster import require_live
from companion.live.config import DEFAULT_ADDRESS, LiveConfig, live_config
from companion.live.door import listen
from companion.live.session import LiveSession, Subject


def add_live(parser: argparse.ArgumentParser) -> None:
    """``--live [HOST:PORT]``."""
    parser.add_argument(
        "--live", nargs="?", const=DEFAULT_ADDRESS, metavar="HOST:PORT",
        help=f"serve the live view for browsers, Foxglove and Lichtblick (default {DEFAULT_ADDRESS}); "
        "beyond this machine with a token",
    )  # fmt: skip


def read_live(options: argparse.Namespace, recording: Path | None) -> LiveConfig | None:
    """The live view that the options ask for, None where they do not; says its address."""
    if options.live is None:
        return None
    require_live()
    folder = state_file("recordings") if recording is None else recording.resolve().parent
    config = live_config(options.live, folder, state_file("live-token"))
    listen(config).close()  # a taken port is told before an address that nobody serves
    say_where(config)
    return config


def say_where(config: LiveConfig) -> None:
    """Print every address that opens the page, and where the token is kept if they have it."""
    say(f"live view: {f'{chr(10)}           '.join(config.urls)}")
    if not config.is_loopback:
        say(f"           (the token is in {config.token_place})")


@contextmanager
def live_session(config: LiveConfig | None, subject: Subject) -> Iterator[LiveSession | None]:
    """Serve the live view from this process meanwhile."""
    if config is None:
        yield None
        return
    with listen(config) as listening:
        session = LiveSession(config, subject, listening)
        try:
            yield session
            session.end()
        finally:
            session.end(INTERRUPTIONS[subject.kind])
            session.close()

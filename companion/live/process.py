"""The live process: takes what the producers' feeds let through, and serves it; niced, and missed by nobody."""

from __future__ import annotations

import os
import selectors
import socket
from collections.abc import Callable, Sequence

from companion.adapters.recordings.mcap.recorder_client import RecorderReceiver
from companion.live.config import LiveConfig
from companion.live.session import LiveSession, Subject

_NICENESS = 10  # of 19: behind everything that flies (choice)
_TURN_S = 0.1  # chosen: a wish of the page is met at once to the eye


def serve_live(
    config: LiveConfig,
    subject: Subject,
    listening: socket.socket,
    ends: Sequence[socket.socket],
    stopped: Callable[[], bool],
) -> None:
    """Serve until ``stopped`` says so; a process target.

    ``listening`` is the bound socket of the door; it outlives this process, so that a restarted one has the same
    address. ``ends`` are the receiving ends of the producers' feeds.
    """
    os.nice(_NICENESS)
    session = LiveSession(config, subject, listening)
    try:
        with selectors.DefaultSelector() as selector:
            for end in ends:
                selector.register(RecorderReceiver(end), selectors.EVENT_READ)
            while not stopped():
                _run_once(session, selector)
        session.end()  # not where an error ends it: then this process is started again
    finally:
        session.close()


def _run_once(session: LiveSession, selector: selectors.BaseSelector) -> None:
    """Publish what has come, and tend."""
    for key, _ in selector.select(_TURN_S):
        receiver = key.fileobj
        assert isinstance(receiver, RecorderReceiver)
        batch = receiver.receive()
        for record in () if batch is None else batch.records:
            session.publish(record)
    session.tend()

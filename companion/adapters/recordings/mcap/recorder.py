"""The recorder process: writes the batches of every producer to one MCAP file, so that a slow disk stalls nobody."""

from __future__ import annotations

import multiprocessing
import selectors
import signal
import socket
import time
from collections.abc import Callable, Sequence
from multiprocessing.synchronize import Event
from pathlib import Path

from companion.adapters.recordings.mcap.channels import Recordable
from companion.adapters.recordings.mcap.recorder_client import Batch, RecorderClient, RecorderReceiver, recorder_channel
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.errors import RecordingError

_IDLE_S = 0.25
_IDLE_ROUNDS = 4  # waits without a record before the recorder ends
_TRY_AGAIN_S = 30.0
_JOIN_S = 10.0


def run_recorder(path: Path, about: About, ends: Sequence[socket.socket], stop: Event | None = None) -> None:
    """Record until every producer has ended, or ``stop`` is set and nothing came for a second; a process target.

    The file is cut into chunks of about a second and handed to the operating system with each, or when nothing comes.
    SIGINT is ignored (Ctrl-C reaches the whole group, and the producers still have to end); SIGTERM finishes the file
    with what has arrived. If the path is taken (by this recorder before it was started again), a number is put into
    the name.

    Raises
    ------
    RecordingError
        The file cannot be written; one without records does not stay.
    """
    terminated = _on_terminate()
    with _listening(ends) as selector:
        _write_file(path, about, selector, stop, terminated)


def keep_recording(
    path: Path, about: About, ends: Sequence[socket.socket], say: Callable[[str], object], stop: Event | None = None
) -> None:
    """As :func:`run_recorder`, for a service that flies on when its disk is full.

    ``say`` is told why nothing is recorded; what comes is thrown away, and every half minute a file is tried again.
    """
    terminated = _on_terminate()
    with _listening(ends) as selector:
        while selector.get_map():
            try:
                _write_file(path, about, selector, stop, terminated)
                return
            except RecordingError as error:
                say(f"not recording: {error}")
            if _discard(selector, stop, terminated):
                return


def _on_terminate() -> list[int]:
    """Leave Ctrl-C to the producers; the list is filled by SIGTERM."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    terminated: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: terminated.append(number))
    return terminated


def _listening(ends: Sequence[socket.socket]) -> selectors.BaseSelector:
    selector = selectors.DefaultSelector()
    for outlet in map(RecorderReceiver, ends):
        selector.register(outlet, selectors.EVENT_READ)
    return selector


def _write_file(
    path: Path, about: About, selector: selectors.BaseSelector, stop: Event | None, terminated: Sequence[int]
) -> None:
    writer = McapWriter(free_path(path), about)
    try:
        _record(writer, selector, stop, terminated)
        writer.close()
    except OSError as error:
        writer.abandon()
        raise RecordingError(f"{path}: cannot be written any further: {error.strerror}") from error


def _discard(selector: selectors.BaseSelector, stop: Event | None, terminated: Sequence[int]) -> bool:
    """Throw away what comes, so that nobody waits, until it is time to try again (False) or all is over (True)."""
    again_s = time.monotonic() + _TRY_AGAIN_S
    while time.monotonic() < again_s:
        for key, _ in selector.select(_IDLE_S):
            _take(selector, key.fileobj)
        if terminated or not selector.get_map() or (stop is not None and stop.is_set()):
            return True
    return False


def _take(selector: selectors.BaseSelector, outlet: object) -> Batch | None:
    """Take one packet; give the batch that it completes, and listen no more to a producer that has ended."""
    assert isinstance(outlet, RecorderReceiver)
    batch = outlet.receive()
    if batch is not None and batch.last:
        selector.unregister(outlet)
    return batch


def _record(
    writer: McapWriter, selector: selectors.BaseSelector, stop: Event | None, terminated: Sequence[int]
) -> None:
    idle_rounds = 0
    while selector.get_map():
        ready = selector.select(0.0 if terminated else _IDLE_S)
        idle_rounds = 0 if ready else idle_rounds + 1
        if not ready:
            writer.flush()
            if terminated or (stop is not None and stop.is_set() and idle_rounds >= _IDLE_ROUNDS):
                return
        for key, _ in ready:
            batch = _take(selector, key.fileobj)
            if batch is not None:
                _write(writer, batch)


def _write(writer: McapWriter, batch: Batch) -> None:
    if batch.dropped:
        writer.note_drops(batch.dropped)  # first: what was dropped may have been between the records of this batch
    for record in batch.records:
        writer.write(record)


def free_path(path: Path) -> Path:
    """The path itself, or ``name.2.mcap``, ``name.3.mcap`` and so on where files are already."""
    number, free = 1, path
    while free.exists():
        number += 1
        free = path.with_name(f"{path.stem}.{number}{path.suffix}")
    return free


class ProcessRecorder:
    """A recorder port with a recorder process of its own, for a single producer.

    Raises
    ------
    RecordingError
        The file cannot be created here and now.
    """

    def __init__(self, path: Path, about: About, capacity_bytes: int = 64 << 20) -> None:
        if not path.parent.is_dir():
            raise RecordingError(f"{path}: cannot be written: no folder {path.parent}")
        own_end, theirs = recorder_channel()
        spawn = multiprocessing.get_context("spawn")
        self._process = spawn.Process(target=run_recorder, args=(path, about, [theirs]), name="spanwise-recorder")
        self._process.start()
        theirs.close()
        self._client = RecorderClient(own_end, capacity_bytes)

    @property
    def dropped(self) -> int:
        """Records that will never be in the file."""
        return self._client.dropped

    @property
    def alive(self) -> bool:
        """Whether the recorder process runs."""
        return self._process.is_alive()

    def write(self, record: Recordable) -> None:
        """Append one record, or drop and count it; never blocks."""
        self._client.write(record)

    def close(self) -> None:
        """Wait until everything is in the file and the file is finished."""
        self._client.close()
        self._process.join(_JOIN_S)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join()

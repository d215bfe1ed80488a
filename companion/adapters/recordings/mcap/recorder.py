"""The recorder process: writes the batches of every producer to one MCAP file, so that a slow disk stalls nobody."""

from __future__ import annotations

import dataclasses
import selectors
import signal
import socket
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from companion.adapters.recordings.mcap.recorder_client import Batch, RecorderReceiver
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.errors import RecordingError
from companion.lifetime import SharedCount, StopFlag
from companion.numbered_files import free_path, remove_oldest

_IDLE_S = 0.25  # chosen: how late the recorder sees that it is to end
_IDLE_ROUNDS = 4  # waits without a record before the recorder ends (choice)
_TRY_AGAIN_S = 30.0  # chosen: a full disk is looked at twice a minute
_PARTS = 4  # of what is kept: three finished ones and the one in progress (choice)


def keep_recording(
    path: Path,
    about: About,
    ends: Sequence[socket.socket],
    say: Callable[[str], object],
    stop: StopFlag | None = None,
    keep_bytes: int | None = None,
    parts: SharedCount | None = None,
) -> None:
    """Record until every producer has ended, or ``stop`` is set and nothing came for a second; a process target.

    The file is cut into chunks of about a second and handed to the operating system with each, or when nothing comes;
    once a second it is forced to the disk, so that a power cut costs some two seconds.
    SIGINT and SIGHUP are ignored (they reach the whole group, and the producers still have to end); SIGTERM
    finishes the file with what has arrived. If the path is taken (by this recorder before it was started again), a
    number is put into the name. Where the disk is full or read only, ``say`` is told so; what comes is thrown away,
    and every half minute a file is tried again: the service flies on.
    With ``keep_bytes`` all recordings of this name together stay within it: a file that has reached a quarter of it is
    finished and followed by a further part, and the oldest ones are removed. ``parts`` counts them for a recorder that
    may be started again.
    """
    parts = parts or SharedCount()
    part_bytes = None if keep_bytes is None else keep_bytes // _PARTS
    with selectors.DefaultSelector() as selector:
        producers = _Producers(selector, ends, stop)
        while not producers.have_ended:
            try:
                if keep_bytes is not None and part_bytes is not None:
                    remove_oldest(path, keep_bytes - part_bytes)
                if _write_file(path, dataclasses.replace(about, part_number=parts.next()), producers, part_bytes):
                    return
            except (RecordingError, OSError) as error:
                what = f"{path}: {error.strerror}" if isinstance(error, OSError) else error
                say(f"not recording: {what}")
                if _discard(producers):
                    return


class _Producers:
    """Producers that have not ended yet, and whether the recorder is told to end."""

    def __init__(self, selector: selectors.BaseSelector, ends: Sequence[socket.socket], stop: StopFlag | None) -> None:
        self._selector, self._stop = selector, stop
        self._terminated = _on_terminate()
        for receiver in map(RecorderReceiver, ends):
            selector.register(receiver, selectors.EVENT_READ)

    @property
    def terminated(self) -> bool:
        """Whether SIGTERM came."""
        return bool(self._terminated)

    @property
    def have_ended(self) -> bool:
        """Whether nothing more can come."""
        return not self._selector.get_map()

    @property
    def are_stopped(self) -> bool:
        """Whether the service ends, or SIGTERM came."""
        return self.terminated or (self._stop is not None and self._stop.is_set())

    def receive(self, timeout_s: float) -> list[Batch | None]:
        """Take a packet of each that has sent within the timeout; None in the place of one that completes no batch."""
        batches = []
        for key, _ in self._selector.select(timeout_s):
            assert isinstance(key.fileobj, RecorderReceiver)
            batch = key.fileobj.receive()
            if batch is not None and batch.last:
                self._selector.unregister(key.fileobj)
            batches.append(batch)
        return batches


def _on_terminate() -> list[int]:
    """Leave Ctrl-C and a closed terminal to the producers; the list is filled by SIGTERM."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    terminated: list[int] = []
    signal.signal(signal.SIGTERM, lambda number, _: terminated.append(number))
    return terminated


def _write_file(path: Path, about: About, producers: _Producers, most_bytes: int | None) -> bool:
    """Write one file to its end; False where it has reached its size and a further part is due."""
    writer = McapWriter(free_path(path), about)
    try:
        over = _record(writer, producers, most_bytes)
        writer.close(sync=True)
    except OSError as error:
        writer.abandon()
        raise RecordingError(f"{path}: cannot be written any further: {error.strerror}") from error
    return over


def _discard(producers: _Producers) -> bool:
    """Throw away what comes, so that nobody waits, until it is time to try again (False) or all is over (True)."""
    again_s = time.monotonic() + _TRY_AGAIN_S
    while time.monotonic() < again_s:
        producers.receive(_IDLE_S)
        if producers.have_ended or producers.are_stopped:
            return True
    return False


def _record(writer: McapWriter, producers: _Producers, most_bytes: int | None) -> bool:
    """Write what comes until all is over (True), or the file has reached its size (False)."""
    idle_rounds = 0
    while not producers.have_ended:
        if most_bytes is not None and writer.size_bytes >= most_bytes:
            return False
        batches = producers.receive(0.0 if producers.terminated else _IDLE_S)
        idle_rounds = 0 if batches else idle_rounds + 1
        if not batches:
            writer.flush()
            if producers.terminated or (producers.are_stopped and idle_rounds >= _IDLE_ROUNDS):
                return True
        for batch in batches:
            if batch is not None:
                _write(writer, batch)
        if not producers.are_stopped:  # the file is synced once more when it is whole
            writer.keep_synced()
    return True


def _write(writer: McapWriter, batch: Batch) -> None:
    if batch.dropped:
        writer.note_drops(batch.dropped)  # first: what was dropped may have been between the records of this batch
    for record in batch.records:
        writer.write(record)

"""Writes telemetry logs: the frames of recorded link bytes, each behind its receive time, as MAVProxy writes them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from companion.adapters.mavlink.link.dialect import build_message
from companion.adapters.mavlink.link.scan import Scanner, sender, split_frames
from companion.adapters.recordings.logs.tlog import EARLIEST_US
from companion.records import RawChunk

_SYSTEM_TIME = 2  # message id (MAVLink common)


def utc_offset_ns(chunks: Iterable[RawChunk]) -> int | None:
    """Nanoseconds from the host clock to UTC by the first SYSTEM_TIME with a date; None where none has one."""
    scanners: dict[int, Scanner] = {}
    for chunk in chunks:
        for key, payload in scanners.setdefault(chunk.link, Scanner()).scan(chunk.data).frames:
            if sender(key)[2] == _SYSTEM_TIME:
                message: Any = build_message(_SYSTEM_TIME, payload)
                if message.time_unix_usec >= EARLIEST_US:
                    return int(message.time_unix_usec) * 1000 - chunk.received_host_ns
    return None


def write_tlog(path: Path, chunks: Iterable[RawChunk], offset_ns: int) -> int:
    """Write every whole frame of the chunks, in arrival order; give their number.

    The chunks may be of any number of links, and a frame may lie across chunks of one link. ``offset_ns`` is added to
    the host time of a frame's last byte to give its receive time, UTC.
    """
    count = 0
    with path.open("wb") as file:
        for host_ns, frame in _frames(chunks):
            file.write(((host_ns + offset_ns) // 1000).to_bytes(8, "big") + frame)
            count += 1
    return count


def _frames(chunks: Iterable[RawChunk]) -> Iterator[tuple[int, bytes]]:
    unfinished: dict[int, bytes] = {}
    for chunk in chunks:
        pieces, unfinished[chunk.link] = split_frames(unfinished.get(chunk.link, b"") + chunk.data)
        for piece, is_frame in pieces:
            if is_frame:
                yield chunk.received_host_ns, piece

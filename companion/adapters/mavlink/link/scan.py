"""Finds MAVLink frames in bulk: header scan, CRC of every known message id, one byte forward on failure.

pymavlink's parser makes an object of every message, which costs several times this scan at sensor rates
(``python -m tools.bench decode``); tests hold both to the same frames. The scan exists twice: the compiled one of
:mod:`companion.adapters.mavlink.decode.bulk` reads samples as it goes, the one here gives frames alone.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from fastcrc.crc16 import mcrf4xx

from companion.adapters.mavlink.decode.bulk import BulkDecoder, SampleRun, next_frame
from companion.adapters.mavlink.link.dialect import CRC_EXTRA, payload_size

MAGIC_1, MAGIC_2 = 0xFE, 0xFD  # first byte of a MAVLink 1 and 2 frame
_HEADER_1, _HEADER_2 = 6, 10  # bytes of the header (MAVLink serialization)
SIGNED = 0x01  # incompatibility flag (MAVLink serialization)
_SIGNATURE_BYTES = 13  # link id, timestamp, signature (MAVLink signing)
_SHORTEST_2 = _HEADER_2 + 2  # header and checksum (derived)
# where a frame may begin; the last bytes of a chunk may begin one whose header is not there yet
_CANDIDATE = re.compile(rb"\xfe|\xfd(?=.[\x00\x01]|.{0,8}\Z)", re.DOTALL)
_LAST_BYTE: tuple[int, ...] = tuple(mcrf4xx(bytes([byte]), 0) for byte in range(256))
_EXTRA_OF = {identity.to_bytes(3, "little"): extra for identity, extra in CRC_EXTRA.items()}
# of MAVLink 1, which has no extensions: what is longer is no frame, and its checksum is not worth the time; -1: unknown
_LONGEST = tuple(payload_size(identity) if identity in CRC_EXTRA else -1 for identity in range(256))
_EXTRA_1 = tuple(CRC_EXTRA.get(identity, 0) for identity in range(256))
_LARGEST_1 = _HEADER_1 + 255 + 2  # header, 255 bytes of payload, checksum (derived)
INCOMPLETE, NO_FRAME, UNKNOWN, DAMAGED = -1, -2, -3, -4  # in the place of a frame's end (convention)

Frame = tuple[int, bytes]
"""Sender and message id of a frame, see :func:`sender`, and its payload."""


def sender(key: int) -> tuple[int, int, int]:
    """System, component and message id of a frame's key."""
    return key & 0xFF, key >> 8 & 0xFF, key >> 16


def sender_of(frame: bytes) -> tuple[int, int, int]:
    """System, component and message id of a whole frame."""
    if frame[0] == MAGIC_2:
        return frame[5], frame[6], int.from_bytes(frame[7:10], "little")
    return frame[3], frame[4], frame[5]


@dataclass(slots=True)
class ScanCounters:
    """Counts of one link's scanner since it was made."""

    frames: int = 0
    crc_errors: int = 0
    unknown: int = 0
    skipped_bytes: int = 0


@dataclass(slots=True)
class ScanResult:
    """Frames of some bytes in arrival order, and apart from them the samples that were read in bulk."""

    frames: list[Frame] = field(default_factory=list)
    runs: list[SampleRun] = field(default_factory=list)


class Scanner:
    """The scanner of one link. A partial frame at the end of a chunk (less than 280 bytes) waits for the next one.

    A frame is a magic byte with a known message id, no incompatible flag but signing, and the right checksum. Where one
    of these fails, the scan goes one byte forward, so a frame behind a damaged or unknown one is never lost; an unknown
    id cannot be checked and is stepped over the same way. Signatures are skipped, not verified.

    ``bulk`` is the compiled scan, where samples are to be read in bulk.
    """

    def __init__(self, bulk: BulkDecoder | None = None) -> None:
        self.counters = ScanCounters()
        self._bulk = bulk
        self._tail = b""

    def forget(self) -> None:
        """Drop the bytes of an unfinished frame."""
        self._tail = b""

    def scan(self, data: bytes, system: int | None = None) -> ScanResult:
        """Find the frames of the next bytes of this link; ``system`` is the one whose samples are read in bulk."""
        buffer = self._tail + data if self._tail else data
        result = ScanResult()
        if self._bulk is None:
            position = self._walk(buffer, result.frames)
        else:
            position, counted, result.runs = self._bulk.scan(buffer, system, result.frames)
            counters = self.counters
            counters.frames += counted[0]
            counters.crc_errors += counted[1]
            counters.unknown += counted[2]
            counters.skipped_bytes += counted[3]
        self._tail = buffer[position:]
        return result

    def _walk(self, buffer: bytes, frames: list[Frame]) -> int:
        """Append the frames; give the position of the first byte that has to wait."""
        extra_of, crc, last_byte, keep = _EXTRA_OF.get, mcrf4xx, _LAST_BYTE, frames.append
        number = int.from_bytes
        position, end, before = 0, len(buffer), len(frames)
        last_start = end - _SHORTEST_2
        while position < end:
            if position <= last_start and buffer[position] == MAGIC_2 and not buffer[position + 2]:
                extra = extra_of(buffer[position + 7 : position + 10])
                stop = position + _HEADER_2 + buffer[position + 1]
                if extra is not None and stop + 2 <= end:
                    state = crc(buffer[position + 1 : stop])
                    if (state >> 8) ^ last_byte[(state & 255) ^ extra] == buffer[stop] | buffer[stop + 1] << 8:
                        keep((number(buffer[position + 5 : position + 10], "little"), buffer[position + 10 : stop]))
                        position = stop + 2
                        continue
            position, waits = self._careful(buffer, position, end, frames)
            if waits:
                break
        self.counters.frames += len(frames) - before
        return position

    def _careful(self, buffer: bytes, start: int, end: int, frames: list[Frame]) -> tuple[int, bool]:
        """Give the place behind the next frame, or the first byte that has to wait and True."""
        counters, search, longest_of, at = self.counters, _CANDIDATE.search, _LONGEST, start
        crc, last_byte, extra_of, last_1 = mcrf4xx, _LAST_BYTE, _EXTRA_1, end - _LARGEST_1
        while at < end:
            if buffer[at] == MAGIC_1 and at <= last_1:  # a flood of these is the dearest: frame_end, here
                size, identity = buffer[at + 1], buffer[at + 5]
                longest = longest_of[identity]
                if size > longest:
                    counters.unknown += longest < 0
                    counters.crc_errors += longest >= 0
                    at += 1
                    if buffer[at] != MAGIC_1:
                        candidate = search(buffer, at)
                        at = candidate.start() if candidate else end
                    continue
                stop = at + _HEADER_1 + size
                state = crc(buffer[at + 1 : stop])
                if state >> 8 ^ last_byte[state & 255 ^ extra_of[identity]] != buffer[stop] | buffer[stop + 1] << 8:
                    counters.crc_errors += 1
                    candidate = search(buffer, at + 1)
                    at = candidate.start() if candidate else end
                    continue
            after = frame_end(buffer, at)
            if after > 0 or after == INCOMPLETE:
                break
            counters.unknown += after == UNKNOWN
            counters.crc_errors += after == DAMAGED
            candidate = search(buffer, at + 1)
            at = candidate.start() if candidate else end
        counters.skipped_bytes += at - start
        if at == end:
            return end, False
        if after == INCOMPLETE:
            return at, True
        first, key = (at + _HEADER_2, at + 5) if buffer[at] == MAGIC_2 else (at + _HEADER_1, at + 3)
        frames.append((int.from_bytes(buffer[key:first], "little"), buffer[first : first + buffer[at + 1]]))
        return after, False


def split_frames(buffer: bytes) -> tuple[list[tuple[bytes, bool]], bytes]:
    """Pieces of a buffer in their order, and the incomplete frame at its end; a piece is one frame (True), or none."""
    pieces: list[tuple[bytes, bool]] = []
    at, end = 0, len(buffer)
    while at < end:
        after = frame_end(buffer, at)
        if after == INCOMPLETE:
            break
        is_frame = after > 0
        if not is_frame:
            after = next_frame(buffer, at + 1)
        pieces.append((buffer[at:after], is_frame))
        at = after
    return pieces, buffer[at:]


def frame_end(buffer: bytes, start: int) -> int:
    """Where the frame that begins at ``start`` ends, or why none does: one of the four negative words."""
    end, magic, longest = len(buffer), buffer[start], 0
    if magic == MAGIC_2:
        first = start + _HEADER_2
        if first > end:
            return INCOMPLETE
        flags = buffer[start + 2]
        if flags & ~SIGNED:
            return NO_FRAME
        extra = _EXTRA_OF.get(buffer[start + 7 : first])
        if extra is None:
            return UNKNOWN
    elif magic == MAGIC_1:
        first, flags = start + _HEADER_1, 0
        if first > end:
            return INCOMPLETE
        longest = _LONGEST[buffer[start + 5]]
        if longest < 0:
            return UNKNOWN
        extra = CRC_EXTRA[buffer[start + 5]]
    else:
        return NO_FRAME
    stop = first + buffer[start + 1]
    after = stop + 2 + (_SIGNATURE_BYTES if flags else 0)
    if after > end:
        return INCOMPLETE
    if magic == MAGIC_1 and buffer[start + 1] > longest:
        return DAMAGED
    state = mcrf4xx(buffer[start + 1 : stop])
    intact = (state >> 8) ^ _LAST_BYTE[(state & 255) ^ extra] == buffer[stop] | buffer[stop + 1] << 8
    return after if intact else DAMAGED

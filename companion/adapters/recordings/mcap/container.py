"""An MCAP file as a sequence of top-level records, whole or cut off (https://mcap.dev/spec)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import zstandard
from mcap import records as mcap
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import CRCValidationError, breakup_chunk

from companion.errors import RecordingError

MAGIC = b"\x89MCAP0\r\n"
"""The first bytes of a file (MCAP specification)."""
_HEAD = 9  # bytes: opcode and length of a record (MCAP specification)
_INDEXED_OPCODES = frozenset((Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK, Opcode.METADATA, Opcode.ATTACHMENT))
_MOST_CHUNK_BYTES = 1 << 28  # bound of memory: our own recorder's chunks have 4 MiB, others' some more
LONGEST_CHUNK_S = 60.0
"""Beyond, a chunk's times are damaged: the recorder ends one about every second (choice)."""
DAMAGE = (
    McapError,
    CRCValidationError,
    struct.error,
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    OverflowError,
    RecursionError,
    zstandard.ZstdError,
    RuntimeError,
)
"""Errors that damaged bytes lead to."""
TIME_SPAN = struct.Struct("<QQ")
"""The first fields of a chunk: its first and last time, ns."""


@dataclass(frozen=True, slots=True)
class FileSegment:
    """One top-level MCAP record: where its content lies."""

    opcode: int
    offset: int
    length: int


@dataclass(frozen=True, slots=True)
class FileEnd:
    """How a file ends: in order, or within a chunk, whose last time its head still tells."""

    orderly: bool
    cut_chunk_ns: int | None = None


def scan(path: Path) -> tuple[list[FileSegment], FileEnd]:
    """Walk the top-level records, and look at the end."""
    segments: list[FileSegment] = []
    cut_chunk_ns = None
    size = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise RecordingError(f"{path}: not an MCAP file")
        at = len(MAGIC)
        while at + _HEAD <= size:
            file.seek(at)
            opcode, length = struct.unpack("<BQ", file.read(_HEAD))
            if at + _HEAD + length > size:
                if opcode == Opcode.CHUNK and at + _HEAD + TIME_SPAN.size <= size:
                    cut_chunk_ns = TIME_SPAN.unpack(file.read(TIME_SPAN.size))[1]
                break
            if opcode in _INDEXED_OPCODES:
                segments.append(FileSegment(opcode, at + _HEAD, length))
            at += _HEAD + length
            if opcode == Opcode.FOOTER:
                return segments, FileEnd(orderly=True)
    if not segments:
        raise RecordingError(f"{path}: cut off in its first bytes; nothing can be read")
    return segments, FileEnd(orderly=False, cut_chunk_ns=cut_chunk_ns)


def chunk_records(file: BinaryIO, segment: FileSegment) -> list[Any]:
    """Records in a chunk; raises one of :data:`DAMAGE` where its bytes are damaged."""
    chunk = parse(file, segment)
    _check_size(chunk)
    return list(breakup_chunk(chunk, validate_crc=True))


def _check_size(chunk: mcap.Chunk) -> None:
    """Raise ValueError for a chunk that says it is larger than we make them: what it says would be allocated."""
    sizes = [chunk.uncompressed_size]
    if chunk.compression == "zstd":
        sizes.append(zstandard.frame_content_size(chunk.data))
    if max(sizes) > _MOST_CHUNK_BYTES:
        raise ValueError(f"{max(sizes)} bytes in a chunk")


def recorded_span_ns(file: BinaryIO, segment: FileSegment) -> tuple[int, int]:
    """First and last instant of a chunk, by its head; both 0 where that is damaged too."""
    if segment.length < TIME_SPAN.size:
        return 0, 0
    file.seek(segment.offset)
    start_ns, end_ns = TIME_SPAN.unpack(file.read(TIME_SPAN.size))
    return (start_ns, end_ns) if 0 <= end_ns - start_ns < LONGEST_CHUNK_S * 1e9 else (0, 0)


def covered_s(spans_ns: Iterable[tuple[int, int]]) -> float:
    """Time that spans cover together: chunks overlap, for a record is written some time after its instant."""
    total_ns = reached_ns = 0
    for start_ns, end_ns in sorted(spans_ns):
        total_ns += max(end_ns - max(start_ns, reached_ns), 0)
        reached_ns = max(reached_ns, end_ns)
    return total_ns * 1e-9


_PARSERS = {
    Opcode.SCHEMA: mcap.Schema,
    Opcode.CHANNEL: mcap.Channel,
    Opcode.CHUNK: mcap.Chunk,
    Opcode.METADATA: mcap.Metadata,
    Opcode.ATTACHMENT: mcap.Attachment,
}


def parse(file: BinaryIO, segment: FileSegment) -> Any:
    """Content of a record, as the library's class of its kind."""
    file.seek(segment.offset)
    return _PARSERS[Opcode(segment.opcode)].read(ReadDataStream(BytesIO(file.read(segment.length))))


def check_attachment(file: BinaryIO, segment: FileSegment) -> None:
    """Raise ValueError for an attachment whose checksum is wrong."""
    file.seek(segment.offset)
    content = file.read(segment.length)
    if zlib.crc32(content[:-4]) != int.from_bytes(content[-4:], "little"):
        raise ValueError("checksum of an attachment")


def learn(record: Any, schemas: dict[int, mcap.Schema], channels: dict[int, mcap.Channel]) -> None:
    """Add a declared schema or channel to those known."""
    if isinstance(record, mcap.Schema):
        schemas[record.id] = record
    elif isinstance(record, mcap.Channel):
        channels[record.id] = record

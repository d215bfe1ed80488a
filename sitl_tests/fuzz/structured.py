"""Damage that keeps a format's form: lengths, types and texts change in their places, with checksums made right."""

from __future__ import annotations

import struct
import zlib
from io import BytesIO

import zstandard
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, Metadata
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.generator.mavcrc import x25crc

from sitl_tests.fuzz import mutators
from sitl_tests.fuzz.mutators import Rng

_MCAP_MAGIC = 8
_RECORD_HEAD = struct.Struct("<BQ")


def _pick(rng: Rng, count: int) -> int:
    return int(rng.integers(count))


# ------------------------------------------------------------------------------------------------ ULog


def ulog_message(data: bytes, rng: Rng) -> bytes:
    """One message's length, type or body; or the message doubled, moved or left out."""
    spans = _ulog_spans(data)
    if not spans:
        return data
    start, stop = spans[_pick(rng, len(spans) if rng.random() < 0.5 else min(len(spans), 30))]
    kind, piece = _pick(rng, 5), data[start:stop]
    if kind == 0:
        length = int(rng.choice((0, 1, 2, 0xFFFF, _pick(rng, 70_000) & 0xFFFF)))
        piece = struct.pack("<H", length) + piece[2:]
    elif kind == 1:
        piece = piece[:2] + bytes([b"FIMPQADRSLOCB\0x"[_pick(rng, 15)]]) + piece[3:]
    elif kind == 2:
        body = mutators.mutate(piece[3:], rng, (*mutators.PLAIN, mutators.word), 2)[:0xFFFF]
        piece = struct.pack("<H", len(body)) + piece[2:3] + body
    elif kind == 3:
        piece += piece
    else:
        piece = b""
    return data[:start] + piece + data[stop:]


def _ulog_spans(data: bytes) -> list[tuple[int, int]]:
    spans, at = [], 16
    while at + 3 <= len(data):
        stop = at + 3 + int.from_bytes(data[at : at + 2], "little")
        if stop > len(data):
            break
        spans.append((at, stop))
        at = stop
    return spans


def ulog_format(data: bytes, rng: Rng) -> bytes:
    """The text of a format: types, array lengths, nesting and names."""
    at, starts = data.find(b":uint64_t "), []
    while at >= 0 and len(starts) < 50:
        starts.append(at)
        at = data.find(b":uint64_t ", at + 1)
    words = (
        b"float[99999999999]",
        b"float[-1]",
        b"float[0]",
        b"char[65535]",
        b"sensor_accel",
        b"x[",
        b"float",
        b";",
        b"",
    )
    if not starts:
        return data
    at = starts[_pick(rng, len(starts))] + 1 + _pick(rng, 40)
    new = words[_pick(rng, len(words))]
    return data[:at] + new + data[at + len(new) :]


# ------------------------------------------------------------------------------------------------ BIN


def bin_format(data: bytes, rng: Rng) -> bytes:
    """One byte or text of a FMT message: its type, length, letters or columns."""
    at, starts = data.find(b"\xa3\x95\x80"), []
    while at >= 0 and len(starts) < 200:
        starts.append(at)
        at = data.find(b"\xa3\x95\x80", at + 89)
    if not starts:
        return data
    start = starts[_pick(rng, len(starts))] + 3
    offset, size = ((0, 1), (1, 1), (2, 4), (6, 16), (22, 64))[_pick(rng, 5)]
    field = data[start + offset : start + offset + size]
    if size == 1:
        field = rng.bytes(1)
    elif size == 16:
        letters = b"abBhHiIfdgnNZcCeELMqQ?\0"
        field = bytes(letters[_pick(rng, len(letters))] if rng.random() < 0.2 else byte for byte in field)
    else:
        field = mutators.mutate(field, rng, (mutators.flip, mutators.set_byte, mutators.splice), 2)[:size].ljust(
            size, b"\0"
        )
    return data[: start + offset] + field + data[start + offset + size :]


# ------------------------------------------------------------------------------------------------ MAVLink


def hostile_payload(payload: bytes, kind: type, rng: Rng) -> bytes:
    """Some fields of a message made extreme: its floats not numbers, its whole numbers at their ends."""
    unpacker = struct.Struct(kind.unpacker.format)  # type: ignore[attr-defined]
    values = list(unpacker.unpack(payload[: unpacker.size].ljust(unpacker.size, b"\0")))
    for index in rng.integers(len(values), size=_pick(rng, 3) + 1):
        values[index] = _extreme(values[index], rng)
    try:
        return unpacker.pack(*values)
    except (struct.error, OverflowError):
        return payload


def _extreme(value: object, rng: Rng) -> object:
    if isinstance(value, float):
        extreme = mutators.FLOATS[_pick(rng, len(mutators.FLOATS))]
        return extreme if abs(extreme) <= 3.4e38 or extreme != extreme or abs(extreme) == float("inf") else 0.0
    if isinstance(value, int):
        return int(rng.choice((0, 1, -1, 127, -128, 255, 32767, -32768, 65535)))
    if isinstance(value, bytes):
        return rng.bytes(len(value)) if rng.random() < 0.5 else bytes(len(value))
    return value


def frame_with(frame: bytes, payload: bytes) -> bytes:
    """A version 2 frame with another payload and the checksum that belongs to it; as it was where it is none."""
    identity = int.from_bytes(frame[7:10], "little")
    if frame[:1] != b"\xfd" or identity not in mavlink.mavlink_map:
        return frame
    header = frame[:1] + bytes([len(payload)]) + b"\0" + frame[3:10]
    crc = x25crc(header[1:] + payload + bytes([mavlink.mavlink_map[identity].crc_extra])).crc
    return header + payload + crc.to_bytes(2, "little")


def hostile_frame(frame: bytes, rng: Rng) -> bytes:
    """The same message with extreme values and a right checksum."""
    identity = int.from_bytes(frame[7:10], "little")
    if frame[:1] != b"\xfd" or identity not in mavlink.mavlink_map:
        return frame
    return frame_with(frame, hostile_payload(frame[10 : 10 + frame[1]], mavlink.mavlink_map[identity], rng))


def tlog_entry(data: bytes, rng: Rng) -> bytes:
    """One entry's receive time or message made extreme."""
    spans, at = [], 0
    while at + 20 <= len(data) and data[at + 8] in (0xFD, 0xFE) and len(spans) < 3000:
        size = 12 + data[at + 9] + 13 * (data[at + 10] & 1) if data[at + 8] == 0xFD else 8 + data[at + 9]
        spans.append((at, at + 8 + size))
        at += 8 + size
    if not spans:
        return data
    start, stop = spans[_pick(rng, len(spans))]
    stamp, frame = data[start : start + 8], data[start + 8 : stop]
    if rng.random() < 0.3:
        stamp = int(rng.choice((0, 1, 2**40, 2**50, 2**62), shuffle=False)).to_bytes(8, "big")
    else:
        frame = hostile_frame(frame, rng)
    return data[:start] + stamp + frame + data[stop:]


# ------------------------------------------------------------------------------------------------ MCAP


def mcap_record(data: bytes, rng: Rng) -> bytes:
    """The inside of a chunk, an attachment or a metadata record damaged, its checksum made right again."""
    spans, at = [], _MCAP_MAGIC
    while at + 9 <= len(data):
        opcode, length = _RECORD_HEAD.unpack_from(data, at)
        if at + 9 + length > len(data):
            break
        if opcode in (Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA):
            spans.append((opcode, at, at + 9 + length))
        at += 9 + length
    if not spans:
        return data
    opcode, start, stop = spans[_pick(rng, len(spans))]
    stream = ReadDataStream(BytesIO(data[start + 9 : stop]))
    builder = RecordBuilder()
    try:
        {Opcode.CHUNK: _chunk, Opcode.ATTACHMENT: _attachment, Opcode.METADATA: _metadata}[Opcode(opcode)](
            stream, rng, builder
        )
    except Exception:  # damaged before by another mutation: left as it is
        return data
    return data[:start] + builder.end() + data[stop:]


def _chunk(stream: ReadDataStream, rng: Rng, builder: RecordBuilder) -> None:
    chunk = Chunk.read(stream)
    inside = zstandard.decompress(chunk.data, chunk.uncompressed_size) if chunk.compression == "zstd" else chunk.data
    ways = (*mutators.PLAIN, mutators.word, mutators.word, mutators.word)
    inside = mutators.mutate(inside, rng, ways, 3)
    chunk.data = zstandard.compress(inside) if chunk.compression == "zstd" else inside
    chunk.uncompressed_crc = zlib.crc32(inside)
    chunk.uncompressed_size = len(inside) if rng.random() < 0.8 else int(rng.choice((0, 1, 2**31, 2**40, 2**62)))
    if rng.random() < 0.1:
        chunk.compression = ("", "lz4", "zstd", "x")[_pick(rng, 4)]
    chunk.write(builder)


def _attachment(stream: ReadDataStream, rng: Rng, builder: RecordBuilder) -> None:
    attachment = Attachment.read(stream)
    attachment.data = mutators.mutate(attachment.data, rng, mutators.TEXT, 2)
    attachment.write(builder)


def _metadata(stream: ReadDataStream, rng: Rng, builder: RecordBuilder) -> None:
    metadata = Metadata.read(stream)
    for key in list(metadata.metadata):
        if rng.random() < 0.4:
            metadata.metadata[key] = mutators.WORDS[_pick(rng, len(mutators.WORDS))]
        elif rng.random() < 0.2:
            del metadata.metadata[key]
    metadata.write(builder)


# ------------------------------------------------------------------------------------------------ tables


def cell(data: bytes, rng: Rng) -> bytes:
    """One cell of a table in text replaced, left out or doubled; the header is one row in five."""
    separator = b"\t" if b"\t" in data else b","
    lines = data.split(b"\n")
    at = 0 if rng.random() < 0.2 else _pick(rng, len(lines))
    cells = lines[at].split(separator)
    where, kind = _pick(rng, len(cells)), _pick(rng, 4)
    if kind < 2:
        cells[where] = mutators.WORDS[_pick(rng, len(mutators.WORDS))].encode()
    elif kind == 2:
        del cells[where]
    else:
        cells.insert(where, cells[where])
    lines[at] = separator.join(cells)
    return b"\n".join(lines)


def encoding(data: bytes, rng: Rng) -> bytes:
    """The same text as other programs write it."""
    text = data.decode("utf-8", "replace")
    name = ("utf-16", "utf-8-sig", "latin-1", "utf-32")[_pick(rng, 4)]
    return text.replace("\n", "\r\n" if rng.random() < 0.5 else "\r").encode(name, "replace")


def element(data: bytes, rng: Rng) -> bytes:
    """A tag or a length of a MATLAB v5 element, which stand on multiples of eight bytes."""
    at = 128 + 4 * _pick(rng, max((min(len(data), 2000) - 128) // 4, 1))
    value = int(rng.choice((0, 1, 2, 3, 5, 6, 9, 12, 13, 14, 15, 18, 255, 65535, 2**31 - 1, 2**32 - 1)))
    return data[:at] + value.to_bytes(4, "little") + data[at + 4 :]

"""The bulk scanner against pymavlink: the same frames, the same field values, on clean and on dirty streams."""

from __future__ import annotations

import random
from collections import Counter
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega
from pymavlink.generator.mavcrc import x25crc

from companion.adapters.mavlink.decode.bulk import BulkDecoder
from companion.adapters.mavlink.link.dialect import build_message
from companion.adapters.mavlink.link.scan import Scanner, sender

IDS = sorted(ardupilotmega.mavlink_map)
WAYS = ["plain", "compiled"]
FLUSH = bytes(300)  # longer than any frame, so that no candidate at the end is left waiting


def frame(
    identity: int, payload: bytes, version: int = 2, signed: bool = False, sender: tuple[int, int] = (1, 1)
) -> bytes:
    """A valid frame, written from the specification with pymavlink's checksum."""
    if version == 1:
        header = bytes([0xFE, len(payload), 7, *sender, identity])
    else:
        header = bytes([0xFD, len(payload), int(signed), 0, 7, *sender]) + identity.to_bytes(3, "little")
    crc = x25crc(header[1:] + payload + bytes([ardupilotmega.mavlink_map[identity].crc_extra])).crc
    return header + payload + crc.to_bytes(2, "little") + (bytes(range(13)) if signed else b"")


def signed(piece: bytes) -> bool:
    return piece[0] == 0xFD and bool(piece[2] & 1)


def random_frame(rng: random.Random) -> bytes:
    version = rng.choice((1, 2, 2))
    identity = rng.choice([number for number in IDS if version == 2 or number < 256])
    size = ardupilotmega.mavlink_map[identity].unpacker.size
    payload = rng.randbytes(rng.choice((size, size, rng.randint(1, size))))
    return frame(
        identity, payload, version, version == 2 and rng.random() < 0.3, (rng.randint(1, 3), rng.randint(1, 3))
    )


def scanner_of(way: str) -> Scanner:
    return Scanner(BulkDecoder(()) if way == "compiled" else None)


def ours(pieces: list[bytes], way: str) -> list[str]:
    descriptions: list[str] = []
    scanner = scanner_of(way)
    for piece in pieces:
        for key, payload in scanner.scan(piece).frames:
            system, component, message = sender(key)
            descriptions.append(f"{system}/{component} {message} {build_message(message, payload).to_dict()!r}")
        assert len(scanner._tail) < 280
    assert scanner.counters.frames == len(descriptions)
    return descriptions


def described(message: Any) -> str:
    head = message.get_header()
    return f"{head.srcSystem}/{head.srcComponent} {head.msgId} {message.to_dict()!r}"


def parse_buffer(data: bytes) -> list[str]:
    parsed = ardupilotmega.MAVLink(None)
    parsed.robust_parsing = True
    return [
        described(message)
        for message in parsed.parse_buffer(data) or []
        if message.get_type() != "BAD_DATA" and not message.get_type().startswith("UNKNOWN")
    ]


def stepping_oracle(data: bytes) -> list[str]:
    """pymavlink's ``decode`` tried at every byte; one byte forward where it refuses.

    A MAVLink 1 frame longer than its message is none here: the version has no extensions, so that such a frame is
    chance (one checksum in 65,536), which pymavlink accepts and cuts.
    """
    parser = ardupilotmega.MAVLink(None)
    descriptions, at = [], 0
    while at < len(data):
        length = {0xFD: 12, 0xFE: 8}.get(data[at])
        if length is None:
            at += 1
            continue
        if at + length - 2 > len(data):
            break
        flags = data[at + 2] if data[at] == 0xFD else 0
        identity = int.from_bytes(data[at + 7 : at + 10], "little") if data[at] == 0xFD else data[at + 5]
        length += data[at + 1] + 13 * (flags & 1)
        if flags & ~1 or identity not in ardupilotmega.mavlink_map:
            at += 1
            continue
        if at + length > len(data):
            break
        if data[at] == 0xFE and data[at + 1] > ardupilotmega.mavlink_map[identity].unpacker.size:
            at += 1
            continue
        try:
            descriptions.append(described(parser.decode(bytearray(data[at : at + length]))))
            at += length
        except ardupilotmega.MAVError:
            at += 1
    return descriptions


def split(data: bytes, rng: random.Random) -> list[bytes]:
    borders = sorted(rng.randint(0, len(data)) for _ in range(rng.randint(0, 40)))
    return [data[a:b] for a, b in zip([0, *borders], [*borders, len(data)], strict=True)]


def dirty_stream(rng: random.Random, frames: int) -> tuple[bytes, list[bytes]]:
    """Frames with garbage, flipped bits and truncations between; and the frames that were left whole."""
    stream, intact = bytearray(), []
    for _ in range(frames):
        piece = random_frame(rng)
        fate = rng.random()
        if fate < 0.1:
            stream += bytes(rng.choice((0xFD, 0xFE, rng.randrange(256))) for _ in range(rng.randint(1, 60)))
        if fate > 0.8:
            at = rng.randrange(len(piece))
            stream += piece[:at] + bytes([piece[at] ^ 1 << rng.randrange(8)]) + piece[at + 1 :]
        elif fate > 0.7:
            # cut before the checksum's end: a frame cut within its signature is whole, and takes the next bytes for it
            stream += piece[: rng.randrange(len(piece) - 13 * signed(piece))]
        else:
            stream += piece
            intact.append(piece)
    return bytes(stream) + FLUSH, intact


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("seed", range(5))
def test_a_clean_stream_gives_what_parse_buffer_gives(seed: int, way: str) -> None:
    rng = random.Random(seed)
    data = b"".join(random_frame(rng) for _ in range(400))
    assert ours(split(data, rng), way) == parse_buffer(data)


@pytest.mark.parametrize("way", WAYS)
def test_a_mavlink_1_frame_longer_than_its_message_is_none(way: str) -> None:
    longest = frame(47, bytes(4), version=1)
    assert len(ours([frame(47, bytes(range(1, 132)), version=1) + longest + FLUSH], way)) == 1


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("seed", range(8))
def test_a_dirty_stream_loses_no_frame_that_pymavlink_keeps(seed: int, way: str) -> None:
    rng = random.Random(100 + seed)
    data, intact = dirty_stream(rng, 300)
    scanned = ours(split(data, rng), way)
    assert scanned == stepping_oracle(data)
    assert not Counter(parse_buffer(data)) - Counter(scanned)
    assert not Counter(text for piece in intact for text in parse_buffer(piece)) - Counter(scanned)


@pytest.mark.parametrize("way", WAYS)
@settings(max_examples=150, deadline=None)
@given(
    st.lists(
        st.one_of(
            st.binary(max_size=40),
            st.sampled_from([b"\xfd", b"\xfe", b"\xfd\xff\x00", b"\xfe\xff\xfe"]),
            st.integers(0, 2**32).map(lambda seed: random_frame(random.Random(seed))),
        ),
        max_size=12,
    ),
    st.lists(st.tuples(st.integers(0, 10_000), st.integers(0, 7)), max_size=4),
    st.integers(0, 2**32),
)
def test_any_stream_is_read_as_the_stepping_oracle_reads_it(
    way: str, pieces: list[bytes], flips: list[tuple[int, int]], seed: int
) -> None:
    data = bytearray(b"".join(pieces))
    for at, bit in flips:
        if data:
            data[at % len(data)] ^= 1 << bit
    assert ours(split(bytes(data), random.Random(seed)), way) == stepping_oracle(bytes(data))


@pytest.mark.parametrize("version", [1, 2])
def test_every_message_is_built_as_pymavlink_builds_it(version: int) -> None:
    rng = random.Random(version)
    for identity in IDS:
        if version == 1 and identity > 255:
            continue
        size = ardupilotmega.mavlink_map[identity].unpacker.size
        for payload in (rng.randbytes(size), rng.randbytes(max(1, size // 2)), rng.randbytes(min(255, size + 5))):
            data = frame(identity, payload, version)
            expected = ardupilotmega.MAVLink(None).decode(bytearray(data))
            assert repr(build_message(identity, payload).to_dict()) == repr(expected.to_dict())


@pytest.mark.parametrize("way", WAYS)
def test_the_counters_tell_what_happened(way: str) -> None:
    good, unknown = frame(0, bytes(9)), bytes([0xFD, 1, 0, 0, 0, 1, 1, 0xEE, 0xEE, 0xEE, 0, 0, 0])
    bad = good[:-1] + bytes([good[-1] ^ 1])
    scanner = scanner_of(way)
    scanner.scan(b"abc" + good + unknown + good + bad + FLUSH)
    counters = scanner.counters
    assert (counters.frames, counters.crc_errors, counters.unknown) == (2, 1, 1)
    assert counters.skipped_bytes == 3 + len(unknown) + len(bad) + len(FLUSH)

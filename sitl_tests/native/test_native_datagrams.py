"""Reading of datagrams in C against Python's socket: bytes, senders, forms, bounds and errors."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import numpy as np
import pytest

from companion.adapters.mavlink.link.datagrams import FRAMES, GUARDED_FRAMES, OTHER, DatagramReader

LIMIT = 1 << 20
GUARDED, SYSTEM = frozenset({1, 200}), 7
Sent = list[tuple[tuple[str, int], bytes]]


def udp() -> socket.socket:
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.setblocking(False)
    end.bind(("127.0.0.1", 0))
    return end


@pytest.fixture
def ends() -> Iterator[tuple[socket.socket, list[socket.socket]]]:
    reader, senders = udp(), [udp() for _ in range(3)]
    yield reader, senders
    for end in (reader, *senders):
        end.close()


def frame(rng: np.random.Generator) -> bytes:
    """Bytes with the header of a frame, MAVLink 1, 2 or signed."""
    size, system, component = int(rng.integers(0, 40)), int(rng.choice([7, 8])), int(rng.choice([1, 50, 200]))
    rest = rng.bytes(size + 2)
    if rng.random() < 0.4:
        return bytes([0xFE, size, 0, system, component, 30]) + rest
    signed = bool(rng.random() < 0.3)
    header = bytes([0xFD, size, signed, 0, 0, system, component, 30, 0, 0])
    return header + rest + rng.bytes(13 if signed else 0)


def datagram(rng: np.random.Generator) -> bytes:
    frames = b"".join(frame(rng) for _ in range(rng.integers(0, 4)))
    damage = rng.random()
    return frames[:-1] if damage < 0.1 else frames + rng.bytes(3) if damage < 0.2 else frames


def form_of(data: bytes, system: int | None) -> int:
    """Form by the rules of MAVLink's headers."""
    at, form = 0, FRAMES
    while at + 8 <= len(data):
        if data[at] == 0xFD:
            key, length = (data[at + 5], data[at + 6]), 12 + data[at + 1] + 13 * (data[at + 2] & 1)
        elif data[at] == 0xFE:
            key, length = (data[at + 3], data[at + 4]), 8 + data[at + 1]
        else:
            return OTHER
        if key[1] in GUARDED and system in (None, key[0]):
            form = GUARDED_FRAMES
        at += length
    return form if at == len(data) else OTHER


def expected(sent: Sent, system: int | None) -> list[tuple[tuple[str, int], bytes, int]]:
    """Rows of what was sent; whole frames without a guarded id that follow each other from one sender are one."""
    rows: list[tuple[tuple[str, int], bytes, int]] = []
    for address, data in sent:
        form = form_of(data, system)
        if rows and form == FRAMES and rows[-1][0] == address and rows[-1][2] == FRAMES:
            rows[-1] = (address, rows[-1][1] + data, FRAMES)
        else:
            rows.append((address, data, form))
    return rows


@pytest.mark.parametrize("seed", range(20))
def test_rows_are_what_was_sent(ends: tuple[socket.socket, list[socket.socket]], seed: int) -> None:
    reader, senders = ends
    rng = np.random.default_rng(seed)
    source, system = DatagramReader(reader), (None, SYSTEM)[seed % 2]
    assert source.read(LIMIT, GUARDED, system) == []
    senders[0].sendto(b"", reader.getsockname())  # the size of the last read says how many the next may be
    source.read(LIMIT, GUARDED, system)
    sent: Sent = []
    for _ in range(int(rng.integers(1, 31))):
        sender = senders[int(rng.choice([0, 0, 0, 1, 2]))]
        data = datagram(rng)
        sender.sendto(data, reader.getsockname())
        sent.append((sender.getsockname(), data))
    read = source.read(LIMIT, GUARDED, system)
    assert source.drained
    assert [tuple(row) for row in read] == expected(sent, system)


def test_many_small_ones_behind_a_large_one_come_in_one_read(ends: tuple[socket.socket, list[socket.socket]]) -> None:
    reader, (sender, *_) = ends
    source = DatagramReader(reader)
    large = np.random.default_rng(1).bytes(60_000)
    sender.sendto(large, reader.getsockname())
    for number in range(70):
        sender.sendto(bytes([number]), reader.getsockname())
    assert [row.data for row in source.read(65536, (), None)] == [large, *(bytes([number]) for number in range(70))]
    assert source.drained


@pytest.mark.parametrize("limit", [1, 1000, 20_000])
def test_a_read_ends_about_its_limit_and_the_next_goes_on(
    ends: tuple[socket.socket, list[socket.socket]], limit: int
) -> None:
    reader, (sender, *_) = ends
    source = DatagramReader(reader)
    sent = [np.random.default_rng(number).bytes(700) for number in range(60)]
    sender.sendto(sent[0], reader.getsockname())
    read = [source.read(limit, (), None)]
    for data in sent[1:]:
        sender.sendto(data, reader.getsockname())
    while sum(map(len, read)) < len(sent):
        read.append(source.read(limit, (), None))
        assert 0 < sum(len(row.data) for row in read[-1]) < limit + 700
    assert [row.data for rows in read for row in rows] == sent
    assert len(read) >= len(sent) * 700 // (limit + 700)
    assert source.read(limit, (), None) == []
    assert source.drained


def test_a_flood_of_empty_datagrams_ends(ends: tuple[socket.socket, list[socket.socket]]) -> None:
    reader, (sender, *_) = ends
    source = DatagramReader(reader)
    for _ in range(200):
        sender.sendto(b"", reader.getsockname())
    read = source.read(LIMIT, (), None)
    assert b"".join(row.data for row in read) == b""
    assert source.drained


def test_a_closed_socket_is_an_error() -> None:
    reader = udp()
    source = DatagramReader(reader)
    reader.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        source.read(LIMIT, (), None)


def test_a_refused_datagram_of_ours_is_told_as_such(ends: tuple[socket.socket, list[socket.socket]]) -> None:
    reader, (gone, *_) = ends
    reader.connect(gone.getsockname())
    gone.close()
    reader.send(b"into the void")
    with pytest.raises(ConnectionRefusedError):
        DatagramReader(reader).read(LIMIT, (), None)


@pytest.mark.parametrize("system", [None, SYSTEM])
def test_guarded_frames_are_those_of_a_walk_over_the_headers(
    ends: tuple[socket.socket, list[socket.socket]], system: int | None
) -> None:
    reader, senders = DatagramReader(ends[0]), ends[1]
    rng = np.random.default_rng(5)
    frames = [frame(rng) for _ in range(40)]
    senders[0].sendto(b"".join(frames), ends[0].getsockname())
    (read,) = reader.read(LIMIT, GUARDED, system)
    keys = [tuple(data[5:7]) if data[0] == 0xFD else tuple(data[3:5]) for data in frames]
    guarded = [(k, data) for k, data in zip(keys, frames, strict=True) if k[1] in GUARDED and system in (None, k[0])]
    assert read.form == GUARDED_FRAMES
    assert list(reader.guarded_frames(read.data, system)) == guarded
    assert 0 < len(guarded) < len(frames)

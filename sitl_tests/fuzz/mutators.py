"""Plain damage, for any format: bytes flipped, cut, moved, put in, and numbers made extreme."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence

import numpy as np

Rng = np.random.Generator
Mutator = Callable[[bytes, Rng], bytes]

INTEGERS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)
FLOATS = (
    0.0, -0.0, 1e-45, 1e-38, 1e-6, 1.0, -1.0, 1e6, 1e20, 3.4e38, -3.4e38, 5e-324, 1e300, -1e300,
    float("nan"), float("inf"), float("-inf"),
)  # fmt: skip
WORDS = (
    "", "0", "-0", "-1", "1e-300", "1e300", "1e999", "nan", "inf", "-inf", "99999999999999999999", "0x10", "1_000",
    "1,5", "true", "x", "é", "\x00", '"', "'", "[", "{", "#", "9" * 400, "  ", "2026-01-01", "[]", "{}", '""',
    "-9223372036854775809",
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_MOST_BYTES = 300


def place(data: bytes, rng: Rng) -> int:
    """Any byte's position; half of them among the first hundred, where headers are."""
    end = min(len(data), 100) if rng.random() < 0.5 else len(data)
    return int(rng.integers(max(end, 1)))


def flip(data: bytes, rng: Rng) -> bytes:
    at = place(data, rng)
    return data[:at] + bytes([byte ^ 1 << int(rng.integers(8)) for byte in data[at : at + 1]]) + data[at + 1 :]


def set_byte(data: bytes, rng: Rng) -> bytes:
    at = place(data, rng)
    return data[:at] + rng.bytes(1) + data[at + 1 :]


def delete(data: bytes, rng: Rng) -> bytes:
    at = place(data, rng)
    return data[:at] + data[at + int(rng.integers(1, _MOST_BYTES)) :]


def insert(data: bytes, rng: Rng) -> bytes:
    at = place(data, rng)
    return data[:at] + rng.bytes(int(rng.integers(1, _MOST_BYTES))) + data[at:]


def truncate(data: bytes, rng: Rng) -> bytes:
    return data[: place(data, rng) + 1]


def splice(data: bytes, rng: Rng) -> bytes:
    """Put a copy of one piece somewhere else."""
    start, at = place(data, rng), place(data, rng)
    return data[:at] + data[start : start + int(rng.integers(1, 20 * _MOST_BYTES))] + data[at:]


def integer(data: bytes, rng: Rng) -> bytes:
    """An extreme integer of one, two, four or eight bytes."""
    size, at = int(rng.choice((1, 2, 4, 8))), place(data, rng)
    value = INTEGERS[int(rng.integers(len(INTEGERS)))] & (1 << 8 * size) - 1
    order = "little" if rng.random() < 0.7 else "big"
    return data[:at] + value.to_bytes(size, order) + data[at + size :]  # type: ignore[arg-type]


def floating(data: bytes, rng: Rng) -> bytes:
    """An extreme float of four or eight bytes."""
    value, at = FLOATS[int(rng.integers(len(FLOATS)))], place(data, rng)
    packed = (
        struct.pack("<d", value) if rng.random() < 0.5 or 3.5e38 < abs(value) < np.inf else struct.pack("<f", value)
    )
    return data[:at] + packed + data[at + len(packed) :]


def word(data: bytes, rng: Rng) -> bytes:
    """A number of a text replaced by something else."""
    places = [match.span() for match in _NUMBER.finditer(data)]
    if not places:
        return data
    start, stop = places[int(rng.integers(len(places)))]
    return data[:start] + WORDS[int(rng.integers(len(WORDS)))].encode() + data[stop:]


def line(data: bytes, rng: Rng) -> bytes:
    """A line of a text left out, doubled, or moved."""
    lines = data.splitlines(keepends=True)
    if len(lines) < 2:
        return data
    at, to = (int(rng.integers(len(lines))) for _ in range(2))
    kind = int(rng.integers(3))
    if kind == 0:
        del lines[at]
    elif kind == 1:
        lines.insert(to, lines[at])
    else:
        lines.insert(to, lines.pop(at))
    return b"".join(lines)


PLAIN: tuple[Mutator, ...] = (flip, flip, set_byte, delete, insert, truncate, splice, integer, integer, floating)
TEXT: tuple[Mutator, ...] = (word, word, word, word, line, line, flip, delete, insert, truncate, splice)


def mutate(data: bytes, rng: Rng, mutators: Sequence[Mutator] = PLAIN, most: int = 5) -> bytes:
    """One to ``most`` mutations, one after the other."""
    for _ in range(int(rng.integers(1, most + 1))):
        data = mutators[int(rng.integers(len(mutators)))](data, rng)
    return data

"""Inertial messages as numpy layouts: payloads of one message id in, stamps in ns and SI values out.

Two batch layouts are our own, for nodes that send several samples at a time (``k`` counts from 0, little endian):

DEBUG_FLOAT_ARRAY
    ``name`` is the instance, ``time_usec`` the stamp of sample 0, ``array_id`` the sample period in us, ``data[0]`` the
    number of samples (1 to 9), ``data[1 + 6k : 7 + 6k]`` x, y, z in m/s^2 and p, q, r in rad/s.
TUNNEL
    ``payload_type`` 0xA1C0; payload: ``uint64`` stamp of sample 0 in us, ``uint16`` period in us, ``uint8`` number of
    samples (1 to 9), ``uint8`` instance, ``float32`` m/s^2 per count, ``float32`` rad/s per count, then per sample six
    ``int16``: x, y, z, p, q, r.

DEBUG_VECT carries one accelerometer sample: ``name`` is the instance, x, y, z in m/s^2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.adapters.mavlink.link.dialect import ID_OF, payload_size
from companion.records import Axis, Floats, Ints
from companion.units import GRAVITY_MPS2

TUNNEL_IMU_TYPE = 0xA1C0  # payload type of inertial batches, ours: from 32768 on they are free (MAVLink)
BATCH_SAMPLES = 9  # as many six-axis int16 samples as TUNNEL's 128 bytes take beside their head (derived)
_IMPLAUSIBLE_SEVENTH = 0x20  # seventh byte of a uint64 in us: from 2^53 on, 285 years (derived)
IMPLAUSIBLE_STAMP_US = _IMPLAUSIBLE_SEVENTH << 48  # derived: the smallest stamp that has the seventh byte's bit
_COMPLETE = frozenset(byte for byte in range(256) if byte & Axis.ALL == Axis.ALL)
_Stamps = np.ndarray[tuple[int], np.dtype[np.uint64]]
_MG = GRAVITY_MPS2 / 1000.0  # by definition: a milli-g, the unit of the old messages
# by definition: SI units of a count, milli-g and mrad/s (MAVLink common.xml)
INTEGER_SCALE = np.array([_MG, _MG, _MG, 1e-3, 1e-3, 1e-3])


@dataclass(frozen=True, slots=True)
class MessageSamples:
    """Samples of equal payloads of one sender, sensor axes, SI.

    ``values`` is (n, 6): specific force in m/s^2, angular rate in rad/s. ``fields`` is None, or (n,) the axes that each
    sample says it updated. ``instances`` is None (one instance only), or (n,) the instance of each sample as text.
    """

    t_ns: Ints
    values: Floats
    fields: Ints | None = None
    instances: list[str] | None = None


@dataclass(frozen=True, slots=True)
class MessageLayout:
    """One inertial message: its axes and its reader. ``named``: instances differ by name, else by number."""

    message: str
    axes: Axis
    named: bool
    read: Callable[[list[bytes]], tuple[MessageSamples, int]]


def _rows(payloads: list[bytes], size: int) -> bytes:
    """Payloads of one message, untrimmed, end to end."""
    lengths = set(map(len, payloads))
    if len(lengths) == 1 and (length := lengths.pop()) <= size:
        padding = bytes(size - length)
        return padding.join(payloads) + padding
    return b"".join([payload[:size].ljust(size, b"\0") for payload in payloads])


def _table(payloads: list[bytes], dtype: np.dtype[np.void]) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    return np.frombuffer(_rows(payloads, dtype.itemsize), dtype)


def _dtype(message: str, **fields: tuple[str, int]) -> np.dtype[np.void]:
    formats = [spelling for spelling, _ in fields.values()]
    offsets = [offset for _, offset in fields.values()]
    size = payload_size(ID_OF[message])
    return np.dtype({"names": list(fields), "formats": formats, "offsets": offsets, "itemsize": size})


_HIGHRES = _dtype("HIGHRES_IMU", t=("<u8", 0), v=("(6,)<f4", 8), fields=("<u2", 60), id=("u1", 62))
_RAW = _dtype("RAW_IMU", t=("<u8", 0), v=("(6,)<i2", 8), id=("u1", 26))
_SCALED = _dtype("SCALED_IMU", t=("<u4", 0), v=("(6,)<i2", 4))
_VECTOR = _dtype("DEBUG_VECT", t=("<u8", 0), v=("(3,)<f4", 8), name=("S10", 20))
_ARRAY = _dtype("DEBUG_FLOAT_ARRAY", t=("<u8", 0), period=("<u2", 8), name=("S10", 10), v=("(58,)<f4", 20))
_TUNNEL = _dtype(
    "TUNNEL",
    kind=("<u2", 0),
    t=("<u8", 5),
    period=("<u2", 13),
    count=("u1", 15),
    id=("u1", 16),
    accel_scale=("<f4", 17),
    gyro_scale=("<f4", 21),
    v=("(54,)<i2", 25),
)


def _highres(payloads: list[bytes]) -> tuple[MessageSamples, int]:
    # single columns are looked at as bytes, which for the few samples of a live chunk is far cheaper than numpy
    size = _HIGHRES.itemsize
    rows = _rows(payloads, size)
    table = np.frombuffer(rows, _HIGHRES)
    complete = _COMPLETE.issuperset(rows[60::size])
    fields = None if complete else table["fields"].astype(np.int64) & int(Axis.ALL)
    stamps = _microseconds(table["t"], rows[6::size], rows[7::size])
    return MessageSamples(stamps, table["v"].astype(np.float64), fields, _numbers(rows[62::size])), 0


def _raw(payloads: list[bytes]) -> tuple[MessageSamples, int]:
    size = _RAW.itemsize
    rows = _rows(payloads, size)
    table = np.frombuffer(rows, _RAW)
    stamps = _microseconds(table["t"], rows[6::size], rows[7::size])
    return MessageSamples(stamps, table["v"] * INTEGER_SCALE, None, _numbers(rows[26::size])), 0


def _scaled(payloads: list[bytes]) -> tuple[MessageSamples, int]:
    table = _table(payloads, _SCALED)
    return MessageSamples(table["t"].astype(np.int64) * 1_000_000, table["v"] * INTEGER_SCALE), 0


def _vector(payloads: list[bytes]) -> tuple[MessageSamples, int]:
    table = _table(payloads, _VECTOR)
    values = np.zeros((len(table), 6))
    values[:, :3] = table["v"]
    return MessageSamples(_any_microseconds(table["t"]), values, None, _names(table["name"])), 0


def _array(payloads: list[bytes]) -> tuple[MessageSamples, int]:
    table = _table(payloads, _ARRAY)
    counts = np.nan_to_num(table["v"][:, 0], nan=0.0, posinf=0.0, neginf=0.0)
    good = (counts >= 1) & (counts <= BATCH_SAMPLES) & (counts == np.floor(counts))
    valid = table[good]
    values = valid["v"][:, 1 : 1 + 6 * BATCH_SAMPLES].astype(np.float64)
    batch = _unroll(valid["t"], valid["period"], counts[good].astype(np.int64), values, _names(valid["name"]))
    return batch, len(table) - len(valid)


def _tunnel(payloads: list[bytes]) -> tuple[MessageSamples, int]:
    table = _table(payloads, _TUNNEL)
    ours = table[table["kind"] == TUNNEL_IMU_TYPE]
    valid = ours[(ours["count"] >= 1) & (ours["count"] <= BATCH_SAMPLES)]
    scale = np.empty((len(valid), 1, 6))
    scale[:, :, :3] = valid["accel_scale"][:, None, None]
    scale[:, :, 3:] = valid["gyro_scale"][:, None, None]
    values = valid["v"].reshape(-1, BATCH_SAMPLES, 6) * scale
    names = [str(number) for number in valid["id"].tolist()]
    return _unroll(valid["t"], valid["period"], valid["count"].astype(np.int64), values, names), len(ours) - len(valid)


def _unroll(
    stamps: _Stamps,
    periods: np.ndarray[tuple[int], np.dtype[np.uint16]],
    counts: Ints,
    values: Floats,
    names: list[str],
) -> MessageSamples:
    """Lay batches of several samples out as single samples."""
    steps = np.arange(BATCH_SAMPLES)
    present = steps < counts[:, None]
    first = _any_microseconds(stamps)[:, None]
    t_ns = np.where(first < 0, first, first + periods.astype(np.int64)[:, None] * 1000 * steps)
    instances = [name for name, count in zip(names, counts.tolist(), strict=True) for _ in range(count)]
    return MessageSamples(t_ns[present], values.reshape(-1, BATCH_SAMPLES, 6)[present], None, instances)


def _microseconds(stamps: _Stamps, seventh: bytes, eighth: bytes) -> Ints:
    """Give ns, by a glance at the stamps' two highest bytes where those are plausible."""
    if not any(eighth) and max(seventh) < _IMPLAUSIBLE_SEVENTH:
        return stamps.astype(np.int64) * 1000
    return _any_microseconds(stamps)


def _any_microseconds(stamps: _Stamps) -> Ints:
    """Give ns; a stamp beyond any clock becomes -1."""
    possible = stamps < IMPLAUSIBLE_STAMP_US
    return np.where(possible, np.where(possible, stamps, 0).astype(np.int64) * 1000, -1)


def _numbers(column: bytes) -> list[str] | None:
    """Instances as text; None where all are number 0."""
    return [str(number) for number in column] if any(column) else None


def _names(column: np.ndarray[tuple[int], np.dtype[np.bytes_]]) -> list[str]:
    return [name.split(b"\0", 1)[0].decode("ascii", errors="replace") for name in column.tolist()]


WRAPPING = frozenset(("SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3"))
"""Messages whose boot time is 32 bits of milliseconds."""

LAYOUTS: dict[int, MessageLayout] = {
    ID_OF[layout.message]: layout
    for layout in (
        MessageLayout("HIGHRES_IMU", Axis.ALL, False, _highres),
        MessageLayout("RAW_IMU", Axis.ALL, False, _raw),
        MessageLayout("SCALED_IMU", Axis.ALL, False, _scaled),
        MessageLayout("SCALED_IMU2", Axis.ALL, False, _scaled),
        MessageLayout("SCALED_IMU3", Axis.ALL, False, _scaled),
        MessageLayout("DEBUG_FLOAT_ARRAY", Axis.ALL, True, _array),
        MessageLayout("TUNNEL", Axis.ALL, False, _tunnel),
        MessageLayout("DEBUG_VECT", Axis.ACCEL, True, _vector),
    )
}

"""The compact lossless form of bulky records: ROS 1 serialisation, which Foxglove and PlotJuggler read as it stands.

Little-endian, no padding; a string or a variable array is a uint32 count and then its bytes or elements. The text of
each schema (``SCHEMAS``) is the documentation of its message.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any

import numpy as np

from companion.records import Axis, ClockName, Flow, ImuBatch, MatchSet, RawChunk, Station

_CHUNK = """# link: 128 + link for what we sent
int32 link
int64 received_host_ns
uint8[] data
"""
_IMU = """# station: 0 root, 1 left, 2 right
# axes: bit 0-2 specific force x y z [m/s^2], bit 3-5 angular rate p q r [rad/s]
uint8 station
string clock
uint8 axes
int64 received_host_ns
# columns: the bits whose columns are stored in values, row by row, one row per stamp; the other columns are zero
uint8 columns
int64[] t_ns
float64[] values
"""
_MATCHES = """# left_px, right_px: column, row of each match, pair after pair
int64 pair_id
int64 plan_id
string left_clock
string right_clock
int64[] mid_exposure_ns
int64 exposure_ns
int64 row_time_ns
int64 matched_host_ns
float64[] left_px
float64[] right_px
float64[] sigma_px
# so many at the end are no features but fill the obstacle picture
int64 filled
# features that the left image of an earlier pair shows too: that pair, empty for none; their places among the matches
int64[] earlier_pair_id
int64[] flow_index
float64[] earlier_px
float64[] flow_sigma_px
"""

SCHEMAS: dict[type, str] = {RawChunk: _CHUNK, ImuBatch: _IMU, MatchSet: _MATCHES}


def pack(record: Any) -> bytes:
    """Serialise a bulky record; raise KeyError for a type that has no packed form."""
    return _PACK[type(record)](record)


def unpack(kind: type, data: bytes) -> Any:
    """Give back what :func:`pack` was given, bit for bit; raise struct.error or ValueError for damaged bytes."""
    return _UNPACK[kind](_Cursor(data))


class _Cursor:
    """Reads one message from its start."""

    __slots__ = ("_at", "_data")

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    @property
    def more(self) -> bool:
        """Whether anything is left."""
        return self._at < len(self._data)

    def take(self, layout: str) -> tuple[Any, ...]:
        values = struct.unpack_from(layout, self._data, self._at)
        self._at += struct.calcsize(layout)
        return values

    def blob(self) -> bytes:
        (count,) = self.take("<I")
        start, self._at = self._at, self._at + count
        if self._at > len(self._data):
            raise ValueError("message shorter than its own count")
        return self._data[start : self._at]

    def array(self, dtype: str) -> Any:
        (count,) = self.take("<I")
        values = np.frombuffer(self._data, dtype=dtype, count=count, offset=self._at).copy()
        self._at += values.nbytes
        return values


def _blob(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


def _array(values: Any, dtype: str) -> bytes:
    exact = np.ascontiguousarray(values, dtype=dtype)
    return struct.pack("<I", exact.size) + exact.tobytes()


def _pack_chunk(chunk: RawChunk) -> bytes:
    return struct.pack("<iq", chunk.link, chunk.received_host_ns) + _blob(chunk.data)


def _unpack_chunk(cursor: _Cursor) -> RawChunk:
    link, received_host_ns = cursor.take("<iq")
    return RawChunk(link, received_host_ns, cursor.blob())


def _pack_imu(batch: ImuBatch) -> bytes:
    values = np.ascontiguousarray(batch.values, dtype="<f8")
    stored = batch.axes
    if stored != Axis.ALL and values[:, (Axis.ALL & ~stored).columns].view("<u8").any():
        stored = Axis.ALL
    if stored != Axis.ALL:
        values = values[:, stored.columns]
    return b"".join(
        (
            struct.pack("<B", batch.station),
            _blob(batch.clock.encode()),
            struct.pack("<BqB", int(batch.axes), batch.received_host_ns, int(stored)),
            _array(batch.t_ns, "<i8"),
            _array(values, "<f8"),
        )
    )


def _unpack_imu(cursor: _Cursor) -> ImuBatch:
    (station,) = cursor.take("<B")
    clock = ClockName(cursor.blob().decode())
    axes, received_host_ns, columns = cursor.take("<BqB")
    t_ns = cursor.array("<i8")
    stored = Axis(columns).columns
    values = np.zeros((t_ns.size, 6))
    values[:, stored] = cursor.array("<f8").reshape(t_ns.size, len(stored))
    return ImuBatch(Station(station), clock, t_ns, values, Axis(axes), received_host_ns)


def _pack_matches(matches: MatchSet) -> bytes:
    return b"".join(
        (
            struct.pack("<qq", matches.pair_id, matches.plan_id),
            *(_blob(clock.encode()) for clock in matches.clocks),
            _array(matches.mid_exposure_ns, "<i8"),
            struct.pack("<qqq", matches.exposure_ns, matches.row_time_ns, matches.matched_host_ns),
            *(_array(values, "<f8") for values in (matches.left_px, matches.right_px, matches.sigma_px)),
            struct.pack("<q", matches.filled),
            _pack_flow(matches.flow),
        )
    )


def _pack_flow(flow: Flow | None) -> bytes:
    if flow is None:
        return _array([], "<i8")
    places = _array(flow.index, "<i8") + _array(flow.earlier_px, "<f8") + _array(flow.sigma_px, "<f8")
    return _array([flow.earlier_pair_id], "<i8") + places


def _unpack_flow(cursor: _Cursor) -> Flow | None:
    """The flow at the end of a message; recordings of before have none."""
    earlier = cursor.array("<i8") if cursor.more else np.zeros(0, np.int64)
    if not earlier.size:
        return None
    index, earlier_px, sigma_px = cursor.array("<i8"), cursor.array("<f8").reshape(-1, 2), cursor.array("<f8")
    return Flow(int(earlier[0]), index, earlier_px, sigma_px)


def _unpack_matches(cursor: _Cursor) -> MatchSet:
    pair_id, plan_id = cursor.take("<qq")
    clocks = (ClockName(cursor.blob().decode()), ClockName(cursor.blob().decode()))
    mid_exposure_ns = cursor.array("<i8")
    exposure_ns, row_time_ns, matched_host_ns = cursor.take("<qqq")
    left_px, right_px = (cursor.array("<f8").reshape(-1, 2) for _ in range(2))
    return MatchSet(
        pair_id=pair_id,
        plan_id=plan_id,
        clocks=clocks,
        mid_exposure_ns=mid_exposure_ns,
        exposure_ns=exposure_ns,
        row_time_ns=row_time_ns,
        left_px=left_px,
        right_px=right_px,
        sigma_px=cursor.array("<f8"),
        matched_host_ns=matched_host_ns,
        filled=cursor.take("<q")[0] if cursor.more else 0,  # recordings of before had features alone
        flow=_unpack_flow(cursor),
    )


_PACK: dict[type, Callable[[Any], bytes]] = {RawChunk: _pack_chunk, ImuBatch: _pack_imu, MatchSet: _pack_matches}
_UNPACK: dict[type, Callable[[_Cursor], Any]] = {
    RawChunk: _unpack_chunk,
    ImuBatch: _unpack_imu,
    MatchSet: _unpack_matches,
}

"""Decode, track and plan for three sensors at 1 kHz, against mavutil's receive loop and a filterpy Kalman filter.

On one core, by processor time, in one run: the bytes of a simulated flight (6-axis HIGHRES_IMU at 1 kHz from the
fuselage and both tips, each on a clock of its own) in chunks of 4 ms as the service reads them, with TIMESYNC answers
and ticks between; medians of five rounds. What counts is the flight after its first seconds. The filterpy filter has as
many states and rows as ours; it does nothing but predict and update, at the tracker's rate and at the sensors'.
"""

from __future__ import annotations

import dataclasses
import gc
import platform
import statistics
import sys
import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter  # type: ignore[import-untyped]
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.decoder import Decoder
from companion.core.pipeline import start, step
from companion.core.tracking.states import make_layout
from companion.core.trigger.scheduling import Scheduling
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, Floats, OutputRecord, RawChunk, Record, Station, Tick, TimesyncReply
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.vehicle.wire import inertial_format, payloads, stamped
from tools.bench.decode import _udp_mavutil

TARGET = 40.0
MOST_TURN_MS = 2.0
SECONDS = 24.0
SETTLE_S = 13.0  # clocks in sync, ten seconds of learning, and the history run again with what was learned
_SEED = 3
_MS = 1_000_000
_EPOCH_NS = 5_000_000_000_000
_CHUNK_MS = 4
_TICK_MS = 10
_TURN_MS = 20
_TIMESYNC_MS = 100
_ROWS = 18
_REPEATS = 5  # whose medians count
_FILTER_STEPS = 1500
_CLOCKS = {Station.ROOT: ClockName.BOOT, Station.LEFT: ClockName.NODE_LEFT, Station.RIGHT: ClockName.NODE_RIGHT}


def run(seconds: float = SECONDS) -> list[dict[str, Any]]:
    """Rows with ``name``, ``ratio`` (seconds of data per CPU second) or ``turn_ms``, and perhaps ``target``."""
    belief = _airframe()
    flight = build_flight(belief, _SEED, seconds + 0.5)
    frames = _frames(flight, round(seconds * 1000))
    chunks = _chunks(frames)
    inputs = _inputs(flight, chunks)
    few = frames[: 3 * round(1000 * min(seconds, 3.0))]
    rounds = [
        (_cpu_s(lambda: _decoded(chunks)), *_pipeline_s(inputs, belief), _udp_mavutil(few)) for _ in range(_REPEATS)
    ]
    decode, early, late, plan, turn, mavutil_hz = (statistics.median(column) for column in zip(*rounds, strict=True))
    decode, settled = decode / seconds, seconds - SETTLE_S
    mavutil = mavutil_hz / 3000.0
    states, rate_hz = make_layout(belief).size, Settings().track_rate_hz
    filtered = _filter_step_s(states)
    same = f"filterpy, {states} states, {_ROWS} rows"
    return [
        _row("decode, track and plan", 1.0 / (decode + late / settled), TARGET),
        _row("  decode alone", 1.0 / decode),
        _row("  track alone", settled / (late - plan)),
        _row("  plan alone (forecast included)", settled / plan),
        _row(f"  track alone in the first {SETTLE_S:g} s, when it learns most", SETTLE_S / early),
        _turn_row(1e3 * (turn + decode * _TURN_MS * 1e-3)),
        _row("mavutil receive loop alone", mavutil),
        _row(f"{same}, stepped at the tracker's {rate_hz:g} Hz, alone", 1.0 / (rate_hz * filtered)),
        _row(f"{same}, stepped at the sensors' 1000 Hz, alone", 1.0 / (1000.0 * filtered)),
    ]


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 where the target is missed."""
    del arguments
    rows = run()
    kind = (
        "the distribution's" if sys.base_prefix == "/usr" else "not the distribution's, whose optimised build is faster"
    )
    print(f"Python {platform.python_version()}, {kind}")
    print(f"{'seconds of data per CPU second, 3 sensors x 1 kHz':55s} {'':>9s} {'target':>8s}")
    for row in rows:
        target = row.get("target")
        sign, value = ("<=", f"{row['turn_ms']:7.2f}ms") if "turn_ms" in row else (">=", f"{row['ratio']:8.1f}x")
        verdict = "" if target is None else f"{f'{sign} {target:g}':>8s}  {_verdict(row)}"
        print(f"{row['name']:55s} {value} {verdict}")
    return int(any(_verdict(row) == "missed" for row in rows if "target" in row))


def _row(name: str, ratio: float, target: float | None = None) -> dict[str, Any]:
    return {"name": name, "ratio": ratio} | ({} if target is None else {"target": target})


def _turn_row(turn_ms: float) -> dict[str, Any]:
    name = f"  processor time of a turn of {_TURN_MS} ms, 99 % below"
    return {"name": name, "turn_ms": turn_ms, "target": MOST_TURN_MS}


def _verdict(row: dict[str, Any]) -> str:
    met = row["turn_ms"] <= row["target"] if "turn_ms" in row else row["ratio"] >= row["target"]
    return "met" if met else "missed"


def _airframe() -> Airframe:
    """Nadir-2m whose fuselage sensor is as fast as its tips', and unfiltered."""
    belief = load_airframe("nadir-2m")
    root = dataclasses.replace(belief.root, rate_hz=1000.0, lowpass_accel_hz=0.0, lowpass_gyro_hz=0.0)
    return dataclasses.replace(belief, root=root)


def _frames(flight: Flight, count: int) -> list[bytes]:
    """The sensors' frames, three in each millisecond, stamped on their own clocks."""
    t_ns = np.arange(1, count + 1, dtype=np.int64) * _MS
    form = inertial_format("HIGHRES_IMU")
    columns: list[list[bytes]] = []
    for station, component in zip(Station, (1, 200, 201), strict=True):
        rest = payloads(_samples(flight, station, count), flight.airframe.sensor(station).source)
        clock = _CLOCKS[station]
        packer = mavlink.MAVLink(None, 1, component)
        column = []
        for sent_ns, body in zip(t_ns.tolist(), rest, strict=True):
            payload = stamped(form, _remote_ns(flight, clock, sent_ns), body)
            column.append(_framed(payload, packer))
        columns.append(column)
    return [frame for together in zip(*columns, strict=True) for frame in together]


def _framed(payload: bytes, packer: Any) -> bytes:
    message = mavlink.MAVLink_highres_imu_message(0, *[0.0] * 13, 0, 0)
    frame = bytes(message._pack(packer, message.crc_extra, payload))
    packer.seq = (packer.seq + 1) % 256
    return frame


def _samples(flight: Flight, station: Station, count: int) -> Floats:
    """Readings of a sensor: a node's own samples; the fuselage's are the truth and the noise of its kind."""
    if station in flight.nodes:
        return flight.nodes[station].values[:count]
    truth = flight.truth.series(np.arange(1, count + 1, dtype=np.int64) * _MS)
    sensor = flight.airframe.sensor(station)
    noise = np.repeat([sensor.accel_noise_mps2_rthz, sensor.gyro_noise_radps_rthz], 3) * np.sqrt(500.0)
    exact = np.hstack([truth.specific_force_mps2, truth.body_rate_radps])
    read: Floats = exact + noise * flight.generator("bench").standard_normal(exact.shape)
    return read


def _remote_ns(flight: Flight, clock: ClockName, boot_ns: int) -> int:
    return boot_ns if clock is ClockName.BOOT else flight.real.clocks[clock].from_boot(boot_ns)


def _chunks(frames: list[bytes]) -> list[RawChunk]:
    beat = mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 1, 1))
    size = 3 * _CHUNK_MS
    chunks = [RawChunk(0, _EPOCH_NS, bytes(beat))]
    for k in range(0, len(frames), size):
        chunks.append(RawChunk(0, _EPOCH_NS + (k // 3 + _CHUNK_MS) * _MS + _MS, b"".join(frames[k : k + size])))
    return chunks


def _inputs(flight: Flight, chunks: list[RawChunk]) -> list[Record]:
    """Inputs of the pipeline: decoded samples, completed exchanges and ticks, in order of time."""
    decoder = Decoder(_airframe(), 191)
    inputs: list[tuple[int, Record]] = []
    for chunk in chunks:
        inputs += [(chunk.received_host_ns, record) for record in decoder.decode_chunk(chunk)]
    last_ms = (chunks[-1].received_host_ns - _EPOCH_NS) // _MS
    for ms in range(_TICK_MS, last_ms, _TICK_MS):
        now_ns = _EPOCH_NS + ms * _MS
        inputs.append((now_ns, Tick(now_ns)))
        for clock in _CLOCKS.values() if ms % _TIMESYNC_MS == 0 else ():
            remote_ns = _remote_ns(flight, clock, ms * _MS)
            inputs.append((now_ns, TimesyncReply(clock, now_ns - 200_000, remote_ns, now_ns + 200_000)))
    return [record for _, record in sorted(inputs, key=lambda entry: entry[0])]


def _decoded(chunks: Iterable[RawChunk]) -> None:
    decoder = Decoder(_airframe(), 191)
    for chunk in chunks:
        decoder.decode_chunk(chunk)


@dataclasses.dataclass
class _TimedScheduling:
    """The pipeline's scheduling, with the processor time that it takes."""

    inner: Scheduling
    spent_s: float = 0.0
    plans: int = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def tick(self, *arguments: Any) -> list[OutputRecord]:
        begin = time.process_time()
        outputs = list(self.inner.tick(*arguments))
        self.spent_s += time.process_time() - begin
        self.plans += len(outputs)
        return outputs


def _pipeline_s(inputs: Iterable[Record], belief: Airframe) -> tuple[float, float, float, float]:
    """Processor time until the pipeline has settled, after that, of planning after that, and of a turn (99 % below)."""
    state = start(belief, Settings())
    assert state.scheduling is not None
    timed = _TimedScheduling(state.scheduling)
    state.scheduling = timed  # type: ignore[assignment]
    settled_s = planned_s = 0.0
    turns_s: list[float] = []
    gc.collect()  # as the service does before it turns (service/inertial.py)
    gc.freeze()
    begin = time.process_time()
    for record in inputs:
        if not settled_s and isinstance(record, Tick) and record.now_host_ns >= _EPOCH_NS + SETTLE_S * 1e9:
            settled_s, planned_s = time.process_time(), timed.spent_s
        if settled_s and isinstance(record, Tick) and record.now_host_ns // _MS % _TURN_MS == 0:
            turns_s.append(time.process_time())
        state, _ = step(state, record)
    if not timed.plans or not settled_s:
        raise RuntimeError(f"{timed.plans} plans made: nothing was measured")
    late_s, planning_s = time.process_time() - settled_s, timed.spent_s - planned_s
    gc.unfreeze()
    return settled_s - begin, late_s, planning_s, float(np.percentile(np.diff(turns_s), 99))


def _filter_step_s(states: int) -> float:
    """Processor time of one predict and update of a filterpy filter of that size, dense as ours would be."""
    rng = np.random.default_rng(1)
    plain = KalmanFilter(dim_x=states, dim_z=_ROWS)
    plain.F = np.eye(states) + 0.01 * rng.standard_normal((states, states)) / states
    plain.H = rng.standard_normal((_ROWS, states))
    plain.Q, plain.R = 1e-3 * np.eye(states), np.eye(_ROWS)
    readings = rng.standard_normal((_FILTER_STEPS, _ROWS, 1))

    def filtered() -> None:
        for reading in readings:
            plain.predict()
            plain.update(reading)

    return _cpu_s(filtered) / _FILTER_STEPS


def _cpu_s(work: Callable[[], None]) -> float:
    begin = time.process_time()
    work()
    return time.process_time() - begin


if __name__ == "__main__":
    raise SystemExit(main())

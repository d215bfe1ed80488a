"""A flight without sockets: the records that the service would have made of it, in order of arrival."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from companion.records import AutopilotParameter, ClockName, Floats, ImuBatch, TimesyncReply, VehicleState
from companion.sim.flight.aircraft import airspeed
from companion.sim.flight.flight import LOOP_HZ, Flight
from companion.sim.flight.sensors import SensorStream

HOST_EPOCH_NS = 5_000_000_000_000  # convention: any time that no boot clock shows, so that mixed clocks are found out
_READ_NS = 5_000_000  # chosen: the service reads its link at least so often
_TIMESYNC_NS = 100_000_000  # convention: the adapter's ten exchanges a second
_VEHICLE_NS = 100_000_000  # chosen: ten states a second, the rate of an autopilot's own attitude stream
Arriving = AutopilotParameter | ImuBatch | TimesyncReply | VehicleState


def flight_records(flight: Flight) -> Iterator[Arriving]:
    """Yield parameters, inertial batches, TIMESYNC replies and vehicle states by the host time of their arrival.

    The host clock is boot time plus :data:`HOST_EPOCH_NS`. Stamps are raw, on the clocks that the airframe names;
    values are body axes. Everything follows from the flight's seed.
    """
    records: list[Arriving] = [*_parameters(flight), *_batches(flight), *_exchanges(flight), *_vehicle_states(flight)]
    # the sort is stable: what arrives together keeps this order
    yield from sorted(records, key=lambda record: record.received_host_ns)


def _parameters(flight: Flight) -> Iterator[AutopilotParameter]:
    sensor = flight.real.actual.root
    for name, value in (
        ("SCHED_LOOP_RATE", LOOP_HZ),
        ("INS_ACCEL_FILTER", sensor.lowpass_accel_hz),
        ("INS_GYRO_FILTER", sensor.lowpass_gyro_hz),
    ):
        yield AutopilotParameter(name, value, HOST_EPOCH_NS)


def _batches(flight: Flight) -> Iterator[ImuBatch]:
    for station, stream in flight.streams().items():
        yield from _reads(stream, flight.generator(f"link {station}"))


def _reads(stream: SensorStream, rng: np.random.Generator) -> Iterator[ImuBatch]:
    """Cut a stream into what successive reads of the link return."""
    delay = 50_000 + rng.exponential(100_000.0, len(stream.sent_boot_ns)).astype(np.int64)
    arrival = np.maximum.accumulate(stream.sent_boot_ns + delay)
    edges = np.flatnonzero(np.diff(arrival // _READ_NS)) + 1
    bounds = [0, *edges.tolist(), len(arrival)]
    axes = stream.sensor.axes
    for start, stop in itertools.pairwise(bounds):
        if stop > start:
            received = HOST_EPOCH_NS + int(arrival[stop - 1])
            yield ImuBatch(
                stream.station, stream.clock, stream.stamp_ns[start:stop], stream.values[start:stop], axes, received
            )


def _exchanges(flight: Flight) -> Iterator[TimesyncReply]:
    clocks = {stream.clock for stream in flight.nodes.values()} | ({ClockName.BOOT} if flight.backends else set())
    loop_ns = round(1e9 / LOOP_HZ)
    for clock in sorted(clocks):
        rng = flight.generator(f"timesync {clock}")
        for due in range(_TIMESYNC_NS, round(flight.duration_s * 1e9), _TIMESYNC_NS):
            sent = due + int(rng.integers(_TIMESYNC_NS // 5))  # as the adapter does: at every phase of that loop
            outward_ns, inward_ns = (100_000 + rng.exponential(150_000.0, 2)).astype(np.int64).tolist()
            handled = sent + outward_ns
            if clock is ClockName.BOOT:
                # the autopilot's main loop looks at its link once a turn
                handled = -(-handled // loop_ns) * loop_ns
                remote = handled
            else:
                remote = flight.real.clocks[clock].from_boot(handled)
            yield TimesyncReply(clock, HOST_EPOCH_NS + sent, remote, HOST_EPOCH_NS + handled + inward_ns)


def _vehicle_states(flight: Flight) -> Iterator[VehicleState]:
    times = np.arange(_VEHICLE_NS, round(flight.duration_s * 1e9), _VEHICLE_NS, dtype=np.int64)
    truth = flight.truth.series(times)
    t_s: Floats = times * np.float64(1e-9)
    lever = flight.throttle(t_s)
    airspeed_mps = airspeed(flight.plan, t_s)[0]
    error = flight.navigation_error()
    told_mps, told_rad = (truth.velocity_ned_mps + error.ned_mps(t_s)).tolist(), truth.euler_rad + error.euler_rad
    rows = zip(times.tolist(), told_rad, truth.velocity_ned_mps, lever, airspeed_mps, told_mps, strict=True)
    for t_ns, (roll, pitch, yaw), velocity, throttle, speed_mps, (north, east, down) in rows:
        yield VehicleState(
            t_boot_ns=t_ns // 1_000_000 * 1_000_000,
            received_host_ns=HOST_EPOCH_NS + t_ns + 300_000,
            roll_rad=float(roll),
            pitch_rad=float(pitch),
            yaw_rad=float((yaw + np.pi) % (2 * np.pi) - np.pi),
            airspeed_mps=float(speed_mps),
            climb_mps=float(-velocity[2]),
            throttle=float(throttle),
            armed=True,
            on_ground=any(roll.from_s <= 1e-9 * t_ns < roll.until_s for roll in flight.plan.rolls_on_ground),
            velocity_ned_mps=(north, east, down),
            velocity_sigma_mps=flight.world.velocity_mps,
        )

"""Inertial sensors sampled while the flight is flown: the faults of :mod:`companion.sim.flight.sensors`, by segments.

Each call of :meth:`LiveSensor.until` gives the samples that have become known since the last. Bias, clock and noise
have generators of their own, so that a flight is equal for equal seeds and equal commands.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from companion.records import ClockName, Floats, Ints, Station
from companion.sim.flight.gauss_markov import between
from companion.sim.flight.perturb import TrueClock
from companion.sim.flight.sensors import Lowpass, RealSensor, SensorStream, corrupted, drifting, limited, on_wire
from companion.sim.landing.landing_flight import LandingFlight

_MARGIN_NS = 3_000_000  # behind the truth's end: half a window, and offsets of the stamps (choice)
_DELAY_NS, _WIRE_NS = 150_000, 50_000.0  # of a node's work and wire, as in companion.sim.flight.sensors (convention)


class LiveSensor:
    """One station's sensor on its own clock.

    ``flight`` has truth, wing and errors; samples come every ``period_ns`` of the sensor's clock.
    """

    def __init__(self, flight: LandingFlight, station: Station, period_ns: int) -> None:
        self.sensor = flight.real.actual.sensor(station)
        self._real = RealSensor(flight.truth, flight.model, station, self.sensor, flight.real.errors[station])
        self._period_ns = period_ns
        self._rng = np.random.default_rng([flight.seed, 1, station])
        self._rate_hz = 1e9 / period_ns
        self._grid_s: Floats = np.arange(0.0, flight.longest_s + 2.0, 0.5)
        self._bias = drifting(self._grid_s, self.sensor.bias_time_s, 6, self._rng)
        self._accel = Lowpass(self.sensor.lowpass_accel_hz, self._rate_hz)
        self._gyro = Lowpass(self.sensor.lowpass_gyro_hz, self._rate_hz)
        source = self.sensor.source.clock
        self._clock = TrueClock(0, 0.0) if source is ClockName.BOOT else flight.real.clocks[source]
        self._next_ns = 0 if source is ClockName.BOOT else self._first_ns()

    def until(self) -> tuple[Ints, Ints, Floats]:
        """Stamps on the sensor's clock, true boot times and finished samples (n, 6) since the last call."""
        end_ns = self._real.truth.end_ns - _MARGIN_NS
        count = max((self._clock.from_boot(end_ns) - self._next_ns) // self._period_ns + 1, 0)
        stamps = self._next_ns + self._period_ns * np.arange(count, dtype=np.int64)
        self._next_ns += count * self._period_ns
        boot = self._clock.to_boot(stamps)
        return stamps, boot, self._samples(boot) if count else np.zeros((0, 6))

    def _first_ns(self) -> int:
        """A node's phase is its own."""
        return self._clock.from_boot(2 * self._period_ns) + int(self._rng.integers(self._period_ns))

    def _samples(self, boot: Ints) -> Floats:
        """Motion at the station with every error of the sensor, as it is sent."""
        _, readings = self._real.felt(boot, self._period_ns)
        drift = between(self._grid_s, self._bias, boot * np.float64(1e-9))
        raw = corrupted(readings, drift, self.sensor, self._real.errors, self._rate_hz, self._rng)
        values = limited(raw, self.sensor)
        filtered = np.hstack([self._accel.run(values[:, :3]), self._gyro.run(values[:, 3:])])
        return on_wire(filtered, self.sensor)


class LiveNode:
    """A wing node: its sensor's samples as they leave it."""

    def __init__(self, flight: LandingFlight, station: Station) -> None:
        sensor = flight.real.actual.sensor(station)
        self._station = station
        self._sensor = LiveSensor(flight, station, round(1e9 / sensor.rate_hz))
        self._period_ns = round(1e9 / sensor.rate_hz)
        self._rng = np.random.default_rng([flight.seed, 2, station])
        self._sent_ns = 0

    def empty(self) -> SensorStream:
        """The stream before its first sample."""
        none = np.zeros(0, dtype=np.int64)
        sensor = self._sensor.sensor
        return SensorStream(self._station, sensor.source.clock, sensor, none, none, np.zeros((0, 6)))

    def until(self) -> SensorStream:
        """Samples that have become known since the last call."""
        stamps, boot, values = self._sensor.until()
        delay = self._period_ns // 2 + _DELAY_NS + self._rng.exponential(_WIRE_NS, len(boot)).astype(np.int64)
        sent = np.maximum.accumulate(np.maximum(boot + delay, self._sent_ns)) if len(boot) else boot
        self._sent_ns = int(sent[-1]) if len(sent) else self._sent_ns
        return replace(self.empty(), sent_boot_ns=sent, stamp_ns=stamps // 1000 * 1000, values=values)

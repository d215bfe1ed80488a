"""Inertial sensors sampled while the flight is flown: the faults of :mod:`companion.sim.flight.sensors`, by segments.

Each call of :meth:`LiveSensor.until` gives the samples that have become known since the last. Bias, clock and noise
have generators of their own, so that a flight is equal for equal seeds and equal commands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from companion.core.stereo.rotation import exp_rotation
from companion.core.wing.effect import sensed
from companion.core.wing.lowpass import Biquad
from companion.core.wing.model import WingModel
from companion.params.airframe import Sensor
from companion.records import ClockName, Floats, Ints, Station
from companion.sim.flight.perturb import SensorErrors, TrueClock
from companion.sim.flight.sensors import SensorStream, drifting, limited, on_wire, station_readings
from companion.sim.landing.growing_truth import GrowingTruth
from companion.sim.landing.landing_flight import LandingFlight

_MARGIN_NS = 3_000_000  # behind the truth's end: half a window, and offsets of the stamps (choice)
_DELAY_NS, _WIRE_NS = 150_000, 50_000.0  # of a node's work and wire, as in companion.sim.flight.sensors (convention)


@dataclass(slots=True)
class _Lowpass:
    """A biquad over (n, 3) samples that come by segments; settled on the first."""

    biquad: Biquad | None
    state: Floats | None = None

    @classmethod
    def of(cls, cutoff_hz: float, rate_hz: float) -> _Lowpass:
        """The autopilot's filter; none for a cutoff of 0 or beyond its reach."""
        return cls(Biquad.lowpass(cutoff_hz, rate_hz) if 0.0 < cutoff_hz < 0.45 * rate_hz else None)

    def run(self, values: Floats) -> Floats:
        """Filter the next segment."""
        from scipy.signal import lfilter  # 0.8 s to import, so late

        if self.biquad is None or not len(values):
            return values
        b, a = np.array(self.biquad.b), np.array([1.0, *self.biquad.a])
        if self.state is None:
            self.state = np.stack([(1 - b[0]) * values[0], (b[2] - a[2]) * values[0]])
        initial: Any = self.state
        out, self.state = lfilter(b, a, values, axis=0, zi=initial)
        return np.asarray(out)


class LiveSensor:
    """One station's sensor on its own clock.

    ``flight`` has truth, wing and errors; samples come every ``period_ns`` of the sensor's clock.
    """

    def __init__(self, flight: LandingFlight, station: Station, period_ns: int) -> None:
        self.sensor: Sensor = flight.real.actual.sensor(station)
        self._truth: GrowingTruth = flight.truth
        self._model: WingModel = flight.model
        self._station = station
        self._errors: SensorErrors = flight.real.errors[station]
        self._period_ns = period_ns
        self._rng = np.random.default_rng([flight.seed, 1, station])
        self._rate_hz = 1e9 / period_ns
        self._grid_s: Floats = np.arange(0.0, flight.longest_s + 2.0, 0.5)
        self._bias = drifting(self._grid_s, self.sensor.bias_time_s, 6, self._rng)
        self._accel = _Lowpass.of(self.sensor.lowpass_accel_hz, self._rate_hz)
        self._gyro = _Lowpass.of(self.sensor.lowpass_gyro_hz, self._rate_hz)
        source = self.sensor.source.clock
        self._clock = TrueClock(0, 0.0) if source is ClockName.BOOT else flight.real.clocks[source]
        self._next_ns = 0 if source is ClockName.BOOT else self._first_ns()

    def until(self) -> tuple[Ints, Ints, Floats]:
        """Stamps on the sensor's clock, true boot times and finished samples (n, 6) since the last call."""
        end_ns = self._truth.end_ns - _MARGIN_NS
        count = max((self._clock.from_boot(end_ns) - self._next_ns) // self._period_ns + 1, 0)
        stamps = self._next_ns + self._period_ns * np.arange(count, dtype=np.int64)
        self._next_ns += count * self._period_ns
        boot = np.round((stamps - self._clock.epoch_ns) / (1 + self._clock.skew_ppm * 1e-6)).astype(np.int64)
        if not count:
            return stamps, boot, np.zeros((0, 6))
        return stamps, boot, self._finished(self._raw(boot))

    def _first_ns(self) -> int:
        """A node's phase is its own."""
        return self._clock.from_boot(2 * self._period_ns) + int(self._rng.integers(self._period_ns))

    def _raw(self, boot: Ints) -> Floats:
        """Motion at the station with every error of the sensor."""
        t_s: Floats = boot * np.float64(1e-9)
        shown_s = t_s - self._errors.time_offset_s
        for effect in self._model.effects:
            shown_s = effect.sample_time(self._station, shown_s)
        end_ns = self._truth.end_ns - self._period_ns
        shown = np.clip(np.round(shown_s * 1e9).astype(np.int64), self._period_ns, end_ns)
        readings = station_readings(self._truth, self._model, self._station, self.sensor, shown, self._period_ns)
        felt = sensed(self._model.effects, self._station, t_s, readings)
        return self._corrupted(felt, t_s)

    def _corrupted(self, felt: Floats, t_s: Floats) -> Floats:
        errors, sensor = self._errors, self.sensor
        turn = exp_rotation(-errors.misalignment_rad)
        values = np.hstack([felt[:, :3] @ turn.T, felt[:, 3:] @ turn.T])
        values *= 1.0 + np.concatenate([errors.accel_scale, errors.gyro_scale])
        sigma = np.repeat([sensor.accel_bias_sigma_mps2, sensor.gyro_bias_sigma_radps], 3)
        density = np.repeat([sensor.accel_noise_mps2_rthz, sensor.gyro_noise_radps_rthz], 3)
        bias = np.stack([np.interp(t_s, self._grid_s, column) for column in self._bias.T], 1)
        white = self._rng.standard_normal(values.shape)
        return np.asarray(values + sigma * bias + density * np.sqrt(self._rate_hz / 2) * white)

    def _finished(self, raw: Floats) -> Floats:
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

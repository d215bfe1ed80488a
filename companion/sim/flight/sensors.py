"""Inertial sensors with all their faults, for a whole flight at once.

Order of the faults: station motion (averaged over the sample, as an anti-alias filter does), effects, misalignment,
scale, bias (Ornstein-Uhlenbeck), white noise, warm-up and vibration of the world flown in, saturation, quantisation,
low-pass, rounding on the wire. A node samples on its own clock and stamps the middle of its averaging window; the
autopilot stamps what it sends at the instant of sending.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.core.stereo.rotation import exp_rotation
from companion.core.wing.effect import sensed
from companion.core.wing.lowpass import Biquad
from companion.core.wing.model import WingModel
from companion.core.wing.sensing import ModalPath, RigidMotion, lever_arm_mps2, sense_station
from companion.params.airframe import Sensor
from companion.records import ClockName, Floats, Ints, Side, Station
from companion.sim.flight.gauss_markov import between, wandering
from companion.sim.flight.perturb import SensorErrors, TrueClock
from companion.sim.flight.truth import FlightTruth, TruthSeries
from companion.sim.flight.vibration import SensorDisturbance
from companion.units import GRAVITY_MPS2

BACKEND_HZ = 1000.0  # convention: ArduPilot's backend rate of most sensors
MILLI_G_MPS2 = GRAVITY_MPS2 / 1000.0  # by definition: resolution of the old messages (MAVLink common.xml)
MILLI_RADPS = 1e-3  # by definition: resolution of the old messages (MAVLink common.xml)
_WORD = 32768  # counts of a 16-bit converter, one way (by definition)
_BIAS_STEP_S = 0.5  # chosen: biases drift over minutes, straight lines of half a second follow them
_COARSE_MESSAGES = ("RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")


@dataclass(frozen=True, slots=True)
class SensorStream:
    """Everything one sensor says in a flight.

    Attributes
    ----------
    sent_boot_ns : (n,) int64
        True instants at which the samples leave the sender; not decreasing.
    stamp_ns : (n,) int64
        What each sample is stamped with on ``clock``, at the resolution of the wire.
    values : (n, 6) float64
        Body axes, at the resolution of the wire.
    """

    station: Station
    clock: ClockName
    sensor: Sensor
    sent_boot_ns: Ints
    stamp_ns: Ints
    values: Floats


def station_readings(
    truth: FlightTruth, model: WingModel, station: Station, sensor: Sensor, t_boot_ns: Ints, window_ns: int
) -> Floats:
    """Readings (n, 6) of an ideal sensor that averages the wing's motion over ``window_ns`` centred on each instant."""
    middle = truth.series(t_boot_ns)
    motion = RigidMotion(middle.specific_force_mps2, middle.body_rate_radps, middle.angular_accel_radps2)
    position = np.array(sensor.position_m)
    if station is Station.ROOT:
        force = middle.specific_force_mps2 + lever_arm_mps2(motion, position)
        return np.hstack([force, middle.body_rate_radps])
    path = _averaged(truth, model, middle, window_ns)
    return sense_station(model, Side(station - 1), position, motion, path)


def _averaged(truth: FlightTruth, model: WingModel, middle: TruthSeries, window_ns: int) -> ModalPath:
    """Mean modal velocity and acceleration over a window: differences of the truth at its ends."""
    before = truth.series(middle.t_boot_ns - window_ns // 2)
    after = truth.series(middle.t_boot_ns + (window_ns - window_ns // 2))
    velocity = (after.q_m - before.q_m) / (window_ns * 1e-9)
    acceleration = (after.qdot_mps - before.qdot_mps) / (window_ns * 1e-9)
    return ModalPath(model.present(middle.q_m), model.present(velocity), model.present(acceleration))


def corrupted(
    readings: Floats, drift: Floats, sensor: Sensor, errors: SensorErrors, rate_hz: float, rng: np.random.Generator
) -> Floats:
    """Add misalignment, scale, bias and white noise to ideal readings (n, 6) taken at ``rate_hz``.

    ``drift`` (n, 6) are the biases in multiples of their sigma.
    """
    turn = exp_rotation(-errors.misalignment_rad)
    values = np.hstack([readings[:, :3] @ turn.T, readings[:, 3:] @ turn.T])
    values *= 1.0 + np.concatenate([errors.accel_scale, errors.gyro_scale])
    sigma = np.repeat([sensor.accel_bias_sigma_mps2, sensor.gyro_bias_sigma_radps], 3)
    density = np.repeat([sensor.accel_noise_mps2_rthz, sensor.gyro_noise_radps_rthz], 3)
    values += sigma * drift
    # a one-sided density d sampled at f over its Nyquist band has the variance d^2 f / 2
    values += density * math.sqrt(rate_hz / 2) * rng.standard_normal(values.shape)
    return values


def drifting(t_s: Floats, time_s: float, columns: int, rng: np.random.Generator) -> Floats:
    """Ornstein-Uhlenbeck paths of unit variance, (n, columns), exact every half second and straight in between."""
    nodes_s = np.arange(int(t_s[-1] / _BIAS_STEP_S) + 2) * np.float64(_BIAS_STEP_S)
    return between(nodes_s, wandering((len(nodes_s), columns), _BIAS_STEP_S / time_s, rng), t_s)


def limited(values: Floats, sensor: Sensor) -> Floats:
    """Saturate and quantise values (n, 6) as the sensor's converter does, and zero the axes that it does not send."""
    ranges = np.repeat([sensor.accel_range_mps2, sensor.gyro_range_radps], 3)
    lsb = ranges / _WORD
    counts = np.clip(np.round(np.clip(values, -ranges, ranges) / lsb), -_WORD, _WORD - 1)
    return np.asarray(counts * lsb * sensor.axes.mask)


def on_wire(values: Floats, sensor: Sensor) -> Floats:
    """Round values (n, 6) to the message's resolution: whole mg and mrad/s in the old messages."""
    if sensor.source.message not in _COARSE_MESSAGES:
        return values
    lsb = np.repeat([MILLI_G_MPS2, MILLI_RADPS], 3)
    return np.asarray(np.clip(np.round(values / lsb), -_WORD, _WORD - 1) * lsb)


def lowpassed(values: Floats, accel_hz: float, gyro_hz: float, rate_hz: float) -> Floats:
    """Run the autopilot's low-passes over all samples (n, 6) of a flight."""
    return np.hstack([Lowpass(accel_hz, rate_hz).run(values[:, :3]), Lowpass(gyro_hz, rate_hz).run(values[:, 3:])])


class Lowpass:
    """The autopilot's biquad over (n, 3) samples that may come by segments; settled on the first.

    It gives what ``Biquad.run`` gives, by scipy's compiled loop. A cutoff of 0, or beyond the filter's reach, passes
    all.
    """

    def __init__(self, cutoff_hz: float, rate_hz: float) -> None:
        self._biquad = Biquad.lowpass(cutoff_hz, rate_hz) if 0.0 < cutoff_hz < 0.45 * rate_hz else None
        self._state: Any = None

    def run(self, values: Floats) -> Floats:
        """Filter the next samples (n, 3)."""
        from scipy.signal import lfilter  # 0.8 s to import, so late

        if self._biquad is None or not len(values):
            return values
        b, a = np.array(self._biquad.b), np.array([1.0, *self._biquad.a])
        if self._state is None:  # the direct form's two states
            self._state = np.stack([(1 - b[0]) * values[0], (b[2] - a[2]) * values[0]])
        out, self._state = lfilter(b, a, values, axis=0, zi=self._state)
        return np.asarray(out)


@dataclass(frozen=True, slots=True)
class RealSensor:
    """One sensor on the real wing: what it sees and what it does wrong."""

    truth: FlightTruth
    model: WingModel
    station: Station
    sensor: Sensor
    errors: SensorErrors
    disturbance: SensorDisturbance | None = None

    def sample(self, t_boot_ns: Ints, period_ns: int, rng: np.random.Generator) -> Floats:
        """Raw samples (n, 6) stamped ``t_boot_ns``, before low-pass, saturation and quantisation."""
        t_s: Floats = t_boot_ns * np.float64(1e-9)
        shown_s, readings = self.felt(t_boot_ns, period_ns)
        drift = drifting(t_s, self.sensor.bias_time_s, 6, rng)
        values = corrupted(readings, drift, self.sensor, self.errors, 1e9 / period_ns, rng)
        if self.disturbance is None:
            return values
        return self.disturbance.felt(values, shown_s, period_ns * 1e-9, self.sensor, rng)

    def felt(self, t_boot_ns: Ints, period_ns: int) -> tuple[Floats, Floats]:
        """Instants (n,) that samples stamped ``t_boot_ns`` show, and the readings (n, 6) there with all effects."""
        t_s: Floats = t_boot_ns * np.float64(1e-9)
        shown_s = t_s - self.errors.time_offset_s
        for effect in self.model.effects:
            shown_s = effect.sample_time(self.station, shown_s)
        shown_ns = np.clip(np.round(shown_s * 1e9).astype(np.int64), period_ns, self.truth.end_ns - period_ns)
        readings = station_readings(self.truth, self.model, self.station, self.sensor, shown_ns, period_ns)
        return shown_s, sensed(self.model.effects, self.station, t_s, readings)

    def finish(self, raw: Floats, rate_hz: float) -> Floats:
        """Saturate and quantise values (n, 6), low-pass as the airframe says, and round as the message does."""
        mounted = self.sensor
        calm = lowpassed(limited(raw, mounted), mounted.lowpass_accel_hz, mounted.lowpass_gyro_hz, rate_hz)
        return on_wire(calm, mounted)

    def recorded(self, finished: Floats, t_boot_ns: Ints) -> Floats:
        """Finished samples (n, 6) with what shows in samples themselves, which noise and low-pass have blurred."""
        shown_s: Floats = t_boot_ns * np.float64(1e-9)
        defects = [effect for effect in self.model.effects if effect.in_samples]
        for effect in defects:
            shown_s = effect.sample_time(self.station, shown_s)
        rows = np.arange(len(shown_s))  # of a lost sample, which shows the instant before, that before it
        rows = np.maximum.accumulate(np.where(np.diff(shown_s, prepend=-np.inf) == 0.0, 0, rows))
        return sensed(defects, self.station, shown_s, finished[rows])


def node_stream(real: RealSensor, clock: TrueClock, duration_s: float, rng: np.random.Generator) -> SensorStream:
    """Sample a wing node for the whole flight: own clock, own phase, own delay on the wire."""
    sensor = real.sensor
    period = round(1e9 / sensor.rate_hz)
    first = clock.from_boot(2 * period) + int(rng.integers(period))
    count = int((duration_s * 1e9 - 4 * period) // period)
    node_ns = first + period * np.arange(count, dtype=np.int64)
    boot = clock.to_boot(node_ns)
    values = real.recorded(real.finish(real.sample(boot, period, rng), sensor.rate_hz), boot)
    # the window must end before the sample exists; then a little work and the wire
    delay = period // 2 + 150_000 + rng.exponential(50_000.0, count).astype(np.int64)
    sent = np.maximum.accumulate(boot + delay)
    return SensorStream(real.station, sensor.source.clock, sensor, sent, node_ns // 1000 * 1000, values)


@dataclass(frozen=True, slots=True)
class BackendImu:
    """An IMU inside the autopilot: raw samples at 1 kHz of boot time, from which filtered ones are made for sending."""

    station: Station
    sensor: Sensor
    raw: Floats

    def filtered(self, accel_hz: float, gyro_hz: float) -> Floats:
        """All samples, saturated and quantised, through INS_ACCEL_FILTER and INS_GYRO_FILTER, as sent, (n, 6)."""
        return on_wire(lowpassed(limited(self.raw, self.sensor), accel_hz, gyro_hz, BACKEND_HZ), self.sensor)

    def latest(self, tick_ns: Ints) -> Ints:
        """Index (n,) of the newest sample at each instant."""
        return np.minimum(tick_ns // round(1e9 / BACKEND_HZ), len(self.raw) - 1)


def backend_imu(real: RealSensor, rng: np.random.Generator) -> BackendImu:
    """Sample an autopilot's IMU at its backend rate for the whole truth."""
    period = round(1e9 / BACKEND_HZ)
    t_ns = period * np.arange(int(real.truth.duration_s * BACKEND_HZ), dtype=np.int64)
    return BackendImu(real.station, real.sensor, real.sample(t_ns, period, rng))


@dataclass(frozen=True, slots=True)
class SendTimes:
    """When an autopilot sends one message: the loop ticks, and the instants of sending some 0.1 ms later."""

    tick_ns: Ints
    sent_ns: Ints


def send_times(interval_ms: int, loop_hz: float, from_ns: int, to_ns: int, rng: np.random.Generator) -> SendTimes:
    """ArduPilot's pattern: due every whole number of ms, sent at the first loop tick from then on.

    At 400 Hz an interval of 3 ms gives steps of 2.5, 2.5, 2.5, 2.5 and 5 ms (measured on a recorded flight); one send
    in 3000 is late by a whole loop and the next follows at once.
    """
    loop_ns = round(1e9 / loop_hz)
    due = np.arange(from_ns, to_ns, interval_ms * 1_000_000, dtype=np.int64)
    tick = -(-due // loop_ns) * loop_ns
    late = rng.random(len(tick)) < 1 / 3000
    sent = tick + 100_000 + rng.exponential(50_000.0, len(tick)).astype(np.int64) + late * loop_ns
    return SendTimes(tick, np.maximum.accumulate(sent))


def autopilot_stream(
    imu: BackendImu,
    interval_ms: int,
    loop_hz: float,
    filters_hz: tuple[float, float],
    duration_s: float,
    rng: np.random.Generator,
) -> SensorStream:
    """Send a backend IMU at a granted interval with fixed filters; stamps are the send times."""
    times = send_times(interval_ms, loop_hz, 10_000_000, round(duration_s * 1e9), rng)
    values = imu.filtered(*filters_hz)[imu.latest(times.tick_ns)]
    unit = 1_000_000 if imu.sensor.source.message.startswith("SCALED") else 1000
    stamp = times.sent_ns // unit * unit
    return SensorStream(imu.station, ClockName.BOOT, imu.sensor, times.sent_ns, stamp, values)

"""The tracker on motions in closed form, written out here without anything of ours: signs, rigid motion, phase, sigma.

The wing moves as sums of sines; every sensor is sampled at 1 kHz from the formulas of the common physics: tip specific
force ``f_root + omega' x r + omega x (omega x r) + (0, 0, p^2 w - w'')``, with a lateral ``2 p w' + p' w`` by the roll
and ``+-1.162 (w w'' + w'^2)`` by the bent wing's way inboard, turned about body x by +slope on the left and by -slope
on the right.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.tracking.prediction import Forecast
from companion.core.tracking.tracker import WingTracker
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Axis, ClockName, Deflection, ImuBatch, ModeState, Station, Validity

G = 9.80665
EPOCH_NS = 50_000_000_000
S = 1.39


@dataclasses.dataclass(frozen=True)
class Motion:
    """Amplitudes (m), frequencies (Hz) and phases of both modes, and a rigid motion."""

    symmetric: tuple[float, float, float] = (0.006, 5.0, 0.4)
    antisymmetric: tuple[float, float, float] = (0.004, 6.4, 1.9)
    roll: tuple[float, float] = (0.0, 0.3)  # rad/s, Hz
    pull: tuple[float, float] = (0.0, 0.2)  # m/s^2, Hz

    def q(self, t: np.ndarray, order: int = 0) -> np.ndarray:
        """Symmetric and antisymmetric coordinate about trim, or a derivative: (2, n)."""
        rows = []
        for amplitude, frequency, phase in (self.symmetric, self.antisymmetric):
            w = 2 * np.pi * frequency
            rows.append(amplitude * w**order * np.cos(w * t + phase + order * np.pi / 2))
        return np.array(rows)


def _airframe() -> Airframe:
    return load_airframe("nadir-2m")


def _static(airframe: Airframe, motion: Motion, t: np.ndarray) -> np.ndarray:
    amplitude, frequency = motion.pull
    load = amplitude / G * np.sin(2 * np.pi * frequency * t)
    return airframe.wing.trim_bend_m.value + airframe.wing.bend_per_g_m.value * load


def _streams(airframe: Airframe, motion: Motion, duration_s: float) -> dict[Station, tuple[np.ndarray, np.ndarray]]:
    t = np.arange(round(duration_s * 1000)) * 1e-3 + 0.5e-3
    rng = np.random.default_rng(5)
    p_amplitude, p_hz = motion.roll
    roll = 2 * np.pi * p_hz
    omega, turn, force = np.zeros((len(t), 3)), np.zeros((len(t), 3)), np.zeros((len(t), 3))
    omega[:, 0], turn[:, 0] = p_amplitude * np.sin(roll * t), p_amplitude * roll * np.cos(roll * t)
    omega[:, 2] = 0.3 * omega[:, 0]
    turn[:, 2] = 0.3 * turn[:, 0]
    amplitude, frequency = motion.pull
    force[:, 2] = -G - amplitude * np.sin(2 * np.pi * frequency * t)
    force[:, 1] = 0.5 * np.sin(2 * np.pi * 0.25 * t) * (p_amplitude > 0)
    (qs, qa), (vs, va), (as_, aa) = motion.q(t), motion.q(t, 1), motion.q(t, 2)
    static = _static(airframe, motion, t)
    out = {Station.ROOT: np.hstack([force, omega])}
    for station, side in ((Station.LEFT, -1), (Station.RIGHT, 1)):
        r = np.array([0.0, float(side), 0.0])
        f = force + np.cross(turn, r) + np.cross(omega, np.cross(omega, r))
        lift, rate = qs + static + side * qa, vs + np.gradient(static, 1e-3) + side * va
        rise = as_ + side * aa + np.gradient(np.gradient(static, 1e-3), 1e-3)
        f[:, 1] += 2 * omega[:, 0] * rate + turn[:, 0] * lift - side * 1.16194 * (lift * rise + rate**2)
        f[:, 2] += omega[:, 0] ** 2 * lift - rise
        slope = S * lift
        angle = -side * slope  # about +x
        c, s = np.cos(angle), np.sin(angle)
        rates = omega.copy()
        rates[:, 0] += -side * S * rate
        turned = [np.stack([v[:, 0], c * v[:, 1] + s * v[:, 2], c * v[:, 2] - s * v[:, 1]], axis=1) for v in (f, rates)]
        out[station] = np.hstack(turned)
    noisy = {}
    for station, values in out.items():
        noise = rng.normal(size=values.shape) * np.repeat([0.0007, 0.00005], 3) * np.sqrt(500)
        noisy[station] = (EPOCH_NS + np.round(t * 1e9).astype(np.int64), values + noise)
    return noisy


def _plain(airframe: Airframe) -> Airframe:
    root = dataclasses.replace(airframe.root, rate_hz=1000.0, lowpass_accel_hz=0.0, lowpass_gyro_hz=0.0)
    return dataclasses.replace(airframe, root=root)


def _fly(
    airframe: Airframe,
    streams: dict[Station, tuple[np.ndarray, np.ndarray]],
    axes: Axis = Axis.ALL,
    tips: tuple[Station, ...] = (Station.LEFT, Station.RIGHT),
    adapt: int = 1,
) -> tuple[WingTracker, list[ModeState]]:
    tracker, states = WingTracker(airframe, Settings(adapt=adapt)), []
    length = len(streams[Station.ROOT][0])
    sent = np.array([bool(axes & (1 << i)) for i in range(6)])
    for first in range(0, length, 40):
        now = EPOCH_NS + (first + 40) * 1_000_000
        for station in (Station.ROOT, *tips):
            t, values = streams[station]
            chunk = slice(first, first + 40)
            mask, have = (sent, axes) if station is not Station.ROOT else (np.ones(6, bool), Axis.ALL)
            tracker.add(ImuBatch(station, ClockName.HOST, t[chunk], values[chunk] * mask, have, now))
        state = tracker.advance(now)
        if state is not None:
            states.append(state)
    return tracker, states


@pytest.fixture(scope="module")
def flown() -> tuple[Airframe, Motion, WingTracker, list[ModeState]]:
    airframe, motion = _plain(_airframe()), Motion()
    return airframe, motion, *_fly(airframe, _streams(airframe, motion, 12.0))


def _truth(airframe: Airframe, motion: Motion, t_ns: int) -> tuple[np.ndarray, np.ndarray]:
    t = np.array([(t_ns - EPOCH_NS) * 1e-9])
    q, v = motion.q(t)[:, 0], motion.q(t, 1)[:, 0]
    return q + np.array([_static(airframe, motion, t)[0], 0.0]), v


def test_smoothed_deflection_rate_and_slopes_have_the_right_size_and_sign(
    flown: tuple[Airframe, Motion, WingTracker, list[ModeState]],
) -> None:
    airframe, motion, tracker, states = flown
    for lag_ms in (37, 211.3, 500, 873.7):
        t_ns = states[-1].t_host_ns - round(lag_ms * 1e6)
        deflection = tracker.smooth(t_ns)
        assert isinstance(deflection, Deflection)
        q, v = _truth(airframe, motion, t_ns)
        np.testing.assert_allclose(deflection.q_m, q, atol=2e-4)
        np.testing.assert_allclose(deflection.qdot_mps, v, atol=6e-3)
        np.testing.assert_allclose(deflection.slope_rad, S * np.array([q[0] - q[1], q[0] + q[1]]), atol=1e-3)
        wrong = deflection.q_m - q
        assert wrong @ np.linalg.solve(deflection.covariance[:2, :2], wrong) < 14.0  # chance: 1 in 1000


def test_phase_is_zero_at_the_top_and_amplitude_is_that_of_the_sine(
    flown: tuple[Airframe, Motion, WingTracker, list[ModeState]],
) -> None:
    _, motion, _, states = flown
    for state in states[-40:]:
        t = (state.t_host_ns - EPOCH_NS) * 1e-9
        for mode, (amplitude, frequency, phase) in (
            (state.symmetric, motion.symmetric),
            (state.antisymmetric, motion.antisymmetric),
        ):
            error = np.angle(np.exp(1j * (mode.phase_rad - (2 * np.pi * frequency * t + phase))))
            assert abs(error) < 0.08
            assert mode.amplitude_m == pytest.approx(amplitude, rel=0.08)
            assert mode.instantaneous_hz == pytest.approx(frequency, rel=0.12)
            assert mode.frequency_hz == pytest.approx(frequency, rel=0.02)
        assert state.validity is Validity.TRACKING


def test_forecast_meets_the_coming_peaks(flown: tuple[Airframe, Motion, WingTracker, list[ModeState]]) -> None:
    airframe, motion, tracker, states = flown
    forecast = tracker.forecast(300_000_000, 1_000_000)
    assert isinstance(forecast, Forecast)
    assert forecast.t_host_ns[0] == states[-1].t_host_ns + 1_000_000
    truth = [_truth(airframe, motion, int(t)) for t in forecast.t_host_ns]
    q, v = np.array([x[0] for x in truth]), np.array([x[1] for x in truth])
    np.testing.assert_allclose(forecast.q_m[:20], q[:20], atol=1.0e-3)
    rates = S * np.stack([v[:, 0] - v[:, 1], v[:, 0] + v[:, 1]], axis=1)
    np.testing.assert_allclose(forecast.slope_rate_radps[:20], rates[:20], atol=0.05)
    variance = forecast.q_covariance[:, 1, 1]
    assert variance[200:].mean() > 2 * variance[:100].mean()  # what lies further ahead is known less


@pytest.mark.slow
def test_rolls_and_pull_ups_are_not_taken_for_bending() -> None:
    airframe = _plain(_airframe())
    motion = Motion((0.0, 5.0, 0.0), (0.0, 6.4, 0.0), roll=(1.0, 0.4), pull=(4.0, 0.3))
    tracker, states = _fly(airframe, _streams(airframe, motion, 10.0))
    errors = []
    for lag_ms in range(100, 900, 100):
        t_ns = states[-1].t_host_ns - lag_ms * 1_000_000
        deflection = tracker.smooth(t_ns)
        assert isinstance(deflection, Deflection)
        errors.append(
            (deflection.q_m - _truth(airframe, motion, t_ns)[0]) / np.sqrt(np.diag(deflection.covariance)[:2])
        )
        assert abs(deflection.q_m[1]) < 3e-4
    assert np.sqrt(np.mean(np.square(errors))) < 2.5


@pytest.mark.slow
def test_the_sigma_tells_which_witnesses_there_were() -> None:
    airframe, motion = _plain(_airframe()), Motion()
    streams = _streams(airframe, motion, 6.0)
    sigmas = {}
    for name, axes, tips in (
        ("both", Axis.ALL, (Station.LEFT, Station.RIGHT)),
        ("one", Axis.ALL, (Station.LEFT,)),
        ("vertical", Axis.Z, (Station.LEFT, Station.RIGHT)),
    ):
        tracker, states = _fly(airframe, streams, axes, tips, adapt=0)  # the same gust is believed each time
        deflection = tracker.smooth(states[-1].t_host_ns - 500_000_000)
        assert isinstance(deflection, Deflection)
        sigmas[name] = np.sqrt(np.diag(deflection.covariance)[:2])
        q, _ = _truth(airframe, motion, deflection.t_host_ns)
        assert (np.abs(deflection.q_m - q) < 4 * sigmas[name]).all()
    assert (sigmas["one"] > sigmas["both"]).all()
    assert (sigmas["vertical"] > sigmas["both"]).all()
    assert sigmas["vertical"][1] > 1.5 * sigmas["both"][1]  # the symmetric one is mostly the trim's


@pytest.mark.slow
def test_a_low_passed_root_is_seen_as_if_it_were_not() -> None:
    airframe = _airframe()  # root at 333 Hz behind 20 Hz
    motion = Motion(pull=(2.0, 1.5))
    streams = _streams(_plain(airframe), motion, 8.0)
    t, values = streams[Station.ROOT]
    lag = 1 / (2 * np.pi * 20.0)
    state, out = np.stack([values[0], np.zeros(6)]), np.empty_like(values)
    for k, u in enumerate(values):  # y'' lag^2 + sqrt(2) lag y' + y = u, by small steps
        for _ in range(10):
            state[1] += 1e-4 * (u - state[0] - np.sqrt(2) * lag * state[1]) / lag**2
            state[0] += 1e-4 * state[1]
        out[k] = state[0]
    streams[Station.ROOT] = (t + 500_000, out)  # the output belongs to the end of the sample
    tracker, states = _fly(airframe, streams)
    errors = []
    for lag_ms in range(100, 900, 50):
        t_ns = states[-1].t_host_ns - lag_ms * 1_000_000
        deflection = tracker.smooth(t_ns)
        assert isinstance(deflection, Deflection)
        errors.append(deflection.q_m[0] - _truth(airframe, motion, t_ns)[0][0])
    assert np.std(errors) < 0.04 * 0.006 / np.sqrt(2)

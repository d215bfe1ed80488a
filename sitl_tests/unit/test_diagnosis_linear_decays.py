"""Free decays of a linear structure are adequate, bent ones are named with their value; what the band's edge does."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from companion.diagnosis.free_decay.json_report import as_json
from companion.diagnosis.free_decay.likelihood import FreeDecayLikelihood
from companion.diagnosis.free_decay.model import FreeDecayModel
from companion.diagnosis.free_decay.record import FreeDecay, RawFreeDecay, beyond_noise, prepare
from companion.diagnosis.free_decay.recordings import diagnose
from companion.params.airframe import Uncertain
from companion.records import Floats

INNER_HZ = 4000
OMEGA = 2.0 * math.pi * 9.0
BAND_HZ = (4.0, 14.0)
BELIEF = (Uncertain(8.0, 2.0), Uncertain(0.02, 0.02))
GRAVITY_MPS2 = 9.80665


def swing(force: Floats, f_hz: float, zeta: float, q: float = 0.0, v: float = 0.0) -> Floats:
    """Acceleration of a linear mode of mass 1, exact for a force that is constant within a step of 1/4000 s."""
    omega = 2.0 * math.pi * f_hz
    flow = np.array([[0.0, 1.0, 0.0], [-(omega**2), -2.0 * zeta * omega, 1.0], [0.0, 0.0, 0.0]])
    (a, b, c), (d, e, f), _ = expm(flow / INNER_HZ).tolist()
    acceleration = []
    for load in force.tolist():
        acceleration.append(load - omega**2 * q - 2.0 * zeta * omega * v)
        q, v = a * q + b * v + c * load, d * q + e * v + f * load
    return np.array(acceleration)


def bent_swing(force: Floats, restoring: Callable[[float, float, float], float], q: float = 0.0) -> Floats:
    """Acceleration of a mass 1 on any spring and damper, ``restoring`` by q, v and time; fourth-order Runge-Kutta."""
    v, step, acceleration = 0.0, 1.0 / INNER_HZ, []
    for k, load in enumerate(force.tolist()):
        now = k * step
        a1 = load + restoring(q, v, now)
        v2 = v + 0.5 * step * a1
        a2 = load + restoring(q + 0.5 * step * v, v2, now + 0.5 * step)
        v3 = v + 0.5 * step * a2
        a3 = load + restoring(q + 0.5 * step * v2, v3, now + 0.5 * step)
        v4 = v + step * a3
        a4 = load + restoring(q + step * v3, v4, now + step)
        acceleration.append(a1)
        q += step / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
        v += step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return np.array(acceleration)


def blows(seconds: float, peaks: Mapping[float, float]) -> Floats:
    """Half sines of 4 ms, m/s^2 by time."""
    force = np.zeros(int(seconds * INNER_HZ))
    for at_s, peak in peaks.items():
        force[int(at_s * INNER_HZ) :][:16] += peak * np.sin(np.pi * np.arange(16) / 16.0)
    return force


def let_go(seconds: float, force_mps2: float, at_s: float) -> Floats:
    """Force of a thread that is pulled within a second, slowly beside a period, and cut."""
    t_s = np.arange(int(seconds * INNER_HZ)) / INNER_HZ
    return np.asarray(force_mps2 * (0.5 - 0.5 * np.cos(np.pi * np.clip(t_s, 0.0, 1.0))) * (t_s < at_s))


def sensed(seed: int, acceleration: Floats, rate_hz: int, noise: float, name: str = "decay") -> RawFreeDecay:
    """Means over the sensor's samples, in white noise and gravity, of a sensor whose zero wanders a little."""
    rng = np.random.default_rng(seed)
    every = INNER_HZ // rate_hz
    up = acceleration[: len(acceleration) // every * every].reshape(-1, every).mean(axis=1)
    wander = np.cumsum(rng.normal(0.0, 0.01 * noise, len(up)))
    return RawFreeDecay(
        name, np.arange(len(up)) / rate_hz, up + rng.normal(0.0, noise, len(up)) + wander - GRAVITY_MPS2, {}
    )


def diagnosed(raws: Sequence[RawFreeDecay]) -> tuple[dict[str, Any], dict[str, tuple[float, float]]]:
    """The verdict, and frequency and damping with their sigmas, in logarithms."""
    recordings, scales = prepare(raws, BAND_HZ)
    diagnosis = diagnose(recordings, *BELIEF, BAND_HZ)
    keys = ("log frequency", "log damping")
    return as_json(diagnosis, scales, None), {key: diagnosis.final.value(key) for key in keys}


LINEAR: dict[str, Callable[[], tuple[list[RawFreeDecay], float, float]]] = {
    "struck": lambda: ([sensed(1, swing(blows(6.0, {0.7: 60.0, 3.1: 90.0}), 9.0, 0.012), 1000, 0.01)], 9.0, 0.012),
    "let go": lambda: ([sensed(2, swing(let_go(6.0, 20.0, 1.5), 8.2, 0.015), 1000, 0.01)], 8.2, 0.015),
    "begun within": lambda: ([sensed(3, swing(np.zeros(20000), 9.0, 0.01, q=0.002), 500, 0.01)], 9.0, 0.01),
    "begun within, loud": lambda: ([sensed(4, swing(np.zeros(24000), 9.0, 0.01, v=0.1), 1000, 0.5)], 9.0, 0.01),
    "struck, loud, slow": lambda: (
        [sensed(5, swing(blows(8.0, {0.7: 60.0, 3.1: 90.0, 5.4: 70.0}), 9.0, 0.02), 200, 0.3)],
        9.0,
        0.02,
    ),
    "with a higher mode": lambda: (
        [
            sensed(
                6,
                swing(blows(6.0, {0.7: 60.0, 3.1: 90.0}), 7.0, 0.02)
                + swing(blows(6.0, {0.7: 60.0, 3.1: 90.0}), 46.0, 0.01),
                1000,
                0.02,
            )
        ],
        7.0,
        0.02,
    ),
    "of three lengths": lambda: (
        [sensed(7, swing(blows(s, {0.5: 70.0}), 9.0, 0.02), 1000, 0.02, f"{s:g}") for s in (2.9, 4.3, 5.2)],
        9.0,
        0.02,
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LINEAR)
def test_a_linear_decay_is_adequate_with_its_frequency_and_damping(name: str) -> None:
    raws, f_hz, zeta = LINEAR[name]()
    plain, values = diagnosed(raws)
    assert (plain["verdict"], plain["causes"]) == ("adequate", []), plain["reason"]
    for key, true in (("log frequency", f_hz), ("log damping", zeta)):
        value, sigma = values[key]
        assert abs(value - math.log(true)) < 3.0 * sigma, key


HARDENING, SPEED_SQUARED, FRICTION_MPS2, DRIFT_PER_MIN = 5000.0, 30.0, 0.05, 0.2


def _hardening(q: float, v: float, _t: float) -> float:
    return -(OMEGA**2) * q * (1.0 + HARDENING * q * q) - 2.0 * 0.012 * OMEGA * v


def _speed_squared(q: float, v: float, _t: float) -> float:
    return -(OMEGA**2) * q - (2.0 * 0.004 * OMEGA + SPEED_SQUARED * abs(v)) * v


def _friction(q: float, v: float, _t: float) -> float:
    return -(OMEGA**2) * q - 2.0 * 0.006 * OMEGA * v - FRICTION_MPS2 * math.tanh(2000.0 * v)


def _drift(q: float, v: float, t: float) -> float:
    return -((OMEGA * (1.0 + DRIFT_PER_MIN * (t - 4.0) / 60.0)) ** 2) * q - 2.0 * 0.012 * OMEGA * v


# first terms of the harmonic balance: 3/8 a^2 of a cubic spring, 4/(3 pi) a of the squared speed, 2/(pi omega^2 a)
NAMED: dict[str, tuple[Callable[[float, float, float], float], str, Callable[[float], float]]] = {
    "cubic-stiffness": (_hardening, "ratio_at_rms", lambda q: 0.375 * HARDENING * q**2),
    "quadratic-damping": (_speed_squared, "damping_at_rms", lambda q: 4.0 / (3.0 * math.pi) * SPEED_SQUARED * q),
    "coulomb-friction": (_friction, "damping_at_rms", lambda q: 2.0 * FRICTION_MPS2 / (math.pi * OMEGA**2 * q)),
    "frequency-drift": (_drift, "ratio_per_min", lambda _q: DRIFT_PER_MIN),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMED)
def test_a_bent_decay_is_named_with_its_value(name: str) -> None:
    restoring, parameter, true = NAMED[name]
    plain, _ = diagnosed([sensed(8, bent_swing(blows(8.0, {0.6: 70.0, 3.0: 40.0, 5.5: 80.0}), restoring), 1000, 0.2)])
    assert [cause["name"] for cause in plain["causes"]] == [name]
    parameters = plain["causes"][0]["parameters"]
    rms_m = parameters["deflection_rms"]["value"] if "deflection_rms" in parameters else 0.0
    low, high = parameters[parameter]["interval"]
    assert low < true(rms_m) < high


@pytest.mark.slow
def test_a_decay_that_was_bent_from_its_first_sample_is_named() -> None:
    plain, _ = diagnosed([sensed(9, bent_swing(np.zeros(24000), _hardening, q=0.002), 1000, 0.02)])
    assert [cause["name"] for cause in plain["causes"]] == ["cubic-stiffness"]


def decay(raw: RawFreeDecay) -> FreeDecay:
    (prepared,), _ = prepare([raw], BAND_HZ)
    return prepared


def test_white_noise_of_the_sensor_stays_white() -> None:
    rng = np.random.default_rng(10)
    thin = decay(RawFreeDecay("noise", np.arange(60000) / 1000.0, rng.standard_normal(60000), {}))
    y, n = thin.up_mps2, len(thin.up_mps2)
    assert np.var(y) == pytest.approx(thin.rate_hz / 1000.0, rel=5.0 * math.sqrt(2.0 / n))
    for lag in range(1, 21):
        assert abs(np.mean(y[lag:] * y[:-lag]) / np.var(y)) < 4.5 / math.sqrt(n)


def test_noise_of_the_sensor_is_no_impulse_and_a_blow_has_its_power() -> None:
    rng = np.random.default_rng(11)
    power = 0.3 * rng.chisquare(9.0, 4000)
    power[::400] += 100.0
    loud = beyond_noise(power, 9.0)
    assert np.count_nonzero(loud) - 10 <= 3
    np.testing.assert_allclose(loud[::400], 100.0, atol=0.3 * 6.0 * math.sqrt(18.0))


def test_a_blow_is_over_within_seven_samples() -> None:
    up = np.zeros(8000)
    up[3456] = 1000.0
    y = decay(RawFreeDecay("blow", np.arange(8000) / 1000.0, up, {})).up_mps2
    peak = int(np.argmax(np.abs(y)))
    far = np.delete(y, range(peak - 7, peak + 8))
    assert np.ptp(far) < 5e-3 * np.max(np.abs(y))  # the mean that was taken away stays


def test_leakage_is_the_mean_square_of_what_a_blow_leaves_beside_its_step() -> None:
    beside, leaked = [], []
    for place in range(3400, 3424):  # all places within a step, in turn
        up = np.zeros(8000)
        up[place] = 1000.0
        thin = decay(RawFreeDecay("blow", np.arange(8000) / 1000.0, up, {}))
        step = int(np.argmax(thin.impulse_mps2))
        y = thin.up_mps2 - np.median(thin.up_mps2)
        beside.append([y[step + lag] ** 2 / y[step] ** 2 for lag in (-3, -2, 2, 3)])
        leaked.append([thin.leakage_mps2[step + lag] ** 2 for lag in (-3, -2, 2, 3)])
    ratio = np.mean(beside, axis=0) / np.mean(leaked, axis=0)
    assert ratio.max() / ratio.min() < 4.0


def test_a_decay_that_is_cut_at_both_ends_stays_what_it_is() -> None:
    t_s = np.arange(3000) / 1000.0

    def exact(at_s: Floats) -> Floats:
        return np.asarray(np.exp(-0.01 * OMEGA * at_s) * np.cos(OMEGA * at_s))

    thin = decay(RawFreeDecay("cut", t_s, exact(t_s) - GRAVITY_MPS2, {}))
    error = thin.up_mps2 - exact(thin.t_s)
    assert np.max(np.abs(error - np.mean(error))) < 1e-3


def test_what_a_hand_does_before_the_first_blow_is_left_out() -> None:
    rng = np.random.default_rng(12)
    up = swing(blows(6.0, {2.5: 80.0}), 9.0, 0.02)
    up[:8000] += np.sin(OMEGA * np.arange(8000) / INNER_HZ)
    thin = decay(RawFreeDecay("held", np.arange(len(up)) / INNER_HZ, up + rng.normal(0.0, 0.02, len(up)), {}))
    assert 2.2 < thin.t_s[0] < 2.5


def test_no_mode_is_taken_for_its_mirror_image_beyond_half_the_rate() -> None:
    thin = decay(sensed(13, swing(np.zeros(12000), 9.0, 0.01, q=0.002), 1000, 0.05))
    model = FreeDecayModel([thin], *BELIEF)
    likelihood = FreeDecayLikelihood(model, [np.ones(len(thin.t_s), dtype=np.bool_)])
    true, mirrored = model.centres, model.centres
    true[:2] = math.log(9.0), math.log(0.01)
    mirrored[:2] = math.log(thin.rate_hz - 9.0), math.log(0.01 * 9.0 / (thin.rate_hz - 9.0))
    assert likelihood.log_likelihood(true) > likelihood.log_likelihood(mirrored) + 100.0

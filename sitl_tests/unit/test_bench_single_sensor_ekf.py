"""The single-sensor filter on an oscillator whose frequency moves: integrated here, a stronger resonance on top."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from companion.records import Floats, Reject
from tools.bench.single_sensor_ekf import PhaseEstimate, Resonance, SingleSensorModeEkf

RATE_HZ = 1000.0
FINE = 20  # of the integration, per sample
NOISE_MPS2 = 0.01
BELIEF = (Resonance(31.0, 0.25, 1.0, 0.005, 0.5), Resonance(195.0, 0.13, 0.3, 0.01, 30.0))


def _frequency_hz(t: Floats) -> Floats:
    """26 Hz, within 0.2 s up to 36 Hz, and back later."""
    return 26.0 + 5.0 * (np.tanh((t - 1.5) / 0.05) - np.tanh((t - 3.0) / 0.05))


@functools.cache
def _truth(moving: bool = True) -> tuple[Floats, Floats, Floats]:
    """Acceleration, displacement, velocity: symplectic Euler, read mid-step; a kick of 5 ms every 0.7 s."""
    step = 1.0 / (RATE_HZ * FINE)
    t: Floats = np.asarray(np.arange(round(4.5 * RATE_HZ) * FINE) * step, dtype=np.float64)
    first: Floats = 2 * np.pi * (_frequency_hz(t) if moving else np.full(len(t), 29.0))
    second, kicked = 2 * np.pi * 180.0, 3.0 * ((t + 0.5) % 0.7 < 0.005)
    q, v, p, u = 0.0, 0.0, 0.0, 0.0
    states = []
    for omega, kick in zip(first.tolist(), kicked.tolist(), strict=True):
        a = -(omega**2) * q - 2 * 0.008 * omega * v
        b = -(second**2) * p - 2 * 0.012 * second * u + 0.5 * kick
        v += (a + kick) * step
        q += v * step
        u += b * step
        p += u * step
        states.append((a + b, q - 0.5 * v * step, v - 0.5 * a * step))
    some = np.array(states[FINE - 1 :: FINE])
    return some[:, 0], some[:, 1], some[:, 2]


@functools.cache
def _answers() -> dict[int, list[PhaseEstimate | Reject]]:
    """Estimates at each sample of the phase now and ten samples later, by lead."""
    return _follow(_truth()[0], (0, 10))


def _follow(acceleration: Floats, leads: tuple[int, ...] = (0,)) -> dict[int, list[PhaseEstimate | Reject]]:
    tracker = SingleSensorModeEkf(BELIEF, RATE_HZ, NOISE_MPS2)
    answers: dict[int, list[PhaseEstimate | Reject]] = {lead: [] for lead in leads}
    for value in acceleration + NOISE_MPS2 * np.random.default_rng(1).standard_normal(len(acceleration)):
        tracker.add(float(value))
        for lead in leads:
            answers[lead].append(tracker.phase(lead / RATE_HZ))
    return answers


def _error_rad(answers: list[PhaseEstimate | Reject], q: Floats, v: Floats, lead: int, moving: bool) -> Floats:
    """Against the phase that displacement and velocity themselves have; NaN where refused."""
    t: Floats = np.asarray(np.arange(1, len(q) + 1) / RATE_HZ, dtype=np.float64)
    omega = 2 * np.pi * (_frequency_hz(t) if moving else np.full(len(t), 29.0))
    true = np.arctan2(-v / omega, q)[lead:]
    said = np.array([a.phase_rad if isinstance(a, PhaseEstimate) else np.nan for a in answers])[: len(true)]
    return np.angle(np.exp(1j * (said - true)))


@pytest.mark.slow
@pytest.mark.parametrize(("lead", "most_deg"), [(0, 2.0), (10, 3.5)])
def test_phase_is_followed_through_a_moving_support(lead: int, most_deg: float) -> None:
    _, q, v = _truth()
    error = np.degrees(np.abs(_error_rad(_answers()[lead], q, v, lead, moving=True)))[500:]
    assert np.mean(np.isnan(error)) < 0.1
    assert np.nanmedian(error) < most_deg


@pytest.mark.slow
def test_frequency_is_where_the_support_has_put_it() -> None:
    answers = _answers()[0]
    for at_s in (1.2, 2.6, 4.2):
        answer = answers[round(at_s * RATE_HZ)]
        assert isinstance(answer, PhaseEstimate)
        assert answer.frequency_hz == pytest.approx(float(_frequency_hz(np.array(at_s))), rel=0.02)
        assert abs(answer.frequency_hz - float(_frequency_hz(np.array(at_s)))) < 3 * answer.frequency_sigma_hz


@pytest.mark.slow
def test_errors_stay_within_the_sigma_that_is_given() -> None:
    """At least 68 and 95 of a hundred once the first 50 ms after a blow are over: nothing foretells a blow."""
    _, q, v = _truth()
    answers = _answers()[0]
    error = np.abs(_error_rad(answers, q, v, 0, moving=True))[500:]
    sigma = np.array([a.phase_sigma_rad if isinstance(a, PhaseEstimate) else np.nan for a in answers])[500:]
    t = np.arange(501, len(q) + 1) / RATE_HZ
    both = np.isfinite(error) & ((t + 0.5) % 0.7 > 0.05)
    assert np.mean(error[both] < sigma[both]) > 0.68
    assert np.mean(error[both] < 2 * sigma[both]) > 0.95


def test_a_later_lead_and_a_later_sensor_are_less_certain() -> None:
    acceleration, _, _ = _truth()
    tracker = SingleSensorModeEkf(BELIEF, RATE_HZ, NOISE_MPS2)
    for value in acceleration[:1000]:
        tracker.add(float(value))
    now, soon, later = (tracker.phase(lead_s) for lead_s in (0.0, 0.005, 0.02))
    assert isinstance(now, PhaseEstimate)
    assert isinstance(soon, PhaseEstimate)
    assert isinstance(later, PhaseEstimate)
    assert now.phase_sigma_rad < soon.phase_sigma_rad < later.phase_sigma_rad
    turned = 2 * np.pi * now.frequency_hz * 0.005
    assert np.angle(np.exp(1j * (soon.phase_rad - now.phase_rad - turned))) == pytest.approx(0.0, abs=0.02)


@pytest.mark.slow
def test_a_sensor_that_reads_late_is_made_good_for() -> None:
    """Samples of 3 ms ago, said to be so, give the phase of now."""
    acceleration, q, v = _truth(moving=False)
    tracker, errors = SingleSensorModeEkf(BELIEF, RATE_HZ, NOISE_MPS2, sensor_lag_s=0.003), []
    for k in range(3, 2500):
        tracker.add(float(acceleration[k - 3]))
        answer = tracker.phase()
        if isinstance(answer, PhaseEstimate) and k > 800:
            true = np.arctan2(-v[k] / (2 * np.pi * 29.0), q[k])
            errors.append(abs(np.angle(np.exp(1j * (answer.phase_rad - true)))))
    assert np.degrees(np.median(errors)) < 1.0


def test_at_rest_there_is_no_phase() -> None:
    assert all(answer is Reject.NO_MODE for answer in _follow(np.zeros(300))[0])


def test_a_reading_that_is_no_number_only_lets_time_pass() -> None:
    acceleration, q, v = _truth(moving=False)
    holed = acceleration[:1100].copy()
    holed[1000:1010] = np.nan
    answers = _follow(holed)[0]
    error = np.degrees(np.abs(_error_rad(answers, q[:1100], v[:1100], 0, moving=False)))
    assert all(np.isfinite(a.phase_rad) for a in answers if isinstance(a, PhaseEstimate))
    assert np.nanmedian(error[1000:]) < 4.0

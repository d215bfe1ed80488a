"""Gusts and the wing's integrator against closed forms."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from companion.core.wing.effects import make_effect
from companion.core.wing.model import WingModel
from companion.params.airframe import NamedEffect, Uncertain, Wing
from companion.params.files import load_airframe
from companion.records import Floats
from companion.sim.flight.gust import (
    DrydenScales,
    LoadSpectrum,
    dryden_longitudinal,
    dryden_roll,
    dryden_vertical,
    modal_rms,
    pole_spectrum,
    white_spectrum,
)
from companion.sim.flight.wing import WingStepper, integrate

OMEGA, ZETA = 2 * math.pi * 5.0, 0.03


@pytest.fixture(scope="module")
def wing() -> Wing:
    return dataclasses.replace(load_airframe("nadir-2m").wing, second_symmetric=None)


def stiffening(wing: Wing, kappa: float) -> WingModel:
    return WingModel(wing, (make_effect(NamedEffect("cubic-stiffness", {"kappa_per_m2": kappa})),))


def free_decay(model: WingModel, start_m: float, steps: int) -> np.ndarray:
    stepper = WingStepper(model)
    rest = model.q_static(1.0)
    stepper.q_m = rest + np.array([start_m, 0.0])
    path = []
    for _ in range(steps):
        path.append(stepper.q_m[0] - rest[0])
        stepper.step(np.zeros(2), 1.0)
    return np.array(path)


def peaks(path: np.ndarray, step_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and heights of the maxima, by a parabola through three samples."""
    middle = np.flatnonzero((path[1:-1] > path[:-2]) & (path[1:-1] >= path[2:])) + 1
    a, b, c = path[middle - 1], path[middle], path[middle + 1]
    shift = (a - c) / (2 * (a - 2 * b + c))
    return (middle + shift) * step_s, b - (a - c) * shift / 4


@pytest.mark.slow
@pytest.mark.parametrize("kappa", [None, 0.0])
def test_free_decay_rings_at_the_damped_frequency_with_the_log_decrement(wing: Wing, kappa: float | None) -> None:
    model = WingModel(wing) if kappa is None else stiffening(wing, kappa)
    times, heights = peaks(free_decay(model, 0.004, 4000), 0.0005)
    damped = OMEGA * math.sqrt(1 - ZETA**2)
    np.testing.assert_allclose(np.diff(times), 2 * math.pi / damped, rtol=2e-5)
    decrement = 2 * math.pi * ZETA / math.sqrt(1 - ZETA**2)
    np.testing.assert_allclose(-np.diff(np.log(heights)), decrement, rtol=2e-4)


def test_a_stiffening_spring_rings_higher_by_three_eighths(wing: Wing) -> None:
    kappa, swing = 2000.0, 0.004
    light = dataclasses.replace(wing, symmetric=dataclasses.replace(wing.symmetric, damping=Uncertain(0.0005)))
    times, _ = peaks(free_decay(stiffening(light, kappa), swing, 1200), 0.0005)
    ratio = 2 * math.pi / np.diff(times[:2])[0] / OMEGA
    assert ratio - 1 == pytest.approx(3 / 8 * kappa * swing**2, rel=0.05)


def test_whole_flight_and_steps_agree(wing: Wing) -> None:
    rng = np.random.default_rng(1)
    load, factor = rng.standard_normal((400, 2)), 1 + 0.2 * np.sin(np.arange(400) / 60)
    for model in (WingModel(wing), stiffening(wing, 0.0)):
        q, qdot = integrate(model, load, factor)
        stepper = WingStepper(model, float(factor[0]))
        for row, n in zip(load, factor.tolist(), strict=True):
            stepper.step(row, n)
        np.testing.assert_allclose(q[-1], stepper.q_m, atol=1e-10)
        np.testing.assert_allclose(qdot[-1], stepper.qdot_mps, atol=1e-9)


def test_a_step_of_load_settles_at_load_over_stiffness(wing: Wing) -> None:
    model = WingModel(wing)
    q, qdot = integrate(model, np.tile([2.0, -1.0], (40_000, 1)), np.full(40_000, 1.3))
    antisymmetric = 2 * math.pi * 6.4
    expected = [0.0149 * 1.3 + 2.0 / OMEGA**2, -1.0 / antisymmetric**2]
    np.testing.assert_allclose(q[-1], expected, rtol=1e-6)
    np.testing.assert_allclose(qdot[-1], 0.0, atol=1e-7)


def density(spectrum: LoadSpectrum, frequency_hz: Floats) -> Floats:
    """Two-sided power spectral density per Hz at each frequency, (k,)."""
    if not len(spectrum.drift):
        return np.ones_like(frequency_hz)
    s = 2j * np.pi * frequency_hz[:, None, None]
    response = np.linalg.solve(s * np.eye(len(spectrum.drift)) - spectrum.drift, spectrum.gain_in[:, None])
    return np.asarray(np.abs(response[:, :, 0] @ spectrum.gain_out) ** 2)


def test_white_load_gives_the_textbook_rms() -> None:
    # two-sided density 1/Hz: sigma^2 = 1 / (4 zeta omega^3)
    assert modal_rms(white_spectrum(), 5.0, ZETA) == pytest.approx(1 / math.sqrt(4 * ZETA * OMEGA**3), rel=1e-9)


@pytest.mark.parametrize("spectrum", [white_spectrum(), pole_spectrum((2.0, 8.0)), pole_spectrum((5.0, 0.0))])
def test_modal_rms_is_the_integral_over_the_resonance(spectrum: LoadSpectrum) -> None:
    frequency = np.arange(0.0005, 400.0, 0.001)
    omega = 2 * np.pi * frequency
    resonance = 1 / ((OMEGA**2 - omega**2) ** 2 + (2 * ZETA * OMEGA * omega) ** 2)
    variance = 2 * np.sum(density(spectrum, frequency) * resonance) * 0.001
    assert modal_rms(spectrum, 5.0, ZETA) == pytest.approx(math.sqrt(variance), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("corners", [(0.0, 0.0), (2.0, 8.0), (5.0, 20.0)])
def test_a_drawn_gust_moves_the_mode_by_its_rms(wing: Wing, corners: tuple[float, float]) -> None:
    spectrum = pole_spectrum(corners)
    load = np.zeros((600_000, 2))
    load[:, 0] = spectrum.draw(np.random.default_rng(11), len(load), 0.0005)
    q, _ = integrate(WingModel(wing), load, np.ones(len(load)))
    measured = np.std(q[20_000:, 0])
    # the variance is remembered for 1/(2 zeta omega) = 0.53 s: 290 s give the rms to 3 %
    assert measured == pytest.approx(modal_rms(spectrum, 5.0, ZETA), rel=0.08)


@pytest.mark.slow
@pytest.mark.parametrize("corners", [(2.0, 8.0), (5.0, 5.0)])
def test_the_samples_of_two_poles_have_their_variance(corners: tuple[float, float]) -> None:
    a, b = (2 * math.pi * corner for corner in corners)
    path = pole_spectrum(corners).draw(np.random.default_rng(2), 400_000, 0.002)
    # integral of a^2 b^2 / ((w^2 + a^2)(w^2 + b^2)) dw/2pi = a b / (2 (a + b)); 800 s give it to 1.5 %
    assert np.var(path) == pytest.approx(a * b / (2 * (a + b)), rel=0.05)


def test_dryden_scales_at_low_altitude() -> None:
    # MIL-F-8785C at 100 ft with 15 knots at 20 ft: sigma_w = 1.5 kt, L_w = 100 ft, L_u = 100/0.2593^1.2 ft
    knot, foot = 0.514444, 0.3048
    scales = DrydenScales.low_altitude(100 * foot, 15 * knot)
    assert scales.sigma_w_mps == pytest.approx(1.5 * knot)
    assert scales.length_w_m == pytest.approx(100 * foot)
    assert scales.length_u_m == pytest.approx(100 * foot / 0.2593**1.2)
    assert scales.sigma_u_mps == pytest.approx(1.5 * knot / 0.2593**0.4)


def test_dryden_spectra_have_the_standards_variance_and_shape() -> None:
    scales, speed, span = DrydenScales.low_altitude(60.0, 10.0), 20.0, 2.0
    frequency = np.geomspace(1e-5, 3e3, 400_001)
    for spectrum, sigma in (
        (dryden_vertical(scales, speed), scales.sigma_w_mps),
        (dryden_longitudinal(scales, speed), scales.sigma_u_mps),
    ):
        variance = 2 * np.trapezoid(density(spectrum, frequency), frequency)
        assert variance == pytest.approx(sigma**2, rel=2e-3)
    lag = scales.length_w_m / speed
    shape = density(dryden_vertical(scales, speed), np.array([0.2, 2.0]))
    omega = 2 * np.pi * np.array([0.2, 2.0])
    expected = (1 + 3 * (lag * omega) ** 2) / (1 + (lag * omega) ** 2) ** 2
    assert shape[1] / shape[0] == pytest.approx(expected[1] / expected[0], rel=1e-6)
    # Phi_p(Omega) = sigma_w^2/L_w 0.8 (pi L_w/4b)^(1/3) / (1 + (4b Omega/pi)^2) per rad/m, one-sided
    wave = np.array([1e-4])
    standard = scales.sigma_w_mps**2 / scales.length_w_m * 0.8 * (math.pi * scales.length_w_m / (4 * span)) ** (1 / 3)
    per_hz = density(dryden_roll(scales, speed, span), wave * speed / (2 * math.pi))
    # one-sided per rad/m -> two-sided per Hz: 2 pi / (2 V)
    assert per_hz[0] == pytest.approx(standard * math.pi / speed, rel=1e-3)

"""Figures 4 and 9 to 12: the beam's shape, shapes from modal peaks, and the shaken boom, against closed forms."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from companion.core.wing.beam import BeamMode
from companion.paper import edge_fits, fig_4, modal_peaks, shaken_boom, vibration_test, wing_shapes
from companion.params.files import load_airframe

RATE = modal_peaks.RATE_HZ


@pytest.mark.slow
def test_fig_4_has_the_tip_slope_of_the_cantilever_with_that_tip_mass() -> None:
    # Y = (cosh - cos) - r (sinh - sin) with x = beta*l and zero moment at the tip
    mu = 0.0365 / (2700 * 0.0507 * 0.001 * 0.1115)
    low, high = 0.5, 1.5
    for _ in range(100):
        x = 0.5 * (low + high)
        value = 1 + math.cos(x) * math.cosh(x) + mu * x * (math.cos(x) * math.sinh(x) - math.sin(x) * math.cosh(x))
        low, high = (x, high) if value > 0 else (low, x)
    r = (math.cosh(x) + math.cos(x)) / (math.sinh(x) + math.sin(x))
    shape = math.cosh(x) - math.cos(x) - r * (math.sinh(x) - math.sin(x))
    slope = x * (math.sinh(x) + math.sin(x) - r * (math.cosh(x) - math.cos(x)))
    assert fig_4.section().data["slope_at_tip_times_length"] == pytest.approx(slope / shape, rel=1e-9)


def test_a_sweep_gives_the_quadrature_of_a_single_oscillator() -> None:
    """At resonance acceleration over force is i / (2 zeta), less what averaging over a Hann window takes off."""
    zeta, f0 = 0.02, 9.0
    count = round(60 * RATE)
    force = np.sin(2 * np.pi * (4.0 * np.arange(count) / RATE + 0.1 * (np.arange(count) / RATE) ** 2))
    f = np.fft.rfftfreq(count, 1 / RATE)
    ratio = f / f0
    felt = -(ratio**2) / (1 - ratio**2 + 2j * zeta * ratio)
    accel = np.fft.irfft(np.fft.rfft(force) * felt, count)
    peak_hz, peaks = modal_peaks.quadrature_peak(force, np.stack([accel, -0.3 * accel], axis=1), (8.0, 10.0))
    assert peak_hz == pytest.approx(f0, abs=0.03)
    window = np.sin(np.pi * np.arange(1, 16) / 16) ** 2  # 15 bins of 1/60 Hz
    near = 1 + np.arange(-7, 8) / 60 / f0
    windowed_peak = window @ np.imag(-(near**2) / (1 - near**2 + 2j * zeta * near)) / window.sum()
    assert 0.9 / (2 * zeta) < windowed_peak < 1 / (2 * zeta)
    assert peaks[0] == pytest.approx(windowed_peak, rel=0.01)
    assert peaks[1] / peaks[0] == pytest.approx(-0.3, rel=1e-9)


def test_the_fit_finds_the_slope_of_a_known_wing() -> None:
    airframe = load_airframe("paper-flying-wing")
    first, _ = vibration_test.true_shapes(airframe)
    assert first.slope_at_tip_radpm == pytest.approx(1.39)
    true = float(first.slope(np.array([0.99]))[0])
    points = vibration_test.simulated_points(airframe, seed=3, gain_sigma=0.0)
    assert edge_fits.clamped_factor(points) == pytest.approx(true, rel=0.015)  # a quartic is not quite the shape


@pytest.mark.skipif(not modal_peaks.gvt_folder().is_dir(), reason="measured/maewing1-gvt is not here (SPANWISE_DATA)")
def test_the_measured_wing_bends_alike_on_both_sides() -> None:
    points = modal_peaks.measured_points(modal_peaks.gvt_folder())
    deflection = points.leading.deflection
    assert np.all(np.abs(points.leading.span_m + points.leading.span_m[::-1]) < 1e-9)
    assert deflection[-1] / deflection[0] == pytest.approx(1.0, abs=0.1)
    assert deflection[0] > 10 * abs(deflection[4])
    root = points.trailing.deflection[4:6]
    assert np.all(root < 0)  # free-free: the middle moves against the tips


@pytest.mark.slow
def test_the_random_drive_shows_the_first_mode_alone() -> None:
    airframe = load_airframe("paper-beam")
    response = shaken_boom.respond(shaken_boom.shake(airframe, seed=5))
    assert response.averages == 100
    peak = response.frequency_hz[np.argmax(response.gain)]
    assert peak == pytest.approx(20.1, abs=0.3)
    # far above resonance the tip is left behind: gain 1 - participation of mode 1 / (1 - (f1/f)^2), and less of mode 2
    at = np.searchsorted(response.frequency_hz, 5.0)
    f = response.frequency_hz[at]
    participation = shaken_boom.boom_wing(0.01)[1][0].base_participation()
    closed = 1 + participation * f**2 / (20.1057**2 - f**2)
    assert response.gain[at] == pytest.approx(closed, rel=0.01)


@pytest.mark.slow
def test_the_measured_transfer_function_is_the_closed_form_one() -> None:
    """Within the scatter of 100 averages, away from the peak; the window blunts the peak itself."""
    response = shaken_boom.respond(shaken_boom.shake(load_airframe("paper-beam"), seed=6))
    f = response.frequency_hz
    first, second = shaken_boom.boom_wing(0.01)[1]
    total = np.ones(len(f), complex)
    for mode, natural_hz in ((first, 20.1057), (second, 297.1625)):
        total += base_participation(mode) * f**2 / (natural_hz**2 - f**2 + 0.02j * natural_hz * f)
    away = np.abs(f - 20.1) > 1.0
    assert np.median(np.abs(response.gain / np.abs(total) - 1)[away]) < 0.02
    assert np.max(response.gain) == pytest.approx(np.max(np.abs(total)), rel=0.15)


def test_a_white_drive_gives_the_second_mode_what_its_variance_formula_says() -> None:
    first, second = modes = shaken_boom.boom_wing(0.01)[1]
    ratio = base_participation(second) / base_participation(first)
    deflection = ratio**2 * (20.1057 / 297.1625) ** 3
    assert shaken_boom.white_share(modes, of_slope=False) == pytest.approx(deflection, rel=1e-3)
    steeper = second.slope_at_tip_radpm / first.slope_at_tip_radpm
    assert shaken_boom.white_share(modes, of_slope=True) == pytest.approx(deflection * steeper**2, rel=1e-3)


def base_participation(mode: BeamMode) -> float:
    """Integral of the shape over that of its square, the tip mass at both ends of the fraction; tip deflection is 1."""
    station = np.linspace(0.0, mode.length_m, 20001)
    shape = mode.shape(station)
    per_length, tip = 2700 * 0.0507 * 0.001, 0.0365
    moved = per_length * np.trapezoid(shape, station) + tip
    return float(moved / (per_length * np.trapezoid(shape**2, station) + tip))


@pytest.mark.slow
def test_without_the_measured_wing_the_figures_say_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("SPANWISE_DATA", str(tmp_path))
    section = wing_shapes.section()
    assert section.data["measured"] is None
    assert any("skipped" in finding for finding in section.findings)
    assert len(section.pictures) == 1

"""Expected spectra of the fit's channels where the wing is still: the sensors' noise, wherever it comes in."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import welch

from companion.core.tracking.adaptation.channels import COLUMNS, ROLL, STATIC, Channels
from companion.core.tracking.states import P_ROOT, Z_LEFT
from sitl_tests.unit.tracking_samples import plain_airframe, prior_of

GRAVITY = 9.80665
STEP_S = 0.004
BEND_PER_G_M = 0.0149
COUNT = 2**19


FAMILIES = pytest.mark.parametrize(("families", "tip"), [((0,), 0), ((1,), 0), ((0, 1), 0), ((0, 1), 1)])
LEVERS = pytest.mark.parametrize("levers_m", [(-1.0, 1.0), (-1.2, 0.8), (-0.7, 1.3)])


@FAMILIES
@LEVERS
def test_a_roll_of_the_aircraft_is_no_motion_of_the_wing(
    families: tuple[int, ...], tip: int, levers_m: tuple[float, float]
) -> None:
    """Also where the root sits beside the centre line, so that the tips' mean feels it."""
    layout, noise, believed = prior_of(plain_airframe(), STEP_S)
    omega = 2.0 * np.pi * 0.8
    t_s = STEP_S * np.arange(5000)
    rows = np.zeros((len(t_s), COLUMNS))
    rows[:, ROLL] = 0.4 * np.sin(omega * t_s)
    rows[:, :2] = np.outer(0.4 * omega * np.cos(omega * t_s), levers_m)
    samples, _ = Channels(layout, noise, levers_m, STEP_S).channel(rows, families, tip, believed, 0.0, 0.0)
    assert np.std(samples[20:-20]) < 0.003 * np.std(rows[:, :2])


@FAMILIES
@LEVERS
def test_the_floor_is_what_noise_makes_of_the_channel(
    families: tuple[int, ...], tip: int, levers_m: tuple[float, float]
) -> None:
    """Also the root's, which is in the readings and, times the bend per g, in the bend that is taken out of them."""
    layout, prior_noise, believed = prior_of(plain_airframe(), STEP_S)
    noise = dataclasses.replace(prior_noise, bias_prior_covariance=np.zeros((9, 9)))
    rng = np.random.default_rng(8)
    root_noise = np.sqrt(noise.root_z_variance) * rng.standard_normal(COUNT)
    rows = np.zeros((COUNT, COLUMNS))
    rows[:, :2] = np.sqrt(noise.sensor_variance[Z_LEFT]) * rng.standard_normal((COUNT, 2)) - root_noise[:, None]
    rows[:, ROLL] = np.sqrt(noise.sensor_variance[P_ROOT]) * rng.standard_normal(COUNT)
    rows[:, STATIC] = BEND_PER_G_M * -root_noise / GRAVITY
    samples, noise_spectrum = Channels(layout, noise, levers_m, STEP_S).channel(
        rows, families, tip, believed, 0.0, BEND_PER_G_M
    )
    f_hz, density = welch(samples, 1.0 / STEP_S, nperseg=8192)
    mode_hz = believed[0].frequency_hz
    bands = [(0.2, 0.5), (0.5, 0.8), (1.5, 2.5), (2.5, 6.0), (6.0, 12.0), (12.0, 23.0)]  # about the mode's own peak
    for low, high in bands:
        inside = (f_hz > low * mode_hz) & (f_hz < high * mode_hz)
        assert density[inside].mean() == pytest.approx(noise_spectrum(f_hz[inside]).mean(), rel=0.06), (low, high)

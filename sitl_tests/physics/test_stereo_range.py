"""Closed forms of the corrected range: what bending does to it and what makes its sigma, by hand-written formulas."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.stereo.geometry import Rig
from companion.core.stereo.ranging import PairConditions, correct
from companion.params.settings import Settings
from companion.records import RelativeRotation
from sitl_tests.unit.stereo_cases import (
    bend,
    forward,
    ground_below,
    match_set,
    nadir,
    perfect_calibration,
    raw_pixels,
    wall_ahead,
)

FOCAL, BASELINE = 800.0, 1.98
SETTINGS = Settings()
PERFECT = perfect_calibration()
# Closed forms hold on the axis; off the axis a turn by theta moves the image by theta (1 + x^2).
NARROW = 0.01


def test_divergence_makes_the_rigid_range_short_and_the_correction_takes_it_out() -> None:
    """1/Z' = 1/Z + theta/B: 4.5 mrad of relative toe turns 60 m into 52.8 m."""
    airframe = nadir()
    rig = Rig.from_airframe(airframe)
    matches = match_set(*raw_pixels(rig, ground_below(60.0, 300, 1, spread=NARROW), (0.00225, 0.00225)))
    deflection = bend((0.00225, 0.00225))
    answer = correct(matches, deflection, deflection, rig, airframe, SETTINGS).range
    assert answer.range_m == pytest.approx(60.0, abs=1e-6)
    assert answer.toe_rad == pytest.approx(0.0045, abs=1e-9)
    assert answer.rigid_range_m == pytest.approx(60.0 / (1.0 + 60.0 * 0.0045 / BASELINE), abs=0.01)
    assert answer.trusted


def test_trim_bend_makes_the_rigid_range_nonsense_and_convergence_makes_it_infinite() -> None:
    airframe = nadir()
    rig = Rig.from_airframe(airframe)
    for theta, expected in ((0.0414, 60.0 / (1.0 + 60.0 * 0.0414 / BASELINE)), (-0.0414, 0.0)):
        slopes = (theta / 2.0, theta / 2.0)
        matches = match_set(*raw_pixels(rig, ground_below(60.0, 300, 2, spread=NARROW), slopes))
        answer = correct(matches, bend(slopes), bend(slopes), rig, airframe, SETTINGS).range
        assert answer.range_m == pytest.approx(60.0, abs=1e-6)
        assert answer.rigid_range_m == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(("range_m", "sigma_one_m", "sigma_toe_m"), [(60.0, 0.455, 1.82), (20.0, 0.0505, 0.202)])
def test_sigma_of_one_match_and_of_one_milliradian(range_m: float, sigma_one_m: float, sigma_toe_m: float) -> None:
    """sigma_Z^2 = (Z^2 / (f B) sigma_d)^2 + (Z^2 / B sigma_theta)^2."""
    airframe = nadir(**PERFECT)
    rig = Rig.from_airframe(airframe)
    matches = match_set(*raw_pixels(rig, ground_below(range_m, 400, 3, spread=NARROW), (0.0, 0.0)), sigma_px=0.2)
    tip_sigma_rad = 1e-3 / np.sqrt(2.0)  # two independent tips make 1 mrad of relative toe
    answer = correct(
        matches,
        bend(slope_sigma_rad=tip_sigma_rad),
        bend(slope_sigma_rad=tip_sigma_rad),
        rig,
        airframe,
        SETTINGS,
        PairConditions(0.0),
    )
    np.testing.assert_allclose(answer.depths.sigma_pm * range_m**2, sigma_one_m, rtol=0.01)
    assert answer.causes_m.modal == pytest.approx(sigma_toe_m, rel=0.01)
    assert answer.range.toe_sigma_rad == pytest.approx(1e-3, rel=1e-6)


def test_antisymmetric_uncertainty_costs_a_nadir_pair_nothing() -> None:
    airframe = nadir(**PERFECT)
    rig = Rig.from_airframe(airframe)
    matches = match_set(*raw_pixels(rig, ground_below(60.0, 2000, 4, spread=NARROW), (0.0, 0.0)))
    for correlation, expected in ((1.0, 2.0), (-1.0, 0.0)):
        deflection = bend(slope_sigma_rad=0.001, correlation=correlation)
        answer = correct(matches, deflection, deflection, rig, airframe, SETTINGS, PairConditions(0.0))
        assert answer.range.toe_sigma_rad == pytest.approx(expected * 0.001, abs=1e-9)
        assert answer.causes_m.modal == pytest.approx(expected * 1.818, abs=0.02)


def test_bend_uncertainty_hardly_touches_a_forward_pair() -> None:
    """Roll leaves the middle of the image alone: the same 1 mrad that costs a nadir pair 1.8 m costs it centimetres."""
    airframe = forward(**PERFECT)
    rig = Rig.from_airframe(airframe)
    matches = match_set(*raw_pixels(rig, wall_ahead(60.0, 400, 5), (0.02, 0.02)))
    deflection = bend((0.02, 0.02), slope_sigma_rad=1e-3 / np.sqrt(2.0))
    answer = correct(matches, deflection, deflection, rig, airframe, SETTINGS, PairConditions(0.0))
    assert answer.range.range_m == pytest.approx(60.0, abs=1e-4)
    assert answer.range.toe_rad == pytest.approx(0.0, abs=1e-5)
    assert answer.causes_m.modal < 0.1


def test_bending_left_uncorrected_in_a_forward_pair_tilts_depth_from_row_to_row() -> None:
    """4.5 mrad of bending: 1.08 px at rows +-240 is Z^2 / (f B) * 1.08 px at 60 m, of opposite sign above and below."""
    airframe = forward(**PERFECT)
    rig = Rig.from_airframe(airframe)
    rows = np.array([-240.0, 240.0]) / FOCAL
    points = np.column_stack([np.full(2, 60.0), np.zeros(2), 60.0 * rows])
    matches = match_set(*raw_pixels(rig, points, (0.00225, 0.00225)))
    answer = correct(matches, bend(), bend(), rig, airframe, SETTINGS, PairConditions(0.0))
    error_px = (answer.depths.inverse_pm - 1.0 / 60.0) * FOCAL * BASELINE
    np.testing.assert_allclose(error_px, [-1.08, 1.08], atol=0.01)


def test_bending_left_uncorrected_in_a_forward_pair_shows_as_vertical_parallax() -> None:
    """1.44 px between the columns +-320, with opposite signs left and right."""
    airframe = forward(**PERFECT)
    rig = Rig.from_airframe(airframe)
    points = 1.0e4 * np.column_stack([np.ones(2), np.array([-0.4, 0.4]), np.zeros(2)])
    matches = match_set(*raw_pixels(rig, points, (0.00225, 0.00225)))
    answer = correct(matches, bend(), bend(), rig, airframe, SETTINGS, PairConditions(0.0))
    np.testing.assert_allclose(answer.depths.parallax_rad * FOCAL, [1.44, -1.44], atol=0.01)


def test_calibration_sigma_is_root_two_times_one_camera_for_toe() -> None:
    airframe = nadir(**perfect_calibration(rotation_sigma_rad=1e-3))
    rig = Rig.from_airframe(airframe)
    matches = match_set(*raw_pixels(rig, ground_below(60.0, 2000, 6, spread=NARROW), (0.0, 0.0)))
    answer = correct(matches, bend(), bend(), rig, airframe, SETTINGS, PairConditions(0.0))
    assert answer.range.toe_sigma_rad == pytest.approx(np.sqrt(2.0) * 1e-3, rel=1e-6)
    assert answer.causes_m.calibration == pytest.approx(3600.0 / BASELINE * np.sqrt(2.0) * 1e-3, rel=0.02)


@pytest.mark.parametrize(("camera_rad", "pair_rad"), [(1e-2, 0.0), (0.0, 1e-2 / np.sqrt(2.0))])
@pytest.mark.parametrize("bank_deg", [0.0, 30.0, -45.0])
def test_a_turn_of_both_cameras_moves_the_axis_over_tilted_ground(
    bank_deg: float, camera_rad: float, pair_rad: float
) -> None:
    """A turn by theta in the bank changes the range by ``Z tan(bank) theta``.

    Two independent mountings turn the pair by 1/root 2 of the sigma of either.
    """
    airframe = dataclasses.replace(nadir(**perfect_calibration(rotation_sigma_rad=camera_rad)), pair_sigma_rad=pair_rad)
    rig, bank = Rig.from_airframe(airframe), np.radians(bank_deg)
    down = np.array([0.0, np.sin(bank), np.cos(bank)])
    rays = ground_below(1.0, 1000, 8, spread=0.3)
    matches = match_set(*raw_pixels(rig, 50.0 * rays / (rays @ down)[:, np.newaxis], (0.0, 0.0)))
    measured = RelativeRotation(0, 0, np.zeros(3), np.zeros((3, 3)), np.zeros(3), np.zeros((3, 3)), 100, 1.0)
    answer = correct(matches, bend(), bend(), rig, airframe, SETTINGS, PairConditions(0.0, turned=measured))
    range_m = 50.0 / np.cos(bank)
    assert answer.range.range_m == pytest.approx(range_m, rel=1e-4)
    expected_m = abs(range_m * np.tan(bank)) * 1e-2 / np.sqrt(2.0)
    assert answer.causes_m.calibration == pytest.approx(expected_m, rel=0.05, abs=0.01)


def test_timing_sigma_counts_with_the_rate_of_the_bend() -> None:
    """A tip slope of 4.5 mrad at 5 Hz passes zero at 141 urad/ms; one camera stamped 1 ms wrong errs by that."""
    airframe = nadir(**PERFECT)
    rig = Rig.from_airframe(airframe)
    rate_radps = 0.0045 * 2.0 * np.pi * 5.0
    deflection = bend(qdot_mps=(rate_radps / 1.39, 0.0))
    matches = match_set(*raw_pixels(rig, ground_below(60.0, 400, 7, spread=NARROW), (0.0, 0.0)))
    answer = correct(matches, deflection, deflection, rig, airframe, SETTINGS, PairConditions(1e-3))
    assert answer.range.toe_sigma_rad == pytest.approx(np.sqrt(2.0) * 141e-6, rel=0.01)
    assert answer.causes_m.timing == pytest.approx(3600.0 / BASELINE * np.sqrt(2.0) * 141e-6, rel=0.02)


def test_toe_counts_more_off_the_axis() -> None:
    """At x = 0.3 from the axis one milliradian of toe is worth 1.09 on the axis."""
    airframe = nadir(**PERFECT)
    rig = Rig.from_airframe(airframe)
    points = 1.0e4 * np.array([[0.0, 0.0, 1.0], [0.0, 0.3, 1.0], [0.0, -0.3, 1.0]])
    matches = match_set(*raw_pixels(rig, points, (0.0005, 0.0005)))
    inverse = (
        correct(matches, bend(), bend(), rig, airframe, SETTINGS, PairConditions(0.0)).depths.inverse_pm * BASELINE
    )
    np.testing.assert_allclose(inverse - BASELINE / 1.0e4, 0.001 * np.array([1.0, 1.09, 1.09]), rtol=0.002)

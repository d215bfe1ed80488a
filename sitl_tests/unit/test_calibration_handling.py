"""Taps and tilts on the bench against closed forms: a rotated gravity vector, the integral of a rate."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.calibration.handling import Tilt, is_still, judge_tap, judge_tilt
from companion.records import Axis, Floats, Station

G = 9.80665
LEVEL = np.array([0.0, 0.0, -G])
ANGLE_RAD = math.radians(25.0)
ALL = dict.fromkeys(Station, Axis.ALL)


def rolled(angle_rad: float) -> Floats:
    """Ground's push in axes turned about the forward one, right wing down."""
    about_x = np.array([[1, 0, 0], [0, math.cos(angle_rad), math.sin(angle_rad)],
                        [0, -math.sin(angle_rad), math.cos(angle_rad)]])  # fmt: skip
    return about_x @ LEVEL


def pitched(angle_rad: float) -> Floats:
    """The same about the right one, nose up."""
    about_y = np.array([[math.cos(angle_rad), 0, -math.sin(angle_rad)], [0, 1, 0],
                        [math.sin(angle_rad), 0, math.cos(angle_rad)]])  # fmt: skip
    return about_y @ LEVEL


def judged(tilt: Tilt, *, rates: dict[Station, float] | None = None, axes: dict[Station, Axis] = ALL,
           **changed: Floats) -> dict[Station, str]:  # fmt: skip
    """Remedies after a right tilt by 25 degrees, with the readings of some stations changed."""
    right = rolled(ANGLE_RAD) if tilt is Tilt.RIGHT_WING_DOWN else pitched(ANGLE_RAD)
    after = {station: changed.get(station.name.lower(), right) for station in Station}
    turned = {station: (rates or {}).get(station, ANGLE_RAD) for station in Station}
    result = judge_tilt(dict.fromkeys(Station, LEVEL), after, turned, axes, tilt)
    return {station: entry.remedy for station, entry in result.items()}


@pytest.mark.parametrize("tilt", Tilt)
def test_a_right_tilt_passes_at_all_stations(tilt: Tilt) -> None:
    assert judged(tilt) == dict.fromkeys(Station, "")


def test_gravity_by_closed_form() -> None:
    """Right wing down the ground pushes from the right: y reads -g sin(phi); nose up it pushes forward."""
    assert rolled(ANGLE_RAD) == pytest.approx([0.0, -G * math.sin(ANGLE_RAD), -G * math.cos(ANGLE_RAD)])
    assert pitched(ANGLE_RAD) == pytest.approx([G * math.sin(ANGLE_RAD), 0.0, -G * math.cos(ANGLE_RAD)])
    assert Tilt.RIGHT_WING_DOWN.angle_rad(rolled(ANGLE_RAD)) == pytest.approx(ANGLE_RAD)
    assert Tilt.NOSE_UP.angle_rad(pitched(ANGLE_RAD)) == pytest.approx(ANGLE_RAD)


@pytest.mark.parametrize(("tilt", "column", "letter"), [(Tilt.RIGHT_WING_DOWN, 1, "y"), (Tilt.NOSE_UP, 0, "x")])
def test_an_axis_with_the_wrong_sign_is_named(tilt: Tilt, column: int, letter: str) -> None:
    wrong = rolled(ANGLE_RAD) if tilt is Tilt.RIGHT_WING_DOWN else pitched(ANGLE_RAD)
    wrong[column] *= -1.0
    remedies = judged(tilt, left=wrong)
    assert remedies[Station.LEFT] == f"{letter} has the wrong sign: turn it in [left].source"
    assert remedies[Station.RIGHT] == remedies[Station.ROOT] == ""


@pytest.mark.parametrize(("tilt", "letter"), [(Tilt.RIGHT_WING_DOWN, "p"), (Tilt.NOSE_UP, "q")])
def test_a_rate_with_the_wrong_sign_or_of_another_axis_is_named(tilt: Tilt, letter: str) -> None:
    turned = judged(tilt, rates={Station.RIGHT: -ANGLE_RAD})[Station.RIGHT]
    assert turned == f"{letter} has the wrong sign: turn it in [right].source"
    assert f"{letter} is another axis" in judged(tilt, rates={Station.RIGHT: 0.0})[Station.RIGHT]


def test_a_vertical_axis_upside_down_is_named() -> None:
    assert "z does not show" in judged(Tilt.NOSE_UP, left=-pitched(ANGLE_RAD))[Station.LEFT]


def test_exchanged_axes_are_told_from_a_wrong_sign() -> None:
    """A node turned by a quarter about its vertical feels a roll as a pitch."""
    remedy = judged(Tilt.RIGHT_WING_DOWN, left=pitched(ANGLE_RAD))[Station.LEFT]
    assert "exchanged axes" in remedy
    assert "+25.0 deg" in remedy


def test_a_person_who_tilts_the_other_way_is_told() -> None:
    other = rolled(-ANGLE_RAD)
    remedies = judged(
        Tilt.RIGHT_WING_DOWN, rates=dict.fromkeys(Station, -ANGLE_RAD), root=other, left=other, right=other
    )
    assert "the other way" in remedies[Station.ROOT]


def test_a_node_that_sends_the_vertical_alone_is_judged_by_it() -> None:
    axes = {**ALL, Station.LEFT: Axis.Z}
    alone = rolled(ANGLE_RAD)
    alone[:2] = 0.0
    assert judged(Tilt.RIGHT_WING_DOWN, axes=axes, left=alone)[Station.LEFT] == ""
    assert "exchanged axes" in judged(Tilt.RIGHT_WING_DOWN, axes=axes, left=LEVEL)[Station.LEFT]


def tapped(left_mps2: float, right_mps2: float) -> dict[Station, Floats]:
    samples = {station: np.tile([*LEVEL, 0.0, 0.0, 0.0], (1000, 1)) for station in Station}
    samples[Station.LEFT][500, 2] += left_mps2
    samples[Station.RIGHT][500, 2] -= right_mps2
    return samples


def test_a_tap_names_its_node() -> None:
    assert judge_tap(tapped(8.0, 1.2), Station.LEFT).remedy == ""
    assert "left 8.0 m/s^2, right 1.2 m/s^2" in judge_tap(tapped(8.0, 1.2), Station.LEFT).figure
    assert "exchanged" in judge_tap(tapped(1.2, 8.0), Station.LEFT).remedy
    assert "alike" in judge_tap(tapped(8.0, 7.0), Station.LEFT).remedy


def test_a_wing_in_a_hand_is_not_still() -> None:
    rng = np.random.default_rng(1)
    still = {station: np.tile([*LEVEL, 0.0, 0.0, 0.0], (500, 1)) + 0.05 * rng.standard_normal((500, 6))
             for station in Station}  # fmt: skip
    assert is_still(still)
    moved = {**still, Station.LEFT: still[Station.LEFT] + np.linspace(0.0, 3.0, 500)[:, np.newaxis]}
    assert not is_still(moved)
    assert not is_still({**still, Station.RIGHT: np.empty((0, 6))}), "a silent node is not known to be still"

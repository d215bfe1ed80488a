"""The true relative toe of a simulated shot: yaw between the optical axes, not the slope of the tips."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.evaluation.accuracy_targets import published_off_axis
from companion.evaluation.shot_scores import PipelineOutputs
from companion.evaluation.true_geometry import TrueGeometry
from companion.params.airframe import Mode, Uncertain
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, CorrectedRange, MatchSet, Side
from companion.sim.flight.flight import build_flight
from companion.sim.vision.posed_pair import PosedPair
from companion.sim.vision.renderer import Renderer
from companion.sim.vision.scene import Scene, ground_scene, terrace

EXPOSED_S = np.linspace(1.0, 2.5, 16)
MOUNTED_RAD = 0.005  # what drawn mountings, a tip's twist and rotation between both exposures may add


def _exposed(t_s: float) -> MatchSet:
    return MatchSet(
        pair_id=0,
        plan_id=0,
        clocks=(ClockName.HOST, ClockName.HOST),
        mid_exposure_ns=np.full(2, round(1e9 * t_s)),
        exposure_ns=1_000_000,
        row_time_ns=0,
        left_px=np.zeros((0, 2)),
        right_px=np.zeros((0, 2)),
        sigma_px=np.zeros(0),
        matched_host_ns=0,
    )


@pytest.mark.parametrize(("name", "toe_per_slope"), [("nadir-2m", 1.0), ("forward-2m", 0.0)])
def test_bending_is_toe_of_a_pair_that_looks_down_and_roll_of_one_that_looks_ahead(
    name: str, toe_per_slope: float
) -> None:
    flight = build_flight(load_airframe(name), 1, 3.0)
    judge = TrueGeometry(flight, Renderer(flight.real.actual, flight.truth, ground_scene(1), 1), Settings(), 0)
    slope_rad = np.array([judge.true_deflection(round(1e9 * t_s)).slope_rad.sum() for t_s in EXPOSED_S])
    toe_rad = np.array([judge.true_toe_rad(_exposed(t_s)) for t_s in EXPOSED_S])
    assert np.ptp(slope_rad) > 4.0 * MOUNTED_RAD
    np.testing.assert_allclose(toe_rad, toe_per_slope * slope_rad, atol=MOUNTED_RAD)


def test_true_deflection_has_the_lift_of_every_mode() -> None:
    """A family may have a third mode: both tips' lift is that of all, left less, right more the antisymmetric."""
    airframe = load_airframe("nadir-2m")
    third = Mode(Uncertain(75.0, 3.0), Uncertain(0.02, 0.01), Uncertain(7.85, 0.3))
    wing = dataclasses.replace(airframe.wing, further_symmetric=(third,))
    flight = build_flight(dataclasses.replace(airframe, wing=wing), 1, 1.0)
    judge = TrueGeometry(flight, PosedPair(flight.real.actual, flight.truth, ground_scene(1)), Settings(), 0)
    true, estimate = flight.truth.at(500_000_000), judge.true_deflection(500_000_000)
    assert len(true.q_m) > 4
    for families, lift in ((estimate.q_m, true.lift_m), (estimate.qdot_mps, true.lift_rate_mps)):
        assert [families[0] - families[1], families[0] + families[1]] == pytest.approx(lift.tolist())


def test_the_toe_lies_in_the_plane_of_the_baseline_as_flown() -> None:
    """Exposed 10 ms apart at 22 m/s the baseline turns by 0.1 rad, and 0.6 % of the toe out of its plane.

    Held against both cameras' places and axes in NED, which know neither exposures nor velocity.
    """
    flight = build_flight(load_airframe("nadir-2m"), 1, 3.0)
    pair = PosedPair(flight.real.actual, flight.truth, ground_scene(1))
    judge = TrueGeometry(flight, pair, Settings(), 0)
    for t_s in EXPOSED_S:
        mids_ns = round(1e9 * t_s) + np.array([5_000_000, -5_000_000])
        left, right = (pair.view(side, int(mids_ns[side])) for side in Side)
        baseline = right.centre_ned_m - left.centre_ned_m
        x = baseline / np.linalg.norm(baseline)
        axes = [view.camera_from_ned[2] for view in (left, right)]
        z = sum(axes) - (sum(axes) @ x) * x
        angles = [np.arctan2(axis @ x, axis @ (z / np.linalg.norm(z))) for axis in axes]
        toe_rad = judge.true_toe_rad(dataclasses.replace(_exposed(t_s), mid_exposure_ns=mids_ns))
        # what remains: mountings that the belief does not know, at rest, and a lift that changes between the exposures
        assert toe_rad == pytest.approx(angles[1] - angles[0], abs=5e-5)


def test_the_true_range_ends_at_the_first_surface_on_the_axis() -> None:
    """Along an axis tilted from the vertical, a roof is nearer than the ground by its height over the cosine."""
    flight = build_flight(load_airframe("nadir-2m"), 1, 3.0)
    bare = ground_scene(1)
    north_m, east_m, _ = flight.truth.at(round(1e9 * EXPOSED_S[3])).position_ned_m
    roofed = Scene((*bare.planes, terrace(north_m, east_m, (40.0, 40.0), 6.0, 7)), 1)
    over, beside = EXPOSED_S[3], 2.9
    ranges = {}
    for scene in (bare, roofed):
        pair = PosedPair(flight.real.actual, flight.truth, scene)
        judge = TrueGeometry(flight, pair, Settings(), 0)
        ranges[scene] = [judge.true_range_m(_exposed(t_s)) for t_s in (over, beside)]
    cosine = flight.truth.at(round(1e9 * over)).body_from_ned[2, 2]
    assert ranges[bare][0] - ranges[roofed][0] == pytest.approx(6.0 / cosine, rel=1e-9)
    assert ranges[bare][1] == ranges[roofed][1]


def test_an_axis_that_meets_nothing_has_no_true_range() -> None:
    flight = build_flight(load_airframe("forward-2m"), 1, 3.0)
    pair = PosedPair(flight.real.actual, flight.truth, Scene((), 1))
    assert np.isnan(TrueGeometry(flight, pair, Settings(), 0).true_range_m(_exposed(1.0)))


def test_ranges_of_ground_beside_a_roof_on_the_axis_are_counted_as_off() -> None:
    flight = build_flight(load_airframe("nadir-2m"), 1, 3.0)
    north_m, east_m, _ = flight.truth.at(round(1e9 * EXPOSED_S[3])).position_ned_m
    roof = terrace(north_m, east_m, (4.0, 4.0), 8.0, 7)
    pair = PosedPair(flight.real.actual, flight.truth, Scene((*ground_scene(1).planes, roof), 1))
    judge = TrueGeometry(flight, pair, Settings(), 0)
    bare = TrueGeometry(flight, PosedPair(flight.real.actual, flight.truth, ground_scene(1)), Settings(), 0)
    shots = {i: dataclasses.replace(_exposed(EXPOSED_S[3]), pair_id=i) for i in range(3)}
    ground_m = bare.true_range_m(shots[0])
    ranges = {
        0: CorrectedRange(0, 0, 0, 0, ground_m, 0.1, 0.0, 1e-5, 0.0, 100, True, None),
        1: CorrectedRange(1, 0, 0, 0, ground_m - 8.0, 0.1, 0.0, 1e-5, 0.0, 100, True, None),
        2: CorrectedRange(2, 0, 0, 0, ground_m, 0.1, 0.0, 1e-5, 0.0, 100, False, None),
    }
    outputs = PipelineOutputs(ranges=ranges, matches=shots)
    assert published_off_axis(judge, outputs) == 1
    assert published_off_axis(bare, outputs) == 1

"""The sigma of every single match, against the true depth of what it shows: rendered flight, true wing, true lenses."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.stereo.exposure import TipMotion, exposures
from companion.core.stereo.geometry import orientation_axis
from companion.core.stereo.inverse_depth import consistent
from companion.core.stereo.triangulation import match_rays, range_axis_of_rig, triangulate
from companion.core.stereo.vision import VisionState
from companion.evaluation.true_geometry import TrueGeometry
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, FramePair, MatchSet, Side
from companion.sim.flight.flight import build_flight
from companion.sim.flight.offline import HOST_EPOCH_NS
from companion.sim.vision.cameras import Shutters, render_pair
from companion.sim.vision.renderer import Renderer
from companion.sim.vision.scene import obstacle_scene

SEED, FIRST_S, LAST_S, PAIRS = 3, 2.0, 9.0, 14


def _errors(judge: TrueGeometry, matches: MatchSet) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth over its sigma, match by match, and which matches the range and the sectors would use."""
    truth, middle_ns = judge.flight.truth, int(matches.mid_exposure_ns.mean()) - HOST_EPOCH_NS
    bends = [judge.true_deflection(int(t_ns)) for t_ns in matches.mid_exposure_ns]
    body = truth.at(middle_ns)
    rig, tips = judge.pair.rig, TipMotion.from_airframe(judge.flight.real.actual)
    moving = exposures(rig, tips, bends[0], bends[1], body.body_from_ned @ body.velocity_ned_mps)
    sight = range_axis_of_rig(rig, orientation_axis(judge.flight.airframe.orientation))
    depths = triangulate(match_rays(rig, moving, matches), sight, matches.sigma_px / rig.left.lens.focal_px)
    view = judge.pair.view(Side.LEFT, int(matches.mid_exposure_ns[0]) - HOST_EPOCH_NS)
    points = view.points_ned_m(judge.pair.scene, matches.left_px)
    depth = ((points - body.position_ned_m) @ body.body_from_ned.T - sight.origin_m) @ sight.axis
    used = np.zeros(len(depth), dtype=bool)
    used[consistent(depths)] = True
    return (depths.inverse_pm - 1.0 / depth) / depths.sigma_pm, used & np.isfinite(depth)


@pytest.mark.slow
def test_features_and_what_fills_between_them_are_as_right_as_they_say() -> None:
    airframe = load_airframe("forward-2m")
    flight = build_flight(airframe, SEED, LAST_S + 1.0)
    scene = obstacle_scene(flight.truth, SEED)
    renderer = Renderer(flight.real.actual, flight.truth, scene, SEED)
    judge = TrueGeometry(flight, renderer, Settings(), HOST_EPOCH_NS)
    shutters, vision = Shutters(flight.real.actual, SEED), VisionState.create(airframe, Settings())
    features, filled = [], []
    for shot, edge_s in enumerate(np.linspace(FIRST_S, LAST_S, PAIRS)):
        pair = render_pair(renderer, shutters, int(edge_s * 1e9), shot)
        left, right = (
            dataclasses.replace(frame, clock=ClockName.HOST, mid_exposure_ns=frame.mid_exposure_ns + HOST_EPOCH_NS)
            for frame in (pair.left, pair.right)
        )
        matches = vision.match(FramePair(shot, left, right), 0)
        over, used = _errors(judge, matches)
        count = len(over) - matches.filled
        features.append(over[:count][used[:count]])
        filled.append(over[count:][used[count:]])
    for over in (np.concatenate(features), np.concatenate(filled)):
        assert len(over) > 150
        assert np.mean(np.abs(over) > 5.0) < 0.005
        assert 0.9 < np.sqrt(np.mean(over[np.abs(over) < 5.0] ** 2)) < 1.15

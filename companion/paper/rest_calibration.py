"""Calibration before the vibration, as in the paper: flat targets at known distances, the wing at rest.

Fitted are the right camera's rotation and both focal lengths, with the airframe's sigmas as priors. A static bend of
the hanging wing goes into the rotation, as it does in the paper's calibration; the uncertainty that the
pictures leave goes into the calibrated airframe as the sigmas of the right camera's rotation and of the focal lengths;
the static bend is known to the same.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from companion.core.stereo.exposure import rest_exposures
from companion.core.stereo.geometry import Rig, orientation_axis
from companion.core.stereo.inverse_depth import consistent
from companion.core.stereo.matching import match_pair
from companion.core.stereo.search import trim_search
from companion.core.stereo.triangulation import match_rays, range_axis_of_rig, triangulate
from companion.paper.bench import Setup, at_rest, laboratory_flight, target_scene
from companion.params.airframe import Airframe, Camera, Uncertain
from companion.params.settings import Settings
from companion.records import Floats, MatchSet
from companion.sim.vision.cameras import Shutters, render_pair
from companion.sim.vision.renderer import Renderer

_EDGES_NS = (500_000_000, 900_000_000, 1_300_000_000)  # chosen: three pictures, whose noise averages
_STEPS = 4  # Newton steps (numerical)
_DIFFERENCE = np.array([1e-5, 1e-5, 1e-5, 1e-2, 1e-2])  # numerical: rad and px, of the difference quotients
_ROTATION_SIGMA_RAD = 0.003  # wide: a hanging wing's static bend is in it (choice)
_COMMON_PX = 0.02  # chosen: what all matches of a picture may share (core/stereo/ranging.py)


def calibrate(setup: Setup, settings: Settings, distances_m: Sequence[float]) -> Airframe:
    """The airframe as the calibration leaves it; ``setup`` names aircraft and seed."""
    views = [(_pictures(at_rest(setup, z), settings_for(settings, z)), z) for z in distances_m]
    theta = np.zeros(5)
    for _ in range(_STEPS):
        residual = _residuals(setup.airframe, views, theta)
        columns = []
        for k, step in enumerate(_DIFFERENCE):
            moved = theta.copy()
            moved[k] += step
            columns.append((_residuals(setup.airframe, views, moved) - residual) / step)
        jacobian = np.stack(columns, axis=1)
        weight = 1.0 / np.maximum(1.0, np.abs(residual) / 3.0)  # a wrong match counts little
        normal = (jacobian * weight[:, None]).T @ jacobian
        theta = theta - np.linalg.solve(normal, (jacobian * weight[:, None]).T @ residual)
    return _with_sigmas(_changed(setup.airframe, theta), np.sqrt(np.diag(np.linalg.inv(normal))))


def settings_for(settings: Settings, distance_m: float) -> Settings:
    """Range limits about a laboratory target, so that matches are not looked for at infinity."""
    near = settings.replace("RNG_MIN", max(0.5, 0.6 * distance_m))
    return near.replace("RNG_MAX", max(5.0, 2.0 * distance_m))


def _pictures(setup: Setup, settings: Settings) -> list[MatchSet]:
    flight = laboratory_flight(setup)
    renderer = Renderer(flight.real.actual, flight.truth, target_scene(setup), setup.seed)
    shutters = Shutters(flight.real.actual, setup.seed)
    rig = Rig.from_airframe(setup.airframe)
    search = trim_search(rig, setup.airframe, settings)
    pairs = [render_pair(renderer, shutters, edge_ns, shot) for shot, edge_ns in enumerate(_EDGES_NS)]
    return [match_pair(pair, rig, search, pair.left.mid_exposure_ns) for pair in pairs]


def _residuals(airframe: Airframe, views: list[tuple[list[MatchSet], float]], theta: Floats) -> Floats:
    """Depth and parallax errors of every match in sigmas, then the priors."""
    rig = Rig.from_airframe(_changed(airframe, theta))
    sight = range_axis_of_rig(rig, orientation_axis(airframe.orientation))
    focal = rig.left.lens.focal_px
    parts = []
    for pictures, distance_m in views:
        for matches in pictures:
            sigma_rad = np.hypot(matches.sigma_px, _COMMON_PX) / focal
            depths = triangulate(match_rays(rig, rest_exposures(rig), matches), sight, sigma_rad)
            consistent_points = consistent(depths)
            parts.append((depths.inverse_pm[consistent_points] - 1.0 / distance_m) / depths.sigma_pm[consistent_points])
            parts.append(depths.parallax_rad[consistent_points] / sigma_rad[consistent_points])
    focal_sigma = airframe.camera_pair[0].focal_px.sigma
    parts.append(theta / np.array([*[_ROTATION_SIGMA_RAD] * 3, focal_sigma, focal_sigma]))
    return np.concatenate(parts)


def _changed(airframe: Airframe, theta: Floats) -> Airframe:
    left, right = airframe.camera_pair
    x, y, z = (np.array(right.rotation_rad) + theta[:3]).tolist()
    turned = dataclasses.replace(_refocused(right, float(theta[4])), rotation_rad=(x, y, z))
    return dataclasses.replace(airframe, left_camera=_refocused(left, float(theta[3])), right_camera=turned)


def _with_sigmas(airframe: Airframe, sigma: Floats) -> Airframe:
    """The calibrated airframe with the sigmas (5,) that the pictures leave; the relative rotation has one sigma."""
    left, right = airframe.camera_pair
    rotation, left_px, right_px = float(np.max(sigma[:3])), float(sigma[3]), float(sigma[4])
    trim = Uncertain(airframe.wing.trim_bend_m.value)
    return dataclasses.replace(
        airframe,
        wing=dataclasses.replace(airframe.wing, trim_bend_m=trim),
        left_camera=dataclasses.replace(left, rotation_sigma_rad=0.0, focal_px=Uncertain(left.focal_px.value, left_px)),
        right_camera=dataclasses.replace(
            right, rotation_sigma_rad=rotation, focal_px=Uncertain(right.focal_px.value, right_px)
        ),
    )


def _refocused(camera: Camera, by_px: float) -> Camera:
    return dataclasses.replace(camera, focal_px=Uncertain(camera.focal_px.value + by_px, camera.focal_px.sigma))

"""Advice for the airframe file when the axes diverge by more than it states."""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.params.airframe import Airframe
from companion.units import Orientation
from mission_scripts.common.convergence import Offset

_PROVEN = 2.0  # sigmas


@dataclass(frozen=True, slots=True)
class Advice:
    """``lines`` are for people, ``values`` (dotted key: value, sigma where it has one) for programs."""

    lines: list[str]
    values: dict[str, object]


def baseline_m(airframe: Airframe) -> float:
    """Distance between the cameras; ValueError where there are none."""
    if airframe.left_camera is None or airframe.right_camera is None:
        raise ValueError(f"airframe '{airframe.name}' has no camera pair")
    return math.dist(airframe.left_camera.position_m, airframe.right_camera.position_m)


def advise(airframe: Airframe, offset: Offset) -> Advice:
    """Turn an offset into new values.

    A pair that looks down sees bending as divergence, ``theta = 2 s q``: what is left over in level flight is trim bend
    that the airframe does not have. A pair that looks ahead sees bending as roll, so there it is the cameras' mounting:
    half of it to each, about the camera's own y axis (``rotation_rad``), which points down in the image and turns the
    axis to the right.
    """
    if abs(offset.toe_rad) < _PROVEN * offset.sigma_rad:
        same = (
            f"{1e3 * offset.toe_rad:+.2f} +- {1e3 * offset.sigma_rad:.2f} mrad is no proof of an offset: change nothing"
        )
        return Advice([same], {})
    advice = _trim(airframe, offset) if airframe.orientation == Orientation.DOWN else _mounting(airframe, offset)
    if offset.scale_matters:
        advice.lines.append(
            f"and ranges are {offset.scale:.4f} +- {offset.scale_sigma:.4f} of what they should be: focal length or "
            "baseline; a focal calibration (spanwise calibrate) tells which"
        )
    return advice


def _trim(airframe: Airframe, offset: Offset) -> Advice:
    wing = airframe.wing
    gains = sum(camera.slope_gain for camera in airframe.camera_pair)
    per_metre = gains * wing.symmetric.slope_factor_radpm.value
    value = wing.trim_bend_m.value + offset.toe_rad / per_metre
    sigma = abs(offset.sigma_rad / per_metre)
    new = f"trim_bend_m = {{ value = {value:.5f}, sigma = {sigma:.5f} }}"
    change = f"[wing] {new}   # was {wing.trim_bend_m.value:.5f}, {1e3 * offset.toe_rad / per_metre:+.2f} mm"
    return Advice([change], {"wing.trim_bend_m": {"value": value, "sigma": sigma}})


def _mounting(airframe: Airframe, offset: Offset) -> Advice:
    lines, values = [], dict[str, object]()
    for name, side in (("left_camera", -0.5), ("right_camera", 0.5)):
        camera = airframe.left_camera if side < 0 else airframe.right_camera
        assert camera is not None
        x, y, z = camera.rotation_rad
        turned = [x, y + side * offset.toe_rad, z]
        lines.append(
            f"[{name}] rotation_rad = [{', '.join(f'{entry:.6f}' for entry in turned)}]   # was [{x}, {y}, {z}]"
        )
        values[f"{name}.rotation_rad"] = turned
    sigma = offset.sigma_rad / math.sqrt(2.0)
    lines.append(f"both: rotation_sigma_rad = {sigma:.6f}")
    return Advice(lines, values)

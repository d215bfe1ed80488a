"""A calibrated rig in an airframe: its cameras take the fit's place, unless these are not the base's cameras."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from companion.calibration.lens_sigmas import LensSigmas, lens_sigmas, look_sigma_rad
from companion.calibration.stereo_rig import LensFit, RigFit
from companion.core.stereo.geometry import axes_from_body
from companion.core.stereo.rotation import exp_rotation, log_rotation
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Camera, Uncertain
from companion.records import Floats, Side

_BASELINE_OFF = 0.02  # of the base airframe's baseline: a print "fit to page" is off by 3 % (choice)
_BASELINE_TOLD = 0.01  # of it: worth a second look at tape and board (choice)
_TAPE_SIGMA_M = 0.002  # of a baseline by tape, from lens to lens (choice)
_MEASURE = "measure a square of the board for --square-m"
_FOCAL_OFF = 0.1  # of the base airframe's focal length: data sheets are right to 2 % (choice)
_TURN_OFF_RAD = 0.175  # 10 degrees between the cameras: no eye mounts worse (choice)
_ASIDE_RAD = 0.785  # 45 degrees between the baselines' directions: more is another side, no mounting error (choice)


def airframe_with_rig(base: Airframe, fit: RigFit) -> Airframe:
    """The base airframe with calibrated lenses; the left camera keeps its mounting, the right one follows from it.

    Raises
    ------
    ConfigError
        The base has no cameras, or they are not where the fit has them: a wrong board, or cameras swapped.
    """
    pair, sigmas = base.camera_pair, lens_sigmas(fit.bundle, fit.size_px)
    left, right = (_with_lens(pair[k], fit.lenses[k], sigmas[k], fit.size_px) for k in (0, 1))
    left_from_body = exp_rotation(-np.array(left.rotation_rad)) @ axes_from_body(left.axes, "left_camera.axes")
    right_from_left = exp_rotation(fit.rotation_rad)
    turned = right_from_left @ left_from_body @ axes_from_body(right.axes, "right_camera.axes").T
    x, y, z = (float(entry) for entry in -log_rotation(turned))
    centre_left = -right_from_left.T @ fit.translation_m
    _require_like_focal(base, fit)
    _require_like(pair, log_rotation(turned), left_from_body.T @ centre_left)
    px, py, pz = (float(entry) for entry in np.array(left.position_m) + left_from_body.T @ centre_left)
    # each camera is given half of the variance; what rotation and principal points trade is in neither
    sigma = float(np.sqrt(np.mean(look_sigma_rad(fit.bundle, fit.size_px) ** 2) / 2.0))
    right = dataclasses.replace(right, rotation_rad=(x, y, z), position_m=(px, py, pz), rotation_sigma_rad=sigma)
    left = dataclasses.replace(left, rotation_sigma_rad=sigma)
    return dataclasses.replace(base, left_camera=left, right_camera=right, pair_sigma_rad=_pair_sigma_rad(base))


def _pair_sigma_rad(base: Airframe) -> float:
    """Sigma of a turn of both cameras as the base knows it: no board tells how they sit on the aircraft."""
    return math.hypot(base.pair_sigma_rad, *(0.5 * camera.rotation_sigma_rad for camera in base.camera_pair))


def _require_like(pair: tuple[Camera, Camera], turn_rad: Floats, apart_m: Floats) -> None:
    """Refuse a right camera, turned against its axes and apart from the left one (body), that is not the base's."""
    base_m = np.array(pair[1].position_m) - np.array(pair[0].position_m)
    length_m, base_length_m = float(np.linalg.norm(apart_m)), float(np.linalg.norm(base_m))
    if abs(length_m - base_length_m) > max(_BASELINE_OFF * base_length_m, 3.0 * _TAPE_SIGMA_M):
        raise ConfigError(
            f"{_apart(length_m, base_length_m)}: {_MEASURE}; where the file is wrong, correct its cameras' position_m "
            "by a tape"
        )
    turn = exp_rotation(turn_rad) @ exp_rotation(np.array(pair[1].rotation_rad))
    off_rad = float(np.linalg.norm(log_rotation(turn)))
    aside_rad = math.acos(max(-1.0, min(1.0, float(apart_m @ base_m) / (length_m * base_length_m))))
    if off_rad > _TURN_OFF_RAD or aside_rad > _ASIDE_RAD:
        raise ConfigError(
            f"the right camera is turned by {math.degrees(off_rad):.0f} degrees, and its place from the left one by "
            f"{math.degrees(aside_rad):.0f} degrees, against the airframe file: are the cameras swapped or the images "
            "mirrored? Else correct axes, rotation_rad and position_m of its cameras"
        )


def rough_focal_px(base: Airframe, width_px: int) -> tuple[float, float]:
    """Focal lengths of the left and the right camera of the base airframe, for images of another width, too."""
    left, right = (camera.focal_px.value * width_px / camera.width_px for camera in base.camera_pair)
    return left, right


def _require_like_focal(base: Airframe, fit: RigFit) -> None:
    """Refuse focal lengths that are not the base's."""
    for side, lens, base_px in zip(Side, fit.lenses, rough_focal_px(base, fit.size_px[0]), strict=True):
        if abs(lens.values[0] - base_px) > _FOCAL_OFF * base_px:
            raise ConfigError(
                f"the {side.name.lower()} focal length is {lens.values[0]:.0f} px by the board and {base_px:.0f} px by "
                "the airframe file: tilt the board by 20 degrees and more, to all sides; where the file is wrong, of "
                "another lens, correct its focal_px"
            )


def baselines(base: Airframe, fit: RigFit) -> str:
    """Sentence with both baselines, the board's and the base airframe's, and what to do where they differ."""
    left, right = (np.array(camera.position_m) for camera in base.camera_pair)
    length_m, base_length_m = float(np.linalg.norm(fit.translation_m)), float(np.linalg.norm(right - left))
    differs = abs(length_m / base_length_m - 1.0) > _BASELINE_TOLD
    return _apart(length_m, base_length_m) + (f"; ranges are long or short by as much: {_MEASURE}" if differs else "")


def _apart(length_m: float, base_length_m: float) -> str:
    percent = round(100.0 * (length_m / base_length_m - 1.0), 1) + 0.0  # not -0.0
    return (
        f"the board puts the cameras {length_m:.3f} m apart, the airframe file {base_length_m:.3f} m ({percent:+.1f} %)"
    )


def _with_lens(camera: Camera, fit: LensFit, sigmas: LensSigmas, size_px: tuple[int, int]) -> Camera:
    fx, fy, cx, cy, *bent = (float(value) for value in fit.values)
    return dataclasses.replace(
        camera,
        width_px=size_px[0],
        height_px=size_px[1],
        focal_px=Uncertain(fx, float(fit.sigmas[0])),
        focal_ratio=fy / fx,
        principal_px=(cx, cy),
        distortion=tuple(bent),
        tilt_sigma_rad=sigmas.tilt_rad,
        prism_sigma=sigmas.prism,
        radial_sigma=sigmas.radial,
    )

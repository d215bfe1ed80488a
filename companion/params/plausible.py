"""Plausible aircraft: the range of every number of an airframe file, and relations between the numbers.

The ranges are wide: they hold a bench beam of 10 cm and the largest solar aircraft. What is outside is a slip of unit,
sign or place, and would end in ranges that are wrong or in a tracker that cannot begin.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from companion.params.airframe import FAMILIES, Airframe, Camera, Sensor, Uncertain
from companion.records import AXIS_LETTERS


@dataclass(frozen=True, slots=True)
class Range:
    """Where the value of a key must lie, and up to what its sigma; ``why`` ends the sentence of a refusal.

    ``most_sigma`` of 0: a key without a sigma.
    """

    minimum: float
    maximum: float
    unit: str
    why: str
    most_sigma: float = 0.0


# by class, then by key; an array's elements each
RANGES: dict[str, dict[str, Range]] = {
    "Airframe": {
        "orientation": Range(0, 39, "", "MAVLink's sensor orientations are 0 (forward), 25 (down) and others below 40"),
        "pair_sigma_rad": Range(0, 1, "rad", "a sigma"),
    },
    "Wing": {
        "semispan_m": Range(0.05, 50, "m", "from a bench beam to the largest solar aircraft"),
        "trim_bend_m": Range(-20, 20, "m", "more than any wing bends", 20),
        "bend_per_g_m": Range(-20, 20, "m", "more than any wing bends", 20),
        "shortening": Range(0, 3, "", "1 for a cantilever, 0 for a tip that moves straight up", 3),
    },
    "Mode": {
        "frequency_hz": Range(0.2, 500, "Hz", "bending modes of wings and beams", 500),
        "damping": Range(1e-4, 0.5, "", "a ratio of the critical damping, 0.03 for 3 %", 1),
        "slope_factor_radpm": Range(-500, 500, "rad/m", "a cantilever has 1.38 / semispan", 500),
        "twist_factor_radpm": Range(-500, 500, "rad/m", "nose-up twist per metre of tip deflection", 500),
    },
    "Gust": {
        "deflection_rms_m": Range(1e-8, 10, "m", "the first mode's deflection in gusts, never none", 30),
        "corners_hz": Range(0, 1000, "Hz", "corners of the gusts' spectrum, 0 for white"),
    },
    "Source": {
        "component": Range(0, 255, "", "a MAVLink component id"),
        "stamp_offset_s": Range(-1, 1, "s", "added to every stamp"),
    },
    "Sensor": {
        "position_m": Range(-100, 100, "m", "from the fuselage IMU"),
        "rate_hz": Range(5, 50_000, "Hz", "samples a second of an inertial sensor"),
        "accel_noise_mps2_rthz": Range(1e-8, 10, "m/s^2/rt Hz", "no sensor is without noise"),
        "gyro_noise_radps_rthz": Range(1e-10, 1, "rad/s/rt Hz", "no sensor is without noise"),
        "accel_bias_sigma_mps2": Range(0, 20, "m/s^2", "a sigma"),
        "gyro_bias_sigma_radps": Range(0, 5, "rad/s", "a sigma"),
        "bias_time_s": Range(0.1, 1e9, "s", "how long a bias takes to drift"),
        "accel_scale_sigma": Range(0, 0.5, "", "a sigma, 0.005 for 0.5 %"),
        "gyro_scale_sigma": Range(0, 0.5, "", "a sigma, 0.005 for 0.5 %"),
        "misalignment_sigma_rad": Range(0, 0.5, "rad", "a sigma"),
        "time_offset_sigma_s": Range(0, 0.5, "s", "a sigma"),
        "height_sigma_m": Range(0, 1, "m", "a sigma"),
        "accel_range_mps2": Range(10, 1e5, "m/s^2", "it must hold gravity"),
        "gyro_range_radps": Range(0.1, 1e4, "rad/s", "beyond it a sample is saturated"),
        "lowpass_accel_hz": Range(0, 50_000, "Hz", "0 for none"),
        "lowpass_gyro_hz": Range(0, 50_000, "Hz", "0 for none"),
    },
    "Camera": {
        "width_px": Range(16, 32_768, "px", "columns of the image"),
        "height_px": Range(16, 32_768, "px", "rows of the image"),
        "focal_px": Range(10, 1e6, "px", "focal length over pixel pitch", 1e5),
        "principal_px": Range(-32_768, 65_536, "px", "near the middle of the image"),
        "position_m": Range(-100, 100, "m", "from the fuselage IMU"),
        "rotation_rad": Range(-1.6, 1.6, "rad", "the small turn from the axes to the camera as mounted"),
        "rotation_sigma_rad": Range(0, 1, "rad", "a sigma"),
        "drift_sigma_rad": Range(0, 1, "rad", "a sigma"),
        "tilt_sigma_rad": Range(0, 0.1, "rad", "a sigma"),
        "prism_sigma": Range(0, 0.1, "", "a sigma"),
        "radial_sigma": Range(0, 1, "", "a sigma"),
        "drift_time_s": Range(0.1, 1e9, "s", "how long the turn takes to drift"),
        "distortion": Range(-1000, 1000, "", "OpenCV's terms k1 k2 p1 p2 k3"),
        "exposure_s": Range(1e-7, 1, "s", "longer than that a wing is a blur"),
        "row_time_s": Range(0, 2e-4, "s", "from row to row, not of the whole read-out; 0 for a global shutter"),
        "latency_s": Range(0, 1, "s", "from the trigger to the exposure", 1),
        "slope_gain": Range(-20, 20, "", "slope at the camera over that at the tip station"),
        "lift_gain": Range(-20, 20, "", "deflection at the camera over that at the tip station"),
        "focal_ratio": Range(0.1, 10, "", "1 for square pixels"),
        "stamp_sigma_s": Range(1e-9, 1, "s", "no clock is without error"),
    },
}
_SHORTEST_BASELINE_M = 0.01  # shorter ones are a slip of units (choice)
_MOST_RELATIVE_SIGMA = 5.0  # a belief so wide says nothing (choice)
_FLATTEST_RADPM = 0.001  # a cantilever of 50 m semispan has 0.03 (choice)
_LOWEST_CORNER_HZ = 0.001  # a random walk, for every flight (choice)
_BEYOND_TIP = 1.5  # of the semispan: cameras on booms ahead of or beyond the tip (choice)
_DISTORTION_TERMS = 5  # OpenCV's k1 k2 p1 p2 k3


def problems(airframe: Airframe) -> Iterator[str]:
    """Sentences about what cannot be, each with key, value and range."""
    yield from _ranges(airframe, "")
    for name in ("root", "left", "right"):
        yield from _sensor(getattr(airframe, name), name)
    for name in ("left_camera", "right_camera"):
        camera = getattr(airframe, name)
        if camera is not None:
            yield from _camera(camera, name)
    yield from _wing(airframe)
    yield from _sampling(airframe)
    yield from _sides(airframe)


def _ranges(record: Any, where: str) -> Iterator[str]:
    listed = RANGES.get(type(record).__name__, {})
    for entry in dataclasses.fields(record):
        value, key = getattr(record, entry.name), f"{where}.{entry.name}".lstrip(".")
        if entry.name in listed:
            yield from _outside(value, key, listed[entry.name])
        elif isinstance(value, tuple):
            for index, element in enumerate(value):
                if dataclasses.is_dataclass(element):
                    yield from _ranges(element, f"{key}[{index}]")
        elif dataclasses.is_dataclass(value) and not isinstance(value, Uncertain):
            yield from _ranges(value, key)


def _outside(value: Any, key: str, limits: Range) -> Iterator[str]:
    if isinstance(value, tuple):
        for index, element in enumerate(value):
            yield from _outside(element, f"{key}[{index}]", limits)
        return
    unit = f" {limits.unit}" if limits.unit else ""
    number, sigma = (value.value, value.sigma) if isinstance(value, Uncertain) else (value, 0.0)
    if not limits.minimum <= number <= limits.maximum:
        yield f"'{key}' = {number:g}{unit} is outside {limits.minimum:g} to {limits.maximum:g}{unit} ({limits.why})"
    if not 0.0 <= sigma <= limits.most_sigma and sigma:
        yield f"'{key}.sigma' = {sigma:g}{unit} is outside 0 to {limits.most_sigma:g}{unit}"


def _sensor(sensor: Sensor, where: str) -> Iterator[str]:
    letters = sensor.sends
    if not letters or set(letters) - set(AXIS_LETTERS) or len(set(letters)) < len(letters):
        yield f"'{where}.sends' = '{letters[:40]}' must be letters of '{AXIS_LETTERS}', each once and at least one"


def _camera(camera: Camera, where: str) -> Iterator[str]:
    if not _right_handed(camera.axes):
        yield (
            f"'{where}.axes' = {list(camera.axes)} must name x, y and z once, with signs that keep them right-handed "
            '(down ["y", "-x", "z"], forward ["y", "z", "x"])'
        )
    if len(camera.distortion) != _DISTORTION_TERMS:
        yield f"'{where}.distortion' has {len(camera.distortion)} terms, not {_DISTORTION_TERMS} (k1 k2 p1 p2 k3)"
    for axis, principal, side in zip("xy", camera.principal_px, (camera.width_px, camera.height_px), strict=True):
        if not -side <= principal <= 2 * side:
            yield f"'{where}.principal_px' {axis} = {principal:g} px is outside {-side} to {2 * side} px of this image"


def _right_handed(axes: tuple[str, str, str]) -> bool:
    """Whether three signed letters are a turn of the body's axes."""
    letters = [axis.lstrip("+-") for axis in axes]
    if sorted(letters) != ["x", "y", "z"] or any(len(axis) > 2 for axis in axes):
        return False
    order = ["xyz".index(letter) for letter in letters]
    even = order in ([0, 1, 2], [1, 2, 0], [2, 0, 1])
    return even == (sum(axis.startswith("-") for axis in axes) % 2 == 0)


def _wing(airframe: Airframe) -> Iterator[str]:
    wing = airframe.wing
    for name in ("trim_bend_m", "bend_per_g_m"):
        bend = getattr(wing, name)
        if abs(bend.value) > wing.semispan_m:
            yield f"'wing.{name}' = {bend.value:g} m is more than the semispan of {wing.semispan_m:g} m"
    if wing.shortening.value == 0.0 < wing.shortening.sigma:
        yield f"'wing.shortening' = 0 has a sigma of {wing.shortening.sigma:g}: it is relative to the value"
    for name, mode in wing.modes.items():
        for key in ("frequency_hz", "damping"):
            yield from _relative(getattr(mode, key), f"wing.{name}.{key}")
        slope = mode.slope_factor_radpm.value
        if abs(slope) < _FLATTEST_RADPM:
            text = f"nearer to 0 than {_FLATTEST_RADPM:g} rad/m: no bending turns its tip so little"
            yield f"'wing.{name}.slope_factor_radpm' = {slope:g} rad/m is {text}"
    for name in FAMILIES:
        if getattr(wing, f"further_{name}") and getattr(wing, f"second_{name}") is None:
            yield f"'wing.further_{name}' needs 'wing.second_{name}', the mode below"
    for index, corner_hz in enumerate(wing.gust.corners_hz):
        if 0.0 < corner_hz < _LOWEST_CORNER_HZ:
            text = f"below {_LOWEST_CORNER_HZ:g} Hz; 0 is white"
            yield f"'wing.gust.corners_hz[{index}]' = {corner_hz:g} Hz is {text}"
    yield from _relative(wing.gust.deflection_rms_m, "wing.gust.deflection_rms_m")


def _sampling(airframe: Airframe) -> Iterator[str]:
    """Sensors too slow for a first mode: two samples a period (Nyquist) are the least that tell its frequency."""
    firsts_hz = {name: getattr(airframe.wing, name).frequency_hz.value for name in FAMILIES}
    name = max(firsts_hz, key=firsts_hz.__getitem__)
    for where in ("root", "left", "right"):
        rate_hz = getattr(airframe, where).rate_hz
        if rate_hz < 2.0 * firsts_hz[name]:
            text = f"below two samples a period of the {name} mode of {firsts_hz[name]:g} Hz; ten are good"
            yield f"'{where}.rate_hz' = {rate_hz:g} Hz is {text}"


def _relative(belief: Uncertain, key: str) -> Iterator[str]:
    """Relative sigma of a quantity that is positive by nature."""
    if belief.sigma > _MOST_RELATIVE_SIGMA * belief.value > 0.0:
        most = _MOST_RELATIVE_SIGMA * belief.value
        yield f"'{key}.sigma' = {belief.sigma:g} is outside 0 to {most:g} ({_MOST_RELATIVE_SIGMA:g} times the value)"


def _sides(airframe: Airframe) -> Iterator[str]:
    left_m, right_m = airframe.left.position_m[1], airframe.right.position_m[1]
    if not left_m < 0.0 < right_m:
        yield (
            f"'left.position_m' y = {left_m:g} m must be below 0 and 'right.position_m' y = {right_m:g} m above "
            "(body y points right); are they swapped, or on one side?"
        )
    for name, y_m in (("left", left_m), ("right", right_m)):
        most_m = _BEYOND_TIP * airframe.wing.semispan_m
        if abs(y_m) > most_m:
            yield f"'{name}.position_m' y = {y_m:g} m is outside {-most_m:g} to {most_m:g} m (1.5 times the semispan)"
    left, right = airframe.left_camera, airframe.right_camera
    if (left is None) != (right is None):
        yield f"'{'right' if right is None else 'left'}_camera' is missing: give both cameras or none"
    elif left is not None and right is not None:
        baseline_m = right.position_m[1] - left.position_m[1]
        if baseline_m < _SHORTEST_BASELINE_M:
            yield (
                f"'right_camera.position_m' y less 'left_camera.position_m' y = {baseline_m:g} m is below "
                f"{_SHORTEST_BASELINE_M:g} m: the baseline; are the cameras swapped?"
            )

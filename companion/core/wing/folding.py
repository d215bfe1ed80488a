"""Named effects that are nothing but other airframe values, moved into these values.

An airframe file keeps what a diagnosis found as named effects, which the simulator takes as they are. Tracker, trigger
and ranging know the airframe alone: for them whatever can be said as an airframe value is said so. What cannot
(friction, a crooked sensor) stays in the list.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

from companion.core.wing.structure import SLOT_NAMES
from companion.params.airframe import Airframe, Camera, Gust, Mode, NamedEffect, Sensor, Uncertain, Wing

_SECOND_SLOPE = 3.4
Values = Mapping[str, float]


def folded(airframe: Airframe) -> Airframe:
    """The airframe with as many of its named effects as possible turned into values."""
    kept: list[NamedEffect] = []
    for effect in airframe.effects:
        fold = _FOLDS.get(effect.name)
        changed = fold(airframe, effect.parameters) if fold else None
        if changed is None:
            kept.append(effect)
        else:
            airframe = changed
    return dataclasses.replace(airframe, effects=tuple(kept))


def _frequency(airframe: Airframe, values: Values) -> Airframe:
    return _each_mode(airframe, "frequency_hz", 1.0 + values.get("ratio", 0.0))


def _damping(airframe: Airframe, values: Values) -> Airframe:
    return _each_mode(airframe, "damping", 1.0 + values.get("ratio", 0.0))


def _each_mode(airframe: Airframe, key: str, factor: float) -> Airframe:
    changes: dict[str, Any] = {}
    for name in SLOT_NAMES:
        mode: Mode | None = getattr(airframe.wing, name)
        if mode is not None:
            changes[name] = dataclasses.replace(mode, **{key: _times(getattr(mode, key), factor)})
    return _with_wing(airframe, dataclasses.replace(airframe.wing, **changes))


def _bend(airframe: Airframe, values: Values) -> Airframe:
    per_g = _times(airframe.wing.bend_per_g_m, 1.0 + values.get("ratio", 0.0))
    return _with_wing(airframe, dataclasses.replace(airframe.wing, bend_per_g_m=per_g))


def _second(airframe: Airframe, values: Values) -> Airframe | None:
    wing = airframe.wing
    if wing.second_symmetric is not None or "frequency_hz" not in values:
        return None
    slope = _times(wing.symmetric.slope_factor_radpm, _SECOND_SLOPE)
    mode = Mode(Uncertain(values["frequency_hz"]), Uncertain(values.get("damping", 0.02)), slope)
    return _with_wing(airframe, dataclasses.replace(wing, second_symmetric=mode))


def _gust(airframe: Airframe, values: Values) -> Airframe | None:
    first, second = airframe.wing.gust.corners_hz
    lag2 = values.get("lag2_s2", 0.0)
    if lag2 <= 0.0 or (first and second):
        return None
    corner = 1.0 / (2.0 * math.pi * math.sqrt(lag2))
    gust: Gust = dataclasses.replace(airframe.wing.gust, corners_hz=(first, corner) if first else (corner, second))
    return _with_wing(airframe, dataclasses.replace(airframe.wing, gust=gust))


def _toe(airframe: Airframe, values: Values) -> Airframe:
    def turned(camera: Camera, sign: float) -> Camera:
        x, y, z = camera.rotation_rad
        return dataclasses.replace(camera, rotation_rad=(x, y + 0.5 * sign * values.get("toe_rad", 0.0), z))

    return _each_camera(airframe, turned)


def _baseline(airframe: Airframe, values: Values) -> Airframe:
    def moved(camera: Camera, sign: float) -> Camera:
        x, y, z = camera.position_m
        return dataclasses.replace(camera, position_m=(x, y + 0.5 * sign * values.get("error_m", 0.0), z))

    return _each_camera(airframe, moved)


def _focal(airframe: Airframe, values: Values) -> Airframe:
    factor = 1.0 + values.get("ratio", 0.0)
    return _each_camera(
        airframe, lambda camera, _sign: dataclasses.replace(camera, focal_px=_times(camera.focal_px, factor))
    )


def _asymmetry(airframe: Airframe, values: Values) -> Airframe:
    ratio = values.get("ratio", 0.0)
    return _each_camera(
        airframe, lambda camera, sign: dataclasses.replace(camera, slope_gain=camera.slope_gain * (1.0 + sign * ratio))
    )


def _delay(airframe: Airframe, values: Values) -> Airframe:
    """A late stream's stamps show an earlier instant."""
    late_s = values.get("delay_s", 0.0)
    if late_s >= 0.0:
        return dataclasses.replace(airframe, right=_earlier(airframe.right, late_s))
    return dataclasses.replace(airframe, left=_earlier(airframe.left, -late_s))


def _earlier(sensor: Sensor, late_s: float) -> Sensor:
    source = dataclasses.replace(sensor.source, stamp_offset_s=sensor.source.stamp_offset_s - late_s)
    return dataclasses.replace(sensor, source=source)


def _each_camera(airframe: Airframe, change: Callable[[Camera, float], Camera]) -> Airframe:
    left, right = airframe.left_camera, airframe.right_camera
    return dataclasses.replace(
        airframe, left_camera=left and change(left, -1.0), right_camera=right and change(right, 1.0)
    )


def _with_wing(airframe: Airframe, wing: Wing) -> Airframe:
    return dataclasses.replace(airframe, wing=wing)


def _times(value: Uncertain, factor: float) -> Uncertain:
    return Uncertain(value.value * factor, value.sigma * abs(factor))


_FOLDS: Mapping[str, Callable[[Airframe, Values], Airframe | None]] = {
    "frequency-shift": _frequency,
    "damping-shift": _damping,
    "load-dependent-bend": _bend,
    "second-mode": _second,
    "coloured-gust": _gust,
    "convergence-offset": _toe,
    "baseline-error": _baseline,
    "focal-error": _focal,
    "camera-asymmetry": _asymmetry,
    "stream-delay": _delay,
}

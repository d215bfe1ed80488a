"""Airframe values changed by an effect that is nothing but other airframe values."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from companion.params.airframe import Airframe, Camera, Mode, Uncertain


def scaled(value: Uncertain, factor: float) -> Uncertain:
    """Value and sigma times a factor."""
    return Uncertain(value.value * factor, value.sigma * abs(factor))


def with_wing(airframe: Airframe, **changes: Any) -> Airframe:
    """The airframe with other values of its wing."""
    return dataclasses.replace(airframe, wing=dataclasses.replace(airframe.wing, **changes))


def scale_modes(airframe: Airframe, key: str, factor: float) -> Airframe:
    """Scale one value (``frequency_hz``, ``damping``) of every mode."""

    def change(_: str, mode: Mode) -> Mode:
        return dataclasses.replace(mode, **{key: scaled(getattr(mode, key), factor)})

    return dataclasses.replace(airframe, wing=airframe.wing.with_modes(change))


def change_cameras(airframe: Airframe, change: Callable[[Camera, float], Camera]) -> Airframe:
    """Change each camera that there is; ``change`` is given the camera and -1 for the left one, 1 for the right."""
    left_camera, right_camera = airframe.left_camera, airframe.right_camera
    return dataclasses.replace(
        airframe,
        left_camera=left_camera and change(left_camera, -1.0),
        right_camera=right_camera and change(right_camera, 1.0),
    )

"""Airframe extended by a diagnosis: named effects, and the values that the fit gave the rest."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

from companion.diagnosis.flights.outcome import FlightDiagnosis
from companion.diagnosis.model.belief import Belief
from companion.params.airframe import Airframe, Camera, Mode, NamedEffect, Uncertain, Wing

_MODE_KEYS = {"frequency": "frequency_hz", "damping": "damping", "slope": "slope_factor_radpm"}


def extended(
    airframe: Airframe,
    belief: Belief,
    diagnosis: FlightDiagnosis,
    units: Mapping[str, tuple[float, float]] = MappingProxyType({}),
) -> Airframe:
    """The airframe with the named effects in force, and modes, bend and cameras as the same fit has them.

    Values and effects belong together: a frequency fitted beside a slipping spring is another one than without it.
    Effects whose values are those of this recording alone are left out.
    ``units`` are the mean and rms of each recorded channel.
    """
    named = [
        NamedEffect(
            cause.term.effect.name,
            dict(zip([entry.name for entry in cause.term.effect.parameters()], cause.values, strict=True)),
            cause.term.channel,
            *units.get(cause.term.channel, (0.0, 0.0)),
        )
        for cause in diagnosis.causes
        if not cause.term.effect.belongs_to_recording()
    ]
    deviation = belief.named(diagnosis.final.values[: len(belief.nuisances)])
    spread = {entry.key: math.sqrt(float(diagnosis.final.covariance[i, i])) for i, entry in enumerate(belief.nuisances)}
    return dataclasses.replace(
        airframe,
        wing=_wing(belief.wing(deviation), spread),
        left_camera=_camera(airframe.left_camera, -1.0, deviation, spread),
        right_camera=_camera(airframe.right_camera, 1.0, deviation, spread),
        effects=(*airframe.effects, *named),
    )


def _wing(wing: Wing, spread: dict[str, float]) -> Wing:
    """Posterior sigmas beside the posterior values; those of modes are relative."""

    def with_sigmas(name: str, mode: Mode) -> Mode:
        fitted = {
            field: Uncertain(getattr(mode, field).value, getattr(mode, field).value * spread[f"{name}.{key}"])
            for key, field in _MODE_KEYS.items()
            if f"{name}.{key}" in spread
        }
        return dataclasses.replace(mode, **fitted)

    changes: dict[str, Any] = {}
    for field in ("trim_bend_m", "bend_per_g_m"):
        if field in spread:
            changes[field] = Uncertain(getattr(wing, field).value, spread[field])
    return dataclasses.replace(wing.with_modes(with_sigmas), **changes)


def _camera(camera: Camera | None, sign: float, deviation: dict[str, float], spread: dict[str, float]) -> Camera | None:
    """Turned by half of the toe; its rotation's sigma stays, for it is that of all axes and the toe is one of them."""
    if camera is None or "toe_rad" not in spread:
        return camera
    x, y, z = camera.rotation_rad
    focal_px = camera.focal_px.value
    return dataclasses.replace(
        camera,
        rotation_rad=(x, y + 0.5 * sign * deviation["toe_rad"], z),
        focal_px=Uncertain(
            focal_px * (1.0 + deviation.get("focal", 0.0)), focal_px * spread.get("focal", 0.0) * math.sqrt(2.0)
        ),
    )

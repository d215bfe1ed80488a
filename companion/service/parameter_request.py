"""The wish of a live page that a parameter be set: the inertial process checks it as it does a ground station's."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ParameterRequest:
    """Parameter by MAVLink name, and the value asked for."""

    name: str
    value: float

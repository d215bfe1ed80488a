"""Constants and MAVLink numbers that every room shares; imports nothing of ours."""

from __future__ import annotations

import enum

GRAVITY_MPS2 = 9.80665
"""Standard acceleration of gravity, a convention (3rd CGPM, 1901): what ``g`` means in every unit and log."""
MAD_TO_SIGMA = 1.4826
"""Sigma of a normal law per median absolute deviation (derived: one over its 75 % quantile)."""


class Orientation(enum.IntEnum):
    """Directions of a range, as MAVLink's MAV_SENSOR_ORIENTATION numbers them (common.xml)."""

    FORWARD = 0
    DOWN = 25


class Severity(enum.IntEnum):
    """MAV_SEVERITY (MAVLink common.xml, RFC 5424): the three of its eight levels that notices use."""

    ERROR = 3
    WARNING = 4
    INFO = 6

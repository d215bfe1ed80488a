"""Units of CSV columns, with their factors and offsets to SI."""

from __future__ import annotations

import math

from companion.units import GRAVITY_MPS2

ACCELERATION = {"mps2": 1.0, "g": GRAVITY_MPS2, "mg": GRAVITY_MPS2 / 1000.0}
ANGULAR_RATE = {"radps": 1.0, "degps": math.radians(1.0), "mradps": 0.001}
_FORCE = {"n": 1.0, "mn": 0.001, "kn": 1000.0}

_OTHERS = "s ms us m mm cm km mps kmh kt rad mrad deg hz rpm nm pa hpa kpa kg w v mv a px k degc".split()  # noqa: SIM905
_UNITS = frozenset((*_OTHERS, "ratio", "percent", "strain", "ustrain", "count", *ACCELERATION, *ANGULAR_RATE, *_FORCE))
_PLAIN_NUMBERS = frozenset({"throttle", "load_factor", "mach"})
_LENGTH = {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "in": 0.0254, "ft": 0.3048}
_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_VOLTAGE = {"v": 1.0, "mv": 1e-3}
_ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": math.radians(1.0)}
_STRAIN = {"strain": 1.0, "ustrain": 1e-6}
_SPEED = {"mps": 1.0, "kmh": 1.0 / 3.6, "kt": 1852.0 / 3600.0}
_PRINTED = (("km/h", "kmh"), ("²", "2"), ("^", ""), ("/", "p"), ("µ", "u"), ("μ", "u"), ("°", "deg"))
_DIMENSIONS = (
    {**ACCELERATION, "ftps2": 0.3048}, ANGULAR_RATE, {**_FORCE, "lbf": 4.4482216152605}, _LENGTH, _TIME, _VOLTAGE,
    _ANGLE, _STRAIN, _SPEED,
)  # fmt: skip


def has_unit(column: str) -> bool:
    """Whether a covariate's name ends in a unit (``rpm`` alone is one), or is known to be a plain number."""
    return column in _PLAIN_NUMBERS or column.rpartition("_")[2] in _UNITS


def input_in_si(column: str) -> tuple[str, float]:
    """Name in SI and factor of a measured input: ``input_g`` gives ``("input_mps2", 9.80665)``; others stay."""
    stem, _, unit = column.rpartition("_")
    for name, factors in (("mps2", ACCELERATION), ("n", _FORCE)):
        if unit in factors:
            return f"{stem}_{name}", factors[unit]
    return column, 1.0


def unit_of(channel: str) -> str:
    """The unit at the end of a channel's name, "" where there is none that is known."""
    if channel in _PLAIN_NUMBERS:
        return ""
    unit = channel.rpartition("_")[2].lower()
    return unit if unit in _UNITS or any(unit in units for units in _DIMENSIONS) else ""


def conversion(unit: str, wanted: str) -> float | None:
    """Factor from ``unit`` to ``wanted``; None where they are of different dimensions.

    A unit is written as in the names of columns or as in print (mps2 or m/s^2); upper and lower case are the same.
    """
    unit, wanted = _as_in_columns(unit), wanted.lower()
    if unit == wanted:
        return 1.0
    for units in _DIMENSIONS:
        if unit in units and wanted in units:
            return units[unit] / units[wanted]
    return None


def _as_in_columns(unit: str) -> str:
    """A unit as the names of columns have it: m/s^2 is mps2."""
    unit = unit.strip().lower()
    for printed, written in _PRINTED:
        unit = unit.replace(printed, written)
    return unit

"""Units of CSV columns: which are known, and what makes SI of them."""

from __future__ import annotations

import math

STANDARD_GRAVITY_MPS2 = 9.80665

ACCELERATION = {"mps2": 1.0, "g": STANDARD_GRAVITY_MPS2, "mg": STANDARD_GRAVITY_MPS2 / 1000.0}
ANGULAR_RATE = {"radps": 1.0, "degps": math.radians(1.0), "mradps": 0.001}
_FORCE = {"n": 1.0, "mn": 0.001, "kn": 1000.0}

_OTHERS = "s ms us m mm cm km mps kmh kt rad mrad deg hz rpm nm pa hpa kpa kg w v mv a px k degc".split()  # noqa: SIM905
_KNOWN = frozenset((*_OTHERS, "ratio", "percent", "strain", "ustrain", "count", *ACCELERATION, *ANGULAR_RATE, *_FORCE))
_PLAIN_NUMBERS = frozenset({"throttle", "load_factor", "mach"})


def has_known_unit(column: str) -> bool:
    """Whether a covariate's name ends in a unit (``rpm`` alone is one), or is known to be a plain number."""
    return column in _PLAIN_NUMBERS or column.rpartition("_")[2] in _KNOWN


def input_in_si(column: str) -> tuple[str, float]:
    """Name in SI and factor of a measured input: ``input_g`` gives ``("input_mps2", 9.80665)``; others stay."""
    stem, _, unit = column.rpartition("_")
    for name, factors in (("mps2", ACCELERATION), ("n", _FORCE)):
        if unit in factors:
            return f"{stem}_{name}", factors[unit]
    return column, 1.0

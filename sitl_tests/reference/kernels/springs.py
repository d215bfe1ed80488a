"""A spring that slips along a path, in plain Python: ``native/springs.c``."""

from __future__ import annotations

import numpy as np

from companion.records import Floats


def stretch_along(deflection_m: Floats, reach_m: float) -> Floats:
    """Stretch (h, m) of springs that slip beyond ``reach_m``, along paths (h, m) from rest at 0."""
    return np.stack([_followed(row.tolist(), reach_m) for row in deflection_m])


def _followed(deflection_m: list[float], reach_m: float) -> list[float]:
    held, before, path = 0.0, 0.0, []
    for w in deflection_m:
        held += w - before
        held = reach_m if held > reach_m else -reach_m if held < -reach_m else held
        before = w
        path.append(held)
    return path

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


def derivatives_along(deflection_m: Floats, reaches_m: Floats, weight: Floats) -> Floats:
    """Mean derivative of the mean stretch of springs (k,) by the deflection at each lag before, (h, m)."""
    lags = np.zeros(deflection_m.shape)
    for row, path_m in zip(lags, deflection_m, strict=True):
        for reach_m in reaches_m:
            for at, derivative in enumerate(_derivatives(path_m, float(reach_m))):
                row[: at + 1] += weight[at] * derivative[: at + 1][::-1]
    return lags / (np.sum(weight) * len(reaches_m))


def _derivatives(path_m: Floats, reach_m: float) -> Floats:
    """Derivative of the stretch at each instant by the deflection at each, (m, m)."""
    derivatives, held, before = np.zeros((len(path_m), len(path_m))), 0.0, 0.0
    now = np.zeros(len(path_m))
    for at, w in enumerate(path_m.tolist()):
        free = held + w - before
        held = min(max(free, -reach_m), reach_m)
        slipped = 0.0 if free == held else min(abs(free - held) / abs(w - before), 1.0)
        now[at] += 1.0
        if at:
            now[at - 1] -= 1.0
        now *= 1.0 - slipped
        derivatives[at], before = now, w
    return derivatives

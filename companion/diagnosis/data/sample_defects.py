"""Defects that show in the samples themselves, before any model: a range too small, steps too coarse, wandering stamps.

Such causes are certain where they are seen; nothing is fitted to them. What can be mended is mended (clipped peaks are
interpolated), the rest is reported. Each effect finds itself (:meth:`Effect.sample_defect`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from companion.core.wing.effects import catalogue
from companion.core.wing.samples import SampleDefect
from companion.params.airframe import Sensor
from companion.records import Floats


def find_sample_defects(t_s: Floats, force_z_mps2: Floats, sensor: Sensor) -> list[SampleDefect]:
    """Every effect that one stream's stamps and values, both (m,), show."""
    defects = [kind.sample_defect(t_s, force_z_mps2, sensor) for kind in catalogue().values() if kind.in_samples]
    return [entry for entry in defects if entry is not None]


def worst_defects(defects: Sequence[SampleDefect]) -> tuple[SampleDefect, ...]:
    """The most certain defect of each name, whichever side shows it, the most certain first."""
    names = sorted({entry.name for entry in defects})
    best = [max((e for e in defects if e.name == name), key=lambda e: e.log_bayes_factor) for name in names]
    return tuple(sorted(best, key=lambda entry: -entry.log_bayes_factor))


def clipped_sides(values: Floats, defects: Sequence[SampleDefect]) -> Floats:
    """1 where a sample was clipped from above (the truth is at least what it shows), -1 from below, else 0, (n,)."""
    sides = np.zeros(len(values))
    for defect in defects:
        clipped = catalogue()[defect.name].clipped(values)
        sides = np.where(clipped != 0.0, clipped, sides)
    return sides


def interpolate_clipped(t_s: Floats, values: Floats, defects: Sequence[SampleDefect]) -> Floats:
    """The values (n,) with a spline through the others where they were clipped, never inside the range."""
    sides = clipped_sides(values, defects)
    cut = sides != 0.0
    if not cut.any() or cut.all():
        return values
    spline = CubicSpline(t_s[~cut], values[~cut])(t_s)
    mended = np.where(sides > 0.0, np.maximum(spline, values), np.where(cut, np.minimum(spline, values), values))
    return np.asarray(mended)

"""What shows in the samples themselves, before any model: a range too small, steps too coarse, stamps that wander.

Such causes are certain where they are seen; nothing is fitted to them. What can be mended is mended (cut peaks are
bridged), the rest is told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from companion.params.airframe import Sensor
from companion.records import Floats

SEEN_IN_SAMPLES = frozenset({"saturation", "quantisation", "dropout-jitter"})
_FEWEST = 8
_PILE = 4.0
_COARSE = 0.25  # of the believed noise's variance: 1 dB
_OFF_LATTICE = 0.1
_LOST = 0.005
_LONGEST_LOSS = 10.0
_WANDERING = 0.15  # of a period
_CERTAIN = 1000.0


@dataclass(frozen=True, slots=True)
class SampleDefect:
    """One cause seen in samples: the effect's name and values, what was seen, and how certain that is."""

    name: str
    values: dict[str, float]
    sigmas: dict[str, float]
    evidence: str
    log_bayes_factor: float


def find_sample_defects(t_s: Floats, force_z_mps2: Floats, sensor: Sensor) -> list[SampleDefect]:
    """Look at one stream's stamps and values."""
    defects = [find_saturation(force_z_mps2), coarse(t_s, force_z_mps2, sensor), find_timing_defect(t_s)]
    return [entry for entry in defects if entry is not None]


def worst_defects(defects: Sequence[SampleDefect]) -> tuple[SampleDefect, ...]:
    """Of each name the most certain; what was seen on either side is told."""
    names = sorted({entry.name for entry in defects})
    best = [max((e for e in defects if e.name == name), key=lambda e: e.log_bayes_factor) for name in names]
    return tuple(sorted(best, key=lambda entry: -entry.log_bayes_factor))


def find_saturation(values: Floats) -> SampleDefect | None:
    """Samples that pile up at the largest or smallest value, more than the values next to it."""
    piles = [(sign, pile) for sign in (1.0, -1.0) if (pile := _pile(sign * values)) is not None]
    if not piles:
        return None
    sign, (top, piled, expected, width) = max(piles, key=lambda entry: abs(entry[1][0]))
    factor = piled * math.log(piled / expected) - (piled - expected)
    text = f"{piled} samples of {len(values)} at exactly {sign * top:.3f} m/s^2"
    inverse = {"inverse_s2pm": 1.0 / abs(top)}
    return SampleDefect("saturation", inverse, {"inverse_s2pm": width / top**2}, text, factor)


def _pile(values: Floats) -> tuple[float, int, float, float] | None:
    """The largest value, how many samples are at it, how many a smooth tail would have there, and within what width."""
    top, spread = float(values.max()), 0.02 * float(values.std())
    width = max(_step(values), 1e-6 * max(abs(top), 1.0))
    piled = int(np.sum(values > top - 0.5 * width))
    beside = int(np.sum((values > top - 1.5 * width) & (values <= top - 0.5 * width)))
    # a finer look needs more neighbours
    near = float(np.sum(values > top - spread)) - piled
    expected = max(beside, near * min(width / max(spread, 1e-300), 1.0), 1.0)
    return (top, piled, expected, width) if piled >= max(_FEWEST, _PILE * expected) else None


def coarse(t_s: Floats, values: Floats, sensor: Sensor) -> SampleDefect | None:
    """Values on a lattice whose step adds noise that counts beside what the sensor is believed to have."""
    step = _step(values)
    rate_hz = 1.0 / float(np.median(np.diff(t_s)))
    noise = sensor.accel_noise_mps2_rthz**2 * 0.5 * rate_hz
    if step <= 0.0 or step**2 / 12.0 < _COARSE * noise:
        return None
    text = f"all values are multiples of {step:.4g} m/s^2: noise of {step / math.sqrt(12.0):.3g} m/s^2"
    return SampleDefect("quantisation", {"step_mps2": step}, {"step_mps2": 1e-3 * step}, text, _CERTAIN)


def find_timing_defect(t_s: Floats) -> SampleDefect | None:
    """Stamps that are missing, or wander about a steady rate."""
    steps = np.diff(t_s)
    period = float(np.median(steps))
    periods = np.maximum(np.round(steps / period), 1.0)
    single = periods <= _LONGEST_LOSS  # longer ones are gaps, which are told elsewhere
    lost = float(np.sum(periods[single] - 1.0) / np.sum(periods[single]))
    index = np.concatenate([[0.0], np.cumsum(periods)])
    line = np.polynomial.Polynomial.fit(index, t_s, 1)
    jitter = float(np.std(t_s - line(index)))
    wanders = float(np.std(np.where(periods > 1, 0.0, steps - period))) / math.sqrt(2.0)
    if lost < _LOST and wanders < _WANDERING * period:
        return None
    jitter = min(jitter, wanders)
    text = f"{100 * lost:.1f} % of samples missing, stamps wander {1e3 * jitter:.2f} ms about {1e3 * period:.2f} ms"
    count = len(steps)
    sigmas = {"jitter_s": jitter / math.sqrt(2.0 * count), "lost": math.sqrt(max(lost, 1.0 / count) / count)}
    return SampleDefect("dropout-jitter", {"jitter_s": jitter, "lost": lost}, sigmas, text, _CERTAIN)


def clipped_sides(values: Floats, findings: Sequence[SampleDefect]) -> Floats:
    """1 where a sample was cut from above (the truth is at least what it shows), -1 where from below, else 0, (n,)."""
    sides = np.zeros(len(values))
    if any(finding.name == "saturation" for finding in findings):
        # a range may be cut on one side only, and need not lie evenly about 0
        if _pile(-values):
            sides[values < values.min() + 1e-6 * abs(values.min())] = -1.0
        if _pile(values):
            sides[values > values.max() - 1e-6 * abs(values.max())] = 1.0
    return sides


def interpolate_clipped(t_s: Floats, values: Floats, findings: Sequence[SampleDefect]) -> Floats:
    """Where samples were cut, a spline through the others, never inside the range."""
    sides = clipped_sides(values, findings)
    cut = sides != 0.0
    if not cut.any() or cut.all():
        return values
    spline = CubicSpline(t_s[~cut], values[~cut])(t_s)
    mended = np.where(sides > 0.0, np.maximum(spline, values), np.where(cut, np.minimum(spline, values), values))
    return np.asarray(mended)


def _step(values: Floats) -> float:
    """The lattice that all values lie on, or 0."""
    distinct = np.unique(values)
    if len(distinct) < 2:
        return 0.0
    apart = np.diff(distinct)
    step = float(np.median(apart[apart < 1.5 * apart.min()]))
    span = float(distinct[-1] - distinct[0])
    step = span / max(round(span / step), 1)
    places = (distinct - distinct[0]) / step
    on_it = np.abs(places - np.round(places)) < _OFF_LATTICE
    return step if bool(np.mean(on_it) > 0.99) and len(distinct) < 0.5 * len(values) else 0.0

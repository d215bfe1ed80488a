"""Defects that recorded samples show by themselves, before any model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.records import Floats

CERTAIN = 1000.0
"""Log Bayes factor of a defect that leaves no doubt (a lattice, missing stamps; choice)."""
_OFF_LATTICE = 0.1  # of a step: a value further from the lattice does not lie on it (choice)
_EVEN, _MOST_OF = 0.25, 0.9  # chosen: how near to whole steps, and how many of them, make a stream an even one


@dataclass(frozen=True, slots=True)
class SampleDefect:
    """One effect seen in samples: its name and values with sigmas, the evidence in words, and how certain that is."""

    name: str
    values: dict[str, float]
    sigmas: dict[str, float]
    evidence: str
    log_bayes_factor: float


def lattice_step(values: Floats) -> float:
    """Step of the lattice that all values (m,) lie on, in their unit; 0 where there is none."""
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


def evenly_stamped(t_s: Floats) -> bool:
    """Whether increasing stamps (m,) are whole numbers of one step apart."""
    steps = np.diff(t_s)
    if not len(steps):
        return False
    periods = steps / np.median(steps)
    return bool(np.quantile(np.abs(periods - np.round(periods)), _MOST_OF) < _EVEN)


def smoothed_stamps(stamped_s: Floats, width: int) -> Floats:
    """Mean of ``width`` stamps about each row, (n,); at the ends of fewer, about the line through all."""
    count = len(stamped_s)
    at = np.arange(count, dtype=np.float64)
    if count < 3:
        return np.sort(stamped_s)
    slope, start = np.polyfit(at, stamped_s, 1)
    total = np.concatenate([[0.0], np.cumsum(stamped_s - (start + slope * at))])
    rows, half = np.arange(count), min(width // 2, count - 1)
    low, high = np.maximum(rows - half, 0), np.minimum(rows + half + 1, count)
    return np.asarray(start + slope * at + (total[high] - total[low]) / (high - low))

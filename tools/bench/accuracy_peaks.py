"""Peaks of the true deflection, and how far a predicted curve misses them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.records import Floats
from tools.reference.truth import TruthRun

LEAD_S = 0.020
_GRID_S = 0.004
_MOST = 120  # peaks of one mode in one run


@dataclass(frozen=True, slots=True)
class Issue:
    """A forecast to be made: at ``t_s``, ``count`` milliseconds long, for a peak of ``mode`` at ``peak_s``."""

    mode: int
    t_s: float
    count: int
    peak_s: float
    sign: float
    quarter_s: float


def issues_of(run: TruthRun, seed_index: int, start_s: float) -> list[Issue]:
    """Forecasts for the peaks above one rms, at the last instant of the 4 ms grid that leaves the lead."""
    issues: list[Issue] = []
    for mode in (0, 1):
        quarter = 0.25 / run.spec.modes[mode].frequency_hz
        peaks = [p for p in run.peaks(seed_index, mode, start_s) if p[0] + quarter < run.spec.duration_s - 0.1]
        every = max(1, len(peaks) // _MOST)
        for peak_s, height in peaks[::every]:
            at = np.floor((peak_s - LEAD_S) / _GRID_S + 1e-6) * _GRID_S
            count = int(np.ceil((peak_s - at + quarter) / 0.001)) + 1
            issues.append(Issue(mode, float(at), count, peak_s, float(np.sign(height)), quarter))
    return issues


def miss_s(issue: Issue, curve: Floats) -> float:
    """Time of the extremum of a predicted curve (1 ms steps from ``t_s`` + 1 ms) less that of the true peak.

    The extremum is looked for within a quarter of a period; a curve without one misses by as much.
    """
    times = issue.t_s + 0.001 * np.arange(1, len(curve) + 1)
    near = np.flatnonzero(np.abs(times - issue.peak_s) <= issue.quarter_s)
    top = int(near[np.argmax(issue.sign * curve[near])])
    if not 0 < top < len(curve) - 1:
        return float(times[top] - issue.peak_s)
    left, middle, right = curve[top - 1 : top + 2]
    bend = left - 2 * middle + right
    shift = float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend else 0.0
    return float(times[top] + 0.001 * shift - issue.peak_s)

"""Times of samples whose stamps repeat, go back, wander or are coarse: no recording is refused for its stamps.

Equal rows are one sample. Rows that arrived in another order have even stamps once they are sorted. Where stamps wander
by a step or more, or several samples share one, the order of the rows tells more than the stamps: a sample's time is
the mean of the stamps about it. Where they begin anew (a logger that restarted), the longest run counts.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from companion.core.wing.samples import evenly_stamped, smoothed_stamps
from companion.records import Bools, Floats, Ints

_FEW = 0.005  # share of steps that go back or repeat, below which sorting is enough (choice)
_FAR_S, _FAR = 0.05, 10.0  # s, usual steps: a step back beyond both is no wandering stamp (choice)
_MEAN_OF = 65  # chosen: stamps of the running mean: enough to average jitter, too few for a clock to drift
_COARSE = 8  # chosen: width of the running mean over the number of stamps that share a value, at least
_HOLE = 10.0  # usual steps: no mean is taken across a longer one (choice)
_ANEW_S, _ANEW = 2.0, 10  # s, rows: a jump back so far for so many rows is a new beginning of time (choice)


@dataclass(frozen=True, slots=True)
class Ordered:
    """Samples in order of time.

    Attributes
    ----------
    t_s : (k,)
        Increasing.
    rows : (k,)
        Where each stands in the recording.
    note : str
        What was done, "" for nothing.
    """

    t_s: Floats
    rows: Ints
    note: str


def in_order(stamped_s: Floats, values: Floats) -> Ordered:
    """Find the times of samples, (n,), from stamps in the order of recording; ``values`` (n,) tell equal rows."""
    bad = int(np.sum(np.diff(stamped_s) <= 0.0))
    if not bad:
        return Ordered(stamped_s, np.arange(len(stamped_s)), "")
    remarks = [f"{bad} of {len(stamped_s)} stamps repeat the one before or go back"]
    run = longest_run(stamped_s)
    if len(run) < len(stamped_s):
        remarks.append(f"time begins anew; the longest run, {len(run)} rows, is judged")
    rows = run[_first_of_equals(stamped_s[run], values[run])]
    if len(rows) < len(run):
        remarks.append(f"{len(run) - len(rows)} rows are there twice and count once")
    if np.all(np.diff(stamped_s[rows]) > 0.0):
        return Ordered(stamped_s[rows], rows, "; ".join(remarks))
    if _only_out_of_order(stamped_s[rows]):
        t_s, first = np.unique(stamped_s[rows], return_index=True)
        return Ordered(t_s, rows[first], "; ".join([*remarks, "rows were put in the order of their stamps"]))
    usual_s = float(np.ptp(stamped_s[rows])) / (len(rows) - 1)
    if float(-np.diff(stamped_s[rows]).min()) > max(_FAR_S, _FAR * usual_s):
        rows = rows[np.argsort(stamped_s[rows], kind="stable")]
    remarks.append("each sample's time is the mean of the stamps about it")
    return Ordered(_smoothed(stamped_s[rows], usual_s), rows, "; ".join(remarks))


def longest_run(stamped_s: Floats) -> Ints:
    """Rows (k,) of the longest run of stamps (m,) in which time does not begin anew."""
    count = len(stamped_s)
    behind = np.maximum.accumulate(stamped_s) - stamped_s > _ANEW_S
    starts = [0]
    for row in np.flatnonzero((np.diff(stamped_s) < -_ANEW_S) & behind[1:]) + 1:
        if np.all(stamped_s[row : row + _ANEW] < stamped_s[starts[-1] : row].max() - _ANEW_S):
            starts.append(int(row))
    begun, ended = max(itertools.pairwise([*starts, count]), key=lambda ends: ends[1] - ends[0])
    return np.arange(begun, ended)


def by_stamp(stamped_s: Floats) -> Ints:
    """Rows (k,) of the longest run in the order of their stamps (m,)."""
    run = longest_run(stamped_s)
    return run[np.argsort(stamped_s[run], kind="stable")]


def _first_of_equals(stamped_s: Floats, values: Floats) -> Bools:
    """Which rows do not repeat an earlier one, stamp and value."""
    _, first = np.unique(np.stack([stamped_s, values], axis=1), axis=0, return_index=True)
    is_first = np.zeros(len(stamped_s), dtype=np.bool_)
    is_first[first] = True
    return is_first


def _only_out_of_order(stamped_s: Floats) -> bool:
    """Whether sorting makes the stamps right: hardly any was wrong, or all are even then."""
    if float(np.mean(np.diff(stamped_s) <= 0.0)) < _FEW:
        return True
    steps = np.diff(np.sort(stamped_s))
    return bool(np.mean(steps == 0.0) < _FEW) and evenly_stamped(np.unique(stamped_s))


def _smoothed(stamped_s: Floats, usual_s: float) -> Floats:
    """Running means, between holes; increasing."""
    ahead = np.maximum.accumulate(stamped_s)
    holes = np.flatnonzero(np.diff(ahead) > max(_FAR_S, _HOLE * usual_s)) + 1
    shared = int(np.unique(stamped_s, return_counts=True)[1].max())
    width = max(_MEAN_OF, 2 * (_COARSE * shared // 2) + 1)
    t_s = np.concatenate([smoothed_stamps(piece, width) for piece in np.split(stamped_s, holes)])
    # a mean of few stamps may still go back by a hair: the next sample is at least a hundredth of a step later
    index = 0.01 * usual_s * np.arange(len(t_s))
    return np.asarray(np.maximum.accumulate(t_s - index) + index)

"""Clipped samples of a sensor that vibrates beyond its range: moved outward by what they exceed it on average."""

from __future__ import annotations

import math

import numpy as np

from companion.core.tracking.found_range import FoundRange
from companion.records import Bools, Floats

_SATURATION_MARGIN = 0.002  # chosen: a value within this of the range was clipped
# chosen, of the last half minute: the third within seconds is held; a fault of the electronics comes seldomer
_FEWEST_RUNS = 2.5
_RUNS_MEMORY_S = 30.0  # chosen: a vibration that rarely reaches the limit is one still
_NO_RUN = 0.01  # chosen: two minutes behind the last
_MEMORY_S = 4.0  # chosen: the share of a vibration that swells and fades within a second would add its own noise
# measured (world bench, rough): toe errors square to 1.0 to 1.4 sigmas where 17 % are clipped, frequencies are off by
# ten sigmas where 32 % are
MOST_SHARE = 0.2
"""Clipped samples of an axis, as a share of all, above which nothing rests on the rest."""
_OFTEN = 0.005  # derived: what so many leave is noise of 1e5 times a quiet sensor's density (noise_search.next_leap)
_CLEAR = 0.1  # chosen: difference over sum of what is clipped below and above, from which it tells a mean
_BY_CHANCE = 2.0  # derived: sigmas of that difference over sum by the number of runs, each above or below by chance
_MOST_EXCESS = 0.5  # chosen, of the range: a Gaussian of which a fifth is clipped exceeds it by 0.4 of it
_LONGEST_RUN_S = 0.004  # derived: of a vibration of 31 Hz a quarter is clipped so; a longer peak is a blow's


def at_limit(values: Floats, range_of: Floats) -> Bools:
    """Which values (n, c) were clipped above and below, (2, n, c), with the range of each channel (c,).

    Values that are not finite are not clipped.
    """
    with np.errstate(invalid="ignore"):
        full = np.isfinite(values) & (np.stack([values, -values]) > (1.0 - _SATURATION_MARGIN) * range_of)
    return np.asarray(full)


class Clipping:
    """Clipped samples of one sensor.

    Once a few peaks have shown that the sensor vibrates, those beyond its range L are held at the limit. Of a mean
    ``m`` beside a vibration ``v`` that is even about zero, clipping takes ``E (m + v - L)+ - E (-m - v - L)+``, the
    integral from ``L - m`` to ``L + m`` of the share ``Q`` of ``v`` that lies beyond. Q is counted at both ends, as
    what is held above and below, and its square root taken as linear between them: the loss is m times
    ``2/3 (Q+ + sqrt(Q+ Q-) + Q-)``. That is exact for a sine that just reaches the limit and a small mean; beside a
    Gaussian and a range of 16 g a mean of 1 g is restored to 0.05 %, one of 2 g to 0.2 %. The clipped samples took the
    loss, so they get it back: each is moved outward by the loss over ``Q- - Q+``. A vibration that swells and fades
    within the memory of Q so leaves no slow force, as a common gain would. Where the shares are alike, there is no mean
    to tell the loss by, and all samples are divided by the share that remains.

    Attributes
    ----------
    clipped_ratio : (2, 6) float64
        Samples of each channel that were clipped above and below, as a share of the last seconds'.
    found_range : FoundRange
        Range of each channel: the file's, or a lower one that the samples show.
    """

    def __init__(self, range_of: Floats, period_s: float) -> None:
        """Start with the range of each channel (6,) and the time between samples."""
        self.clipped_ratio: Floats = np.zeros((2, len(range_of)))
        self._held_ratio: Floats = np.zeros((2, len(range_of)))  # the same of those that are held
        self._held_mean: Floats = np.zeros(len(range_of))  # of the last seconds' samples, those at the limit
        self.found_range = FoundRange(range_of, period_s)
        self._period_s = period_s
        self._runs = 0.0  # of the last half minute
        self._recent_runs = 0.0  # of the last seconds
        self._run = 0  # clipped samples in a row, at the end of what was counted

    @property
    def active(self) -> bool:
        """Whether anything was clipped lately."""
        return self._runs > 0.0

    def concerns(self, values: Floats) -> bool:
        """Whether the next samples (n, 6), n > 0, must be counted though the file's range is far from them."""
        self.found_range.update(values)
        return self.active or self.found_range.below_file

    @property
    def _largest_share(self) -> float:
        """Share of the axis that is clipped most; nearly always nothing is."""
        return float(self.clipped_ratio.sum(axis=0).max()) if self.active else 0.0

    @property
    def often(self) -> bool:
        """Whether so much is clipped that the noise of what it leaves is many times the sensor's."""
        return self._largest_share > _OFTEN

    @property
    def blinds(self) -> bool:
        """Whether so much is clipped that nothing rests on the rest."""
        return self._largest_share > MOST_SHARE

    def count(self, values: Floats) -> tuple[Bools, Bools, int]:
        """Which samples (n,) of the next values (n, 6) are clipped, and which of those are not to be held.

        Those are the first runs, and long ones. The last is how many samples before these were held, and are of a run
        that is now too long.
        """
        full = at_limit(values, self.found_range.range_of)
        clipped = np.asarray(full.any(axis=(0, 2)))
        if not len(values) or not (self.active or clipped.any()):
            self._run = 0
            return clipped, clipped, 0
        was_active, span_s = self.active, len(values) * self._period_s
        fresh = np.count_nonzero(clipped & np.diff(clipped, prepend=self._run > 0))
        self._runs = max(1.0 - span_s / _RUNS_MEMORY_S, 0.0) * self._runs + fresh
        lost, earlier = self._not_held(clipped)
        weight = min(span_s / _MEMORY_S, 1.0)
        self._recent_runs = (1.0 - weight) * self._recent_runs + fresh
        self.clipped_ratio += weight * (full.mean(axis=1) - self.clipped_ratio)
        self._remember(values, full & ~lost[:, np.newaxis], ~lost, weight if was_active else 1.0, weight)
        self._held_ratio = np.maximum(self._held_ratio - earlier * self._period_s / _MEMORY_S * full[:, 0], 0.0)
        if self._runs < _NO_RUN:
            self._runs = 0.0
            self.clipped_ratio, self._held_ratio = np.zeros((2, *self.clipped_ratio.shape))
        return clipped, lost, earlier

    def _not_held(self, clipped: Bools) -> tuple[Bools, int]:
        """Which of the next samples (n,) are in runs not to be held, and how many before were held and begin one."""
        before, position = self._run, np.arange(1, len(clipped) + 1)
        run = position - np.maximum.accumulate(np.where(clipped, -before, position))
        last = np.flatnonzero(clipped & ~np.append(clipped[1:], False))
        length = np.append(run[last], 0)[np.searchsorted(last, position - 1)]  # of the run that each is in
        self._run = int(run[-1])
        few = self._runs < _FEWEST_RUNS
        lost = clipped & ((length * self._period_s > _LONGEST_RUN_S) | few)
        was_held = not few and before * self._period_s <= _LONGEST_RUN_S
        return lost, before if lost[0] and was_held else 0

    def _remember(self, values: Floats, held: Bools, usable: Bools, of_mean: float, weight: float) -> None:
        """Add the next values (n, 6), held ones (2, n, 6) among the usable (n,), to the shares and the mean."""
        finite = np.isfinite(values) & usable[:, np.newaxis]
        if usable.any():
            mean = np.where(finite, values, 0.0).sum(axis=0) / np.maximum(finite.sum(axis=0), 1)
            self._held_mean += of_mean * (mean - self._held_mean)
        self._held_ratio += weight * (held.mean(axis=1) - self._held_ratio)

    def restore_mean(self, values: Floats) -> Floats:
        """Values (n, 6) with the mean that clipping took away, by channel."""
        if not self.active:
            return values
        above, below = self._held_ratio
        lost = np.minimum(2.0 / 3.0 * (above + np.sqrt(above * below) + below), MOST_SHARE)
        range_of = self.found_range.range_of
        beyond = np.divide(lost * self._held_mean / (1.0 - lost), above - below, out=np.zeros(6), where=above != below)
        clear = max(_CLEAR, _BY_CHANCE / math.sqrt(max(self._recent_runs, 1.0)))
        tells = (np.abs(below - above) > clear * (below + above)) & (beyond > 0.0)
        outward = np.minimum(np.where(tells, beyond, 0.0), _MOST_EXCESS * range_of)
        full = at_limit(values, range_of)
        return np.asarray(
            (values + (full[0].astype(np.float64) - full[1]) * outward) / np.where(tells, 1.0, 1.0 - lost)
        )

"""Clipped samples of a sensor that vibrates beyond its range: held at the limit, and the lost gain restored."""

from __future__ import annotations

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
    what is clipped above and below, and its square root taken as linear between them: the loss is m times
    ``2/3 (Q+ + sqrt(Q+ Q-) + Q-)``. That is exact for a sine that just reaches the limit and a small mean; beside a
    Gaussian and a range of 16 g a mean of 1 g is restored to 0.05 %, one of 2 g to 0.2 %. What is left is divided by
    the share that remains.

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
        self.found_range = FoundRange(range_of, period_s)
        self._period_s = period_s
        self._runs = 0.0  # of the last half minute
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

    def count(self, values: Floats) -> tuple[Bools, Bools]:
        """Which samples (n,) of the next values (n, 6) are clipped, and which of those are not to be held.

        Those are the first runs, and the end of a long one.
        """
        full = at_limit(values, self.found_range.range_of)
        clipped = np.asarray(full.any(axis=(0, 2)))
        if len(values) and (self.active or clipped.any()):
            span_s = len(values) * self._period_s
            self.clipped_ratio += min(span_s / _MEMORY_S, 1.0) * (full.mean(axis=1) - self.clipped_ratio)
            fresh = np.count_nonzero(clipped & np.diff(clipped, prepend=self._run > 0))
            self._runs = max(1.0 - span_s / _RUNS_MEMORY_S, 0.0) * self._runs + fresh
            if self._runs < _NO_RUN:
                self._runs, self.clipped_ratio = 0.0, np.zeros_like(self.clipped_ratio)
        position = np.arange(1, len(clipped) + 1)
        run = position - np.maximum.accumulate(np.where(clipped, -self._run, position))
        if len(run):
            self._run = int(run[-1])
        return clipped, clipped & ((run * self._period_s > _LONGEST_RUN_S) | (self._runs < _FEWEST_RUNS))

    def restore_gain(self, values: Floats) -> Floats:
        """Values (n, 6) over the gain that clipping leaves, by channel."""
        if not self.active:
            return values
        lost: Floats = 2.0 / 3.0 * (self.clipped_ratio.sum(axis=0) + np.sqrt(self.clipped_ratio.prod(axis=0)))
        return np.asarray(values / (1.0 - np.minimum(lost, MOST_SHARE)))

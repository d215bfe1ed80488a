"""Range that a sensor shows by its extreme value, which comes again and again where it clips below the file's range."""

from __future__ import annotations

import numpy as np

from companion.records import Floats

_WINDOW_S = 4.0  # chosen: a gust that reaches the limit at all does so several times
_LOOK_S = 0.1  # chosen: samples that are looked at together
_FEWEST, _FEWEST_RUNS = 8, 4  # chosen: samples, and visits, at the very same extreme
# chosen: a tail of its own has more samples just below its extreme than at it, a clipped one several times fewer
_NEAR, _MOST_NEAR = 0.98, 1.0 / 3.0
# chosen: and some on the way to it, as a motion has; two values that take turns have none
_BELOW_IT, _FEWEST_BELOW = 0.7, 0.25
_LEAST = np.repeat([15.0, 1.0], 3)  # chosen, m/s^2 and rad/s: no sensor has less, and a calm flight is not looked at
_BELOW = 0.9  # chosen, of the file's range: what clips above it clips there
_REFUTED = 1.005  # chosen: a value beyond a range that was found so shows that it is none


class FoundRange:
    """Watch on one stream's extremes.

    Attributes
    ----------
    range_of : (6,) float64
        Range of each channel: the file's, or the lower one that was found.
    """

    def __init__(self, range_of: Floats, period_s: float) -> None:
        """Start with the file's range of each channel (6,) and the time between samples."""
        self._stated, self.range_of = range_of, range_of.copy()
        self._window = round(_WINDOW_S / period_s)
        self._refuted: Floats = np.zeros(len(range_of))  # below it no range is found again
        self._waiting: list[Floats] = []
        self._look_at = max(round(_LOOK_S / period_s), 1)
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Forget what was counted."""
        self._taken = 0
        self._extreme: Floats = np.zeros((2, len(self._stated)))  # above, below
        self._at, self._runs, self._near, self._below = (np.zeros(self._extreme.shape, np.int64) for _ in range(4))

    @property
    def below_file(self) -> bool:
        """Whether a channel clips below the file's range."""
        return bool((self.range_of < self._stated).any())

    def update(self, values: Floats) -> None:
        """Take the next samples, (n, 6) with n > 0; they are looked at together."""
        self._waiting.append(values.copy())
        if sum(map(len, self._waiting)) >= self._look_at:
            self._look(np.concatenate(self._waiting))
            self._waiting.clear()

    def _look(self, values: Floats) -> None:
        self._taken += len(values)
        if self._taken > self._window:
            self._begin_anew()
        if not (np.abs(values).max(axis=0) > _LEAST).any():
            return
        both = np.stack([values, -values])
        higher = (top := both.max(axis=1)) > self._extreme
        self._extreme = np.where(higher, top, self._extreme)
        for counts in (self._at, self._runs, self._near, self._below):
            counts[higher] = 0
        at = both == self._extreme[:, None]
        self._at += at.sum(axis=1)
        self._runs += (np.diff(at, axis=1, prepend=False) & at).sum(axis=1)
        self._near += ((both > _NEAR * self._extreme[:, None]) & ~at).sum(axis=1)
        self._below += ((both > _BELOW_IT * self._extreme[:, None]) & ~at).sum(axis=1)
        often = (self._at >= _FEWEST) & (self._runs >= _FEWEST_RUNS)
        clips = often & (self._near < _MOST_NEAR * self._at) & (self._below > _FEWEST_BELOW * self._at)
        self._take(np.where(clips, self._extreme, np.inf).min(axis=0), top.max(axis=0))

    def _take(self, clipped: Floats, largest: Floats) -> None:
        """Take over ranges at which channels clip, and give up those that their ``largest`` values (6,) refute."""
        refuted = (self.range_of < self._stated) & (largest > _REFUTED * self.range_of)
        self._refuted = np.where(refuted, largest, self._refuted)
        self.range_of = np.where(refuted, self._stated, self.range_of)
        new = (clipped > np.maximum(_LEAST, self._refuted)) & (clipped < self.range_of)
        self.range_of = np.where(new & (clipped < _BELOW * self._stated), clipped, self.range_of)

    def sentences(self, place: str) -> list[str]:
        """Sentences for the operator."""
        names = (("accelerometer", "m/s2", slice(0, 3)), ("gyro", "rad/s", slice(3, 6)))
        pairs = [(name, unit, self.range_of[at].min(), self._stated[at].max()) for name, unit, at in names]
        return [
            f"{place} {name} clips at {limit:.3g} {unit}, its file says {stated:.3g}"
            for name, unit, limit, stated in pairs
            if limit < stated
        ]

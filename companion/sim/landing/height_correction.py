"""ArduPlane's use of a range finder in a landing: the range corrects the barometer's height, slowly and with checks.

Restated from ArduPlane's behaviour (``rangefinder_height_update`` and ``rangefinder_correction``): a range times the
cosine of the tilt is a height; ten readings that differ from the first by a twentieth of the largest range put it in
use; its difference from the barometer is smoothed by a fifth a pass; a correction that wanders by 30 m from the first
drops it; after silence the last correction holds for five seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

_READINGS = 10  # in a row that count before the range is used (ArduPlane)
_CHANGED = 0.05  # of the largest range, from the first reading (ArduPlane)
_JUMP = 0.2  # of the largest range: counting begins anew (ArduPlane)
_NEW_SHARE = 0.2  # of the newest correction in the smoothed one, a pass (ArduPlane, at 50 Hz)
_WANDER_M = 30.0  # convention: ArduPlane drops a correction that wanders by so much from the first
_HOLD_S = 5.0  # convention: ArduPlane holds the last correction for so long


@dataclass(slots=True)
class HeightCorrection:
    """Correction of the barometer's height by ranges; :meth:`update` is one pass at 50 Hz.

    ``in_range`` is whether the readings are taken for the ground.
    """

    range_max_m: float
    in_range: bool = False
    dropped: int = 0
    _correction_m: float = 0.0
    _first_correction_m: float = 0.0
    _corrected_s: float | None = None
    _first_range_m: float | None = None
    _last_range_m: float = 0.0
    _readings: int = 0

    def update(self, now_s: float, range_m: float | None, tilt_cosine: float, height_m: float) -> None:
        """Take the newest reading (None: no good one) and the barometer's height above the landing point."""
        if range_m is None:
            self._readings, self.in_range = 0, False
            return
        self._count(range_m)
        self._last_range_m = range_m
        if self.in_range:
            self._correct(now_s, height_m - range_m * tilt_cosine)

    def correction_m(self, now_s: float) -> float:
        """How much the barometer reads too high, 0 where no range has told for five seconds."""
        if self._corrected_s is None or now_s - self._corrected_s > _HOLD_S:
            return 0.0
        return self._correction_m

    def _count(self, range_m: float) -> None:
        if self._first_range_m is None:
            self._first_range_m = range_m
        if self._readings >= _READINGS:
            self.in_range = True
            return
        if range_m != self._last_range_m and abs(range_m - self._first_range_m) > _CHANGED * self.range_max_m:
            self._readings += 1
        if abs(range_m - self._last_range_m) > _JUMP * self.range_max_m:
            self._readings = 0

    def _correct(self, now_s: float, correction_m: float) -> None:
        fresh = self._corrected_s is None or now_s - self._corrected_s > _HOLD_S
        self._corrected_s = now_s
        if fresh:
            self._correction_m = self._first_correction_m = correction_m
            return
        self._correction_m += _NEW_SHARE * (correction_m - self._correction_m)
        if abs(self._correction_m - self._first_correction_m) > _WANDER_M:
            self._drop()

    def _drop(self) -> None:
        self.in_range, self._readings, self._corrected_s, self._first_range_m = False, 0, None, None
        self._correction_m = self._first_correction_m = 0.0
        self.dropped += 1

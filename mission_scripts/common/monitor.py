"""Watches a range against what else is known of the distance: stale, not trusted, jumping, or disagreeing."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from mission_scripts.common.watch import Range

_SIGMAS = 4.0  # of a range: more is a contradiction
_BANKED_RAD = 0.25
_ENDS_M = 3.0  # above the least distance: what a landing sinks in a usual ``blind_s`` (choice)


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Tolerance of ranges against their expectation.

    Attributes
    ----------
    stale_s
        Since the last DISTANCE_SENSOR of any kind; the autopilot itself forgets a range after 0.5 s.
    blind_s
        Since the last trusted range.
    jump_m
        Between two trusted ranges, beyond what the climb explains; grows with their sigma. Counts for ``blind_s``.
    apart_m, apart_share
        Between range and expected distance: a fixed part (barometer, terrain) and one that grows with the distance.
    """

    stale_s: float = 0.6
    blind_s: float = 1.5
    jump_m: float = 2.0
    apart_m: float = 3.0
    apart_fraction: float = 0.05


class RangeMonitor:
    """Feed it every range with :meth:`take`; :meth:`trouble` says what is wrong now, or nothing.

    Parameters
    ----------
    expected_m : callable
        The distance that a range should have read.
    """

    def __init__(self, expected_m: Callable[[Range], float], tolerance: Tolerance) -> None:
        self._expected_m, self._tolerance = expected_m, tolerance
        self._newest_s = self._trusted_s = -math.inf
        self._last: tuple[Range, float] | None = None
        self._jump = self._apart = ""
        self._jumped_s = -math.inf
        self._ends = False  # the newest trusted range is about as near as one can be
        self.apart_m: list[float] = []

    def take(self, entry: Range) -> None:
        """One range, in the order of arrival; in a steep turn it is not compared with anything."""
        self._newest_s = entry.at_s
        if not entry.trusted:
            return
        self._trusted_s, self._ends = entry.at_s, entry.distance_m < entry.least_m + _ENDS_M
        if entry.tilt_rad > _BANKED_RAD:
            self._last = None
            return  # in a turn a slightly late attitude is worth metres
        expected_m = self._expected_m(entry)
        jump = self._compare(entry, expected_m)
        if jump:
            self._jump, self._jumped_s = jump, entry.at_s
        apart_m = entry.distance_m - expected_m
        self.apart_m.append(apart_m)
        allowed_m = self._tolerance.apart_m + self._tolerance.apart_fraction * expected_m
        far = abs(apart_m) > allowed_m + _SIGMAS * _sigma(entry)
        self._apart = f"reads {entry.distance_m:.1f} m where {expected_m:.1f} m is expected" if far else ""
        self._last = (entry, expected_m)

    def trouble(self, now_s: float, *, low: bool = False) -> str:
        """Why the range is not to be relied on at this moment; empty if it is.

        With ``low``, just above the ground, what is expected counts no more (a barometer's drift is worth metres), and
        ranges may end where they have come near the least distance that can be told.
        """
        if now_s - self._newest_s > self._tolerance.stale_s:
            return f"range stale ({_seconds(now_s - self._newest_s)})"
        if now_s - self._trusted_s > self._tolerance.blind_s and not (low and self._ends):
            return f"no trusted range ({_seconds(now_s - self._trusted_s)})"
        jumped = now_s - self._jumped_s < self._tolerance.blind_s
        return self._jump if jumped else "" if low else self._apart

    def _compare(self, entry: Range, expected_m: float) -> str:
        """A jump is a change of the range that the change of the expected distance does not explain."""
        if self._last is None or entry.at_s - self._last[0].at_s > self._tolerance.blind_s:
            return ""
        before, then_m = self._last
        step_m = (entry.distance_m - before.distance_m) - (expected_m - then_m)
        allowed_m = self._tolerance.jump_m + _SIGMAS * math.hypot(_sigma(entry), _sigma(before))
        return f"range jumps by {step_m:+.1f} m" if abs(step_m) > allowed_m else ""


def _sigma(entry: Range) -> float:
    return entry.sigma_m if math.isfinite(entry.sigma_m) else 0.03 * entry.distance_m


def _seconds(value: float) -> str:
    return f"{value:.1f} s" if math.isfinite(value) else "never yet"

"""The last gate before a range is published: consistency with its predecessors, with hysteresis (DESIGN, rule 11)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from companion.records import CorrectedRange, Reject

_CONSISTENT_SIGMAS = 5.0
_AGREEING_TO_TRUST = 3
_FORGET_NS = 2_000_000_000


@dataclass(slots=True)
class RangeGate:
    """Trust a range when it agrees with the last ones and the climb rate; recover only after several that agree.

    Each range that passed its own checks is compared with the last one, moved on by the climb rate (range grows as a
    downward-looking aircraft climbs). One outlier is refused; after a break, ``_AGREEING_TO_TRUST`` ranges must agree
    among themselves before one is trusted again.
    """

    closing_mps_per_climb: float
    _last: CorrectedRange | None = None
    _agreeing: int = 0

    def judge(self, measured: CorrectedRange, climb_mps: float, slack_mps: float = 5.0) -> CorrectedRange:
        """Give ``measured``, its trust withdrawn where it jumps; ``slack_mps`` bounds what terrain and speed do."""
        if not measured.trusted:
            return measured
        agrees = self._agrees(measured, climb_mps, slack_mps)
        self._agreeing = self._agreeing + 1 if agrees else 1
        self._last = measured
        if self._agreeing >= _AGREEING_TO_TRUST:
            return measured
        return dataclasses.replace(measured, trusted=False, reject=Reject.INCONSISTENT)

    def _agrees(self, measured: CorrectedRange, climb_mps: float, slack_mps: float) -> bool:
        last = self._last
        if last is None or not 0 < measured.t_host_ns - last.t_host_ns < _FORGET_NS:
            return False
        elapsed_s = (measured.t_host_ns - last.t_host_ns) * 1e-9
        expected_m = last.range_m + self.closing_mps_per_climb * climb_mps * elapsed_s
        sigma_m = (measured.sigma_m**2 + last.sigma_m**2) ** 0.5
        allowed_m = _CONSISTENT_SIGMAS * sigma_m + slack_mps * elapsed_s
        return bool(abs(measured.range_m - expected_m) <= allowed_m)

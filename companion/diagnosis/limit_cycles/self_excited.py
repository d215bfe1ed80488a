"""Vibrations that keep their amplitude: no linear wing that nothing drives has them, whatever else explains the rows.

A limit cycle and the response to a periodic force look alike while they last. A measured force with a line at the
frequency of the vibration, in step with it, makes the latter likely; one without excludes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from companion.core.wing.effects.damping.quadratic_damping import QuadraticDamping
from companion.diagnosis.limit_cycles.rows import LIMIT_CYCLE, Row
from companion.diagnosis.limit_cycles.tracks import STEADY, VibrationTrack
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.diagnosis.selection.diagnosis import Diagnosis
from companion.diagnosis.selection.regression import RegressionModel, RegressionTerm

FEWEST_CYCLES = 4
"""Limit cycles, to fit how they change with airspeed (choice)."""
_FALLS, _SURELY = 0.03, 5.0  # chosen: of ln amplitude in all, and sigmas, beyond which a vibration decays slowly
_FEWEST_RISING = 6  # chosen: windows of a rise, of which three coefficients and an error are fitted
_WIDE = 0.3  # chosen: range of amplitudes over the largest, that shows how a rise begins
_AT_ONCE = 0.3  # chosen: of the largest rate: that of a force begins at 1, self-excited growth at 0
_GROWTH = "the growth from rest up to it, and the return after a push"

Outcome = Diagnosis[RegressionTerm, RegressionModel]


def judged_cycles(outcome: Outcome, rows: Sequence[Row], tracks: Sequence[VibrationTrack], name: str) -> Outcome:
    """The outcome, unexplained where vibrations keep their amplitude and no term says why, or a force does."""
    cycles = [row for row in rows if row.cycle and not _falls(tracks[row.recording])]
    driven = sorted({force for row in cycles for force in tracks[row.recording].driven_by})
    rises = [tracks[i].name for i in sorted({row.recording for row in rows}) if _switched_on(tracks[i])]
    if rises and outcome.verdict in (DiagnosisVerdict.ADEQUATE, DiagnosisVerdict.EXPLAINED):
        return _unexplained(
            outcome,
            f"the amplitude of {', '.join(rises)} begins to rise at a constant rate, as the response to a periodic "
            "force that is switched on; self-excited growth begins in proportion to the amplitude",
            "",
        )
    if not cycles:
        return outcome
    if driven:
        hz = [row.frequency_hz for row in cycles if tracks[row.recording].driven_by]
        return _unexplained(
            outcome,
            f"amplitudes stay constant in {len(hz)} recordings, at {_range(hz)} Hz, in step with a line of "
            f"{', '.join(driven)}: the response of a linear wing to that force, or a limit cycle that it locks",
        )
    says_why = {LIMIT_CYCLE, QuadraticDamping.name} & {term.name for term in outcome.final.terms}
    if says_why or outcome.verdict not in (DiagnosisVerdict.ADEQUATE, DiagnosisVerdict.EXPLAINED):
        return outcome
    levels, speeds = [row.amplitude[0] for row in cycles], [row.airspeed_mps for row in cycles]
    if min(speeds) > 0.0 and np.ptp(levels) >= STEADY * max(levels):
        few = f"; record cycles at {FEWEST_CYCLES} airspeeds or more" if len(cycles) < FEWEST_CYCLES else ""
        moves = " and the airspeed" if np.ptp(speeds) else ""
        return _unexplained(
            outcome,
            f"{len(cycles)} limit cycles of {min(levels):.3g} to {max(levels):.3g} ({name}) stand at {min(speeds):g} "
            f"to {max(speeds):g} m/s, a linear wing has none: damping follows the amplitude{moves}{few}",
        )
    hz = [row.frequency_hz for row in cycles]
    or_driven = "" if all(tracks[row.recording].forces for row in cycles) else ", or the response to a periodic force"
    return _unexplained(
        outcome,
        f"amplitudes stay constant in {len(cycles)} recordings, at {_range(hz)} Hz: a self-excited vibration (limit "
        f"cycle){or_driven}; a linear wing that nothing drives decays or grows",
    )


def what_to_record(outcome: Outcome, rows: Sequence[Row], tracks: Sequence[VibrationTrack]) -> list[str]:
    """Recordings that would tell what keeps the amplitude; none where nothing does, or a law says why."""
    cycles = [row for row in rows if row.cycle and not _falls(tracks[row.recording])]
    if outcome.verdict is not DiagnosisVerdict.UNEXPLAINED:
        return []
    if any(_switched_on(tracks[i]) for i in {row.recording for row in rows}):
        return ["the force as input_<what>, or the same with all that turns or shakes off"]
    if outcome.nearest != LIMIT_CYCLE or not cycles:
        return []
    if any(tracks[row.recording].driven_by for row in cycles):
        return ["the same with the force off: a limit cycle stays, a response decays", _GROWTH + ", with the force off"]
    lines = [_GROWTH]
    if not all(tracks[row.recording].forces for row in cycles):
        lines.append("the force as input_<what>, or all that turns or shakes off: a driven vibration follows its line")
    speeds = {row.airspeed_mps for row in cycles}
    if len(cycles) < FEWEST_CYCLES or len(speeds) < FEWEST_CYCLES:
        lines.append(f"cycles at {FEWEST_CYCLES} airspeeds or more, with airspeed_mps")
    return lines


def _range(values: Sequence[float]) -> str:
    low, high = f"{min(values):.4g}", f"{max(values):.4g}"
    return low if low == high else f"{low} to {high}"


def _unexplained(outcome: Outcome, reason: str, nearest: str = LIMIT_CYCLE) -> Outcome:
    return replace(
        outcome,
        verdict=DiagnosisVerdict.UNEXPLAINED,
        causes=(),
        nearest=nearest,
        nearest_causes=(*outcome.causes, *outcome.nearest_causes),
        reason=reason,
    )


def _switched_on(entry: VibrationTrack) -> bool:
    """Whether the rate of a rising amplitude has an intercept at rest: A' = p + a A + b A^3 with a large, sure p."""
    level = next(iter(entry.amplitude.values()))
    rate = entry.growth_radps * level
    rising = ~entry.steady & (rate > 0.0)
    if rising.sum() < _FEWEST_RISING or np.ptp(level[rising]) < _WIDE * level.max():
        return False
    a = level[rising] / level.max()
    design = np.stack([np.ones_like(a), a, a**3], 1)
    values = np.linalg.lstsq(design, rate[rising], rcond=None)[0]
    left = rate[rising] - design @ values
    covariance = np.linalg.pinv(design.T @ design) * float(left @ left) / (len(a) - 3)
    sigma = float(np.sqrt(covariance[0, 0]))
    return bool(values[0] > max(_SURELY * sigma, _AT_ONCE * float(rate[rising].max())))


def _falls(entry: VibrationTrack) -> bool:
    """Whether a recording's steady windows decay slowly, as a linear wing of small damping does."""
    t_s, level = entry.t_s[entry.steady], np.log(next(iter(entry.amplitude.values()))[entry.steady])
    if len(t_s) < 4 or np.ptp(t_s) == 0.0:
        return False
    since_s = t_s - t_s.mean()
    slope = float(since_s @ level) / float(since_s @ since_s)
    left = level - level.mean() - slope * since_s
    sigma = float(np.sqrt(left @ left / (len(t_s) - 2) / (since_s @ since_s)))
    return -slope * float(np.ptp(t_s)) > _FALLS and -slope > _SURELY * sigma

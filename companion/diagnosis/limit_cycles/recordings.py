"""Self-excited vibration under the engine: stiffness and damping against amplitude and airspeed, and the limit cycle.

Averaged over a period a nearly harmonic vibration A cos(phase) obeys (Krylov and Bogoliubov)

    d ln A / dt = -omega zeta(V, A),     omega^2 = omega_0^2 + (3/4) k_3 A^2 + (5/8) k_5 A^4 + k_V v

with v the airspeed about its mean in units of its rms. A linear wing has neither A: it decays or grows without end, at
one frequency. Where zeta crosses 0 with A rising the amplitude stays: the limit cycle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effects.damping.quadratic_damping import QuadraticDamping
from companion.core.wing.effects.stiffness.airspeed_dependence import AirspeedDependence
from companion.core.wing.effects.stiffness.cubic_stiffness import CubicStiffness
from companion.diagnosis.limit_cycles.labels import LabelDoubt, doubtful_labels
from companion.diagnosis.limit_cycles.rows import LIMIT_CYCLE, Row, rows_of
from companion.diagnosis.limit_cycles.self_excited import FEWEST_CYCLES, judged_cycles
from companion.diagnosis.limit_cycles.small_damping import NOISY, SMALL, damping_over_airspeed
from companion.diagnosis.limit_cycles.tracks import VibrationTrack
from companion.diagnosis.selection.diagnosis import Diagnosis, diagnose
from companion.diagnosis.selection.recordings import Progress
from companion.diagnosis.selection.regression import (
    Coefficient,
    RegressionFit,
    RegressionModel,
    RegressionResponse,
    Regressions,
    RegressionTerm,
)
from companion.errors import RecordingError
from companion.records import Bools, Floats

FREQUENCY, DAMPING = "square of the frequency", "damping ratio"
CYCLE, AMPLITUDE = "square of the cycle's frequency", "square of the cycle's amplitude"
_FEWEST_WINDOWS = 6  # on the way to or from a cycle, to fit its damping (choice)
_FEWEST_RECORDINGS = 3  # at one airspeed, to hold one out: of two, one does not predict the other (choice)
_DEGREE = 3  # chosen: of the cycle's squares over the airspeed: two degrees miss the rig's largest amplitudes by 11 %
_SPARE = 3  # chosen: airspeeds more than the degree, so that as many are left when one is held out, and one to judge
_CYCLE_NOISE = 0.1  # of a squared amplitude or frequency relative to itself, where its noise is sought (choice)
_LEAST_SQUARE = 1e-4  # chosen: of a predicted square over its mean, below which no cycle is
_PER = " per rms of the airspeed"


@dataclass(frozen=True, slots=True)
class Onset:
    """Airspeed at which small vibrations stop decaying, m/s, from growth and decay at small amplitude alone."""

    airspeed_mps: float
    sigma_mps: float
    windows: int
    bracket_mps: tuple[float, float]


@dataclass(frozen=True, slots=True)
class HeldOutSpeed:
    """Limit cycle of an airspeed that was not fitted: measured and predicted frequency, and amplitudes by response."""

    airspeed_mps: float
    frequency_hz: tuple[float, float]
    amplitude: dict[str, tuple[float, float]]


@dataclass(frozen=True, slots=True)
class FlutterDiagnosis:
    """Outcome: ``tracks`` with their label doubts, the engine's outcome, held-out speeds and the onset.

    ``rows`` are what was fitted.
    """

    outcome: Diagnosis[RegressionTerm, RegressionModel]
    tracks: tuple[VibrationTrack, ...]
    rows: tuple[Row, ...]
    names: tuple[str, ...]
    held_out: tuple[HeldOutSpeed, ...]
    onset: Onset | None
    doubts: tuple[LabelDoubt, ...]


def diagnose_vibration(tracks: Sequence[VibrationTrack], most: int, progress: Progress) -> FlutterDiagnosis:
    """Judge recordings of one rig.

    Raises
    ------
    RecordingError
        No recording has windows above its noise.
    """
    names = tuple(tracks[0].amplitude)
    doubts = doubtful_labels(tracks)
    aside = {entry.recording for entry in doubts}
    if any(entry.airspeed_mps is not None for entry in tracks):  # in still air it is another structure
        aside |= {i for i, entry in enumerate(tracks) if entry.airspeed_mps is None}
    rows = [row for i, entry in enumerate(tracks) if i not in aside for row in rows_of(i, entry)]
    if not rows:
        raise RecordingError(
            f"no recording rises above its noise in {names[0]}, the leading response: excite the structure, record it "
            "longer, or put another response first in the mapping"
        )
    speeds = np.array([row.airspeed_mps for row in rows])
    mean, rms = float(speeds.mean()), float(speeds.std()) or 1.0
    regressions = _regressions(rows, names, (speeds - mean) / rms)
    outcome = judged_cycles(diagnose(regressions, most, progress), rows, tracks, names[0])
    held_out = _held_out(regressions, outcome.final, rows, names) if len(set(speeds)) > 1 else ()
    onset = _onset(rows)
    return FlutterDiagnosis(outcome, tuple(tracks), tuple(rows), names, held_out, onset, doubts)


def _blocks(rows: Sequence[Row], speeds: Floats) -> Floats:
    """Block of each row, (n,): airspeed; at one airspeed the recording; of one or two recordings 0 and 1 by turns."""
    recording = np.array([row.recording for row in rows], dtype=np.float64)
    if np.ptp(speeds) > 0.0:
        return speeds
    return recording if len(set(recording)) >= _FEWEST_RECORDINGS else np.asarray(np.arange(len(rows)) % 2 + 0.0)


def _regressions(rows: Sequence[Row], names: Sequence[str], v: Floats) -> Regressions:
    amplitude = np.array([row.amplitude for row in rows])
    relative = amplitude / amplitude.max(axis=0)
    f_hz, zeta = np.array([row.frequency_hz for row in rows]), np.array([row.damping for row in rows])
    cycle, speeds = np.array([row.cycle for row in rows]), np.array([row.airspeed_mps for row in rows])
    scale: Floats = np.where(cycle, 1.0, 1.0 / np.clip(relative[:, 0], *NOISY))
    group = np.asarray(cycle & (cycle.sum() >= FEWEST_CYCLES)).astype(np.int64)
    square = f_hz**2
    level, block = float(np.median(square)), _blocks(rows, speeds)
    responses = [RegressionResponse(FREQUENCY, square, scale, group, block, relative[:, 0], level, level, 0.05 * level)]
    terms = [_stiffness(name, relative[:, i], level) for i, name in enumerate(names)]
    if np.ptp(speeds) > 0.0:
        terms.append(
            _airspeed(Coefficient("frequency: airspeed", FREQUENCY, v, 0.2 * level, "Hz^2", f"{FREQUENCY}{_PER}"))
        )
    transient = ~cycle
    if transient.sum() >= _FEWEST_WINDOWS:
        a, noise = relative[transient, 0], np.asarray(scale[transient], dtype=np.float64)
        inside, alike = _inside_cycle(relative[:, 0], v, cycle)[transient], np.zeros_like(group[transient])
        of_window = zeta[transient], noise, alike, block[transient], a
        responses.append(RegressionResponse(DAMPING, *of_window, 0.0, 0.05, 0.01))
        terms.append(_damping(names[0], a, inside))
        if np.ptp(speeds[transient]) > 0.0:
            column = v[transient] * inside
            terms.append(_airspeed(Coefficient("damping: airspeed", DAMPING, column, 0.02, "", f"{DAMPING}{_PER}")))
    if cycle.sum() >= FEWEST_CYCLES and np.ptp(speeds[cycle]) > 0.0:
        followed = {CYCLE: (square / level)[cycle]}
        followed |= {f"{AMPLITUDE}: {name}": relative[cycle, i] ** 2 for i, name in enumerate(names)}
        alike, at_mps = np.zeros_like(group[cycle]), speeds[cycle]
        for at, values in followed.items():
            mean = float(values.mean())
            responses.append(RegressionResponse(at, values, values, alike, at_mps, at_mps, mean, mean, _CYCLE_NOISE))
        terms += _cycle(responses[-len(followed) :])
    return Regressions(responses, terms)


def _inside_cycle(a: Floats, v: Floats, cycle: Bools) -> Floats:
    """Distance inside the limit cycle, 1 - (A / A_c(v))^2, (n,): 1 at rest, 0 on the cycle; 1 where none is."""
    if cycle.sum() < FEWEST_CYCLES or np.ptp(v[cycle]) == 0.0:
        return np.ones(len(a))
    near = np.clip(v, v[cycle].min(), v[cycle].max())  # a polynomial says nothing beyond
    log_cycle = np.polyval(np.polyfit(v[cycle], np.log(a[cycle]), 2), near)
    return np.asarray(1.0 - a**2 * np.exp(-2.0 * log_cycle))


def _airspeed(column: Coefficient) -> RegressionTerm:
    return RegressionTerm(AirspeedDependence.name, "airspeed_mps", (column,))


def _cycle(followed: Sequence[RegressionResponse]) -> list[RegressionTerm]:
    """Squared amplitudes and frequency of the limit cycle over the airspeed, without those that are constant."""
    columns = [column for entry in followed for column in _moved(entry)]
    return [RegressionTerm(LIMIT_CYCLE, "airspeed_mps", tuple(columns))] if columns else []


def _moved(followed: RegressionResponse) -> tuple[Coefficient, ...]:
    """Columns of a square over the airspeed, none where it is constant: unused ones cost as much as others gain."""
    x = (followed.order - followed.order.mean()) / followed.order.std()
    shapes = (
        ("slope", x, 1.0, "per rms of the airspeed"),
        ("bend", x**2 - 1.0, 0.4, "the same, per its square"),
        ("twist", x**3 - 3.0 * x, 0.2, "the same, per its cube"),
    )
    at, degree = followed.name, min(max(len(set(followed.order.tolist())) - _SPARE, 1), _DEGREE)
    columns = tuple(
        Coefficient(f"{at}: {name}", at, column, sigma * followed.level, "", f"{at} over the largest's, {meaning}")
        for name, column, sigma, meaning in shapes[:degree]
    )
    alone = Regressions([followed], [])
    constant = alone.null()
    moved = alone.fit([RegressionTerm(LIMIT_CYCLE, "", columns)], constant)
    return columns if moved.log_evidence > constant.log_evidence else ()


def _stiffness(name: str, a: Floats, level: float) -> RegressionTerm:
    unit = f"square of the frequency at the largest amplitude of {name}"
    return RegressionTerm(
        CubicStiffness.name,
        name,
        (
            Coefficient(f"{name}: cubic", FREQUENCY, a**2, level, "Hz^2", f"{unit}, cubic"),
            Coefficient(f"{name}: quintic", FREQUENCY, a**4, level, "Hz^2", f"{unit}, quintic"),
        ),
    )


def _damping(name: str, a: Floats, inside: Floats) -> RegressionTerm:
    at_rest = "damping ratio at rest over that on the cycle" if np.ptp(inside) else "its change with squared amplitude"
    return RegressionTerm(
        QuadraticDamping.name,
        name,
        (
            Coefficient(f"{name}: damping", DAMPING, inside if np.ptp(inside) else a**2, 0.05, "", at_rest),
            Coefficient(f"{name}: rise", DAMPING, inside * a, 0.1, "", f"its change with the amplitude of {name}"),
        ),
    )


def _held_out(
    regressions: Regressions, fitted: RegressionFit, rows: Sequence[Row], names: Sequence[str]
) -> tuple[HeldOutSpeed, ...]:
    """Limit cycles of each airspeed, predicted from the others."""
    cycles = [row for row in rows if row.cycle]
    if len(cycles) < FEWEST_CYCLES or not any(term.name == LIMIT_CYCLE for term in fitted.terms):
        return ()
    largest = np.array([row.amplitude for row in rows]).max(axis=0)
    typical_hz = float(np.sqrt(np.median([row.frequency_hz**2 for row in rows])))
    places = [k for k, entry in enumerate(regressions.responses) if entry.name.startswith((CYCLE, AMPLITUDE))]
    held_out = []
    for speed in sorted({row.airspeed_mps for row in cycles}):
        again = regressions.without(fitted, speed)
        at = [k for k, row in enumerate(cycles) if row.airspeed_mps == speed]
        f_ratio, *levels = (
            _root(again.state.predicted(again.values, places[i])[at], regressions.responses[places[i]].level)
            for i in range(1 + len(names))
        )
        mean = np.array([cycles[k].amplitude for k in at]).mean(axis=0)
        held_out.append(
            HeldOutSpeed(
                speed,
                (float(np.mean([cycles[k].frequency_hz for k in at])), f_ratio * typical_hz),
                {name: (float(mean[i]), float(levels[i] * largest[i])) for i, name in enumerate(names)},
            )
        )
    return tuple(held_out)


def _root(squares: Floats, mean: float) -> float:
    """Root of the mean of predicted squares (n,), which an extrapolation may put below 0."""
    return float(np.sqrt(max(float(squares.mean()), _LEAST_SQUARE * mean)))


def _onset(rows: Sequence[Row]) -> Onset | None:
    """Zero of the damping ratio at small amplitude."""
    largest = max((row.amplitude[0] for row in rows), default=0.0)
    small = [row for row in rows if not row.cycle and row.airspeed_mps > 0.0 and row.amplitude[0] < SMALL * largest]
    speeds = np.array([row.airspeed_mps for row in small])
    if len(small) < 6 or np.ptp(speeds) == 0.0:
        return None
    a = np.array([row.amplitude[0] for row in small]) / largest
    fitted = damping_over_airspeed(speeds, a, np.array([row.damping for row in small]))
    falls = fitted.values[1] < -2.0 * np.sqrt(fitted.covariance[1, 1])
    at_mps, sigma_mps = fitted.airspeed_mps(0.0) if falls else (float("nan"), float("nan"))
    return Onset(at_mps, sigma_mps, len(small), (float(speeds.min()), float(speeds.max())))

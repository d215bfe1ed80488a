"""An oscillator with a measured force under the engine: its linear part, and laws of its spring and damper.

    u = m q'' + c q' + k q + sum_j theta_j f_j(q, q')

is linear in everything unknown. It is written in the frequency domain, segment by segment: derivatives and laws are
made of the whole recording in time, then cut, tapered and transformed. Its error is the measured response's times
D + s(t) + j omega z(t), D = k + j omega c - omega^2 m, s and z the slopes of the laws over deflection and speed, and
that of the force, alike at all frequencies: (|D + mean s + j omega mean z|^2 + var s + omega^2 var z + rho^2)^1/2
(after Sanathanan and Koerner), rho by profile likelihood. The delay of the force is estimated and removed. Deflection
counts from the recording's own zero: a cube about another zero has a square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from companion.core.wing.effects.damping.coulomb_friction import CoulombFriction
from companion.core.wing.effects.damping.quadratic_damping import QuadraticDamping
from companion.diagnosis.forced.consistent_fit import DELAY, LINEAR, ConsistentFit, consistent_fit
from companion.diagnosis.forced.equation_rows import (
    LAWS,
    NAMELESS,
    EquationRows,
    ForcedRecording,
    beyond_half_rate,
    equation_rows,
    nameless_columns,
    refuse_integrated_noise,
)
from companion.diagnosis.forced.even_recording import EvenRecording, evenly
from companion.diagnosis.forced.force_delay import error_ratio, least_error, real_rows
from companion.diagnosis.forced.noise_bias import NoiseShare, added_by_noise
from companion.diagnosis.forced.response_kind import ResponseKind, another_kind
from companion.diagnosis.forced.row_noise import profile_log_likelihood, row_noise
from companion.diagnosis.selection.check import Check
from companion.diagnosis.selection.diagnosis import Diagnosis, diagnose
from companion.diagnosis.selection.recordings import Cause, Progress, SelectionPath
from companion.diagnosis.selection.regression import (
    Coefficient,
    RegressionFit,
    RegressionModel,
    RegressionResponse,
    Regressions,
    RegressionTerm,
)
from companion.errors import RecordingError
from companion.records import Floats

FORCE = "force"
_INDEPENDENT = 18.0 / 35.0  # derived: of a Hann taper's bins, (sum t^2)^2 / (m sum t^4) with means 3/8 and 35/128
_DELAY_GAIN = 9.0  # chosen: nat of likelihood that a delay must gain: 6, and ln 33 for the places where it is sought
_SAME_RATE = 0.01  # relative difference of rates that count as equal: 0.08 rows of the longest delay (choice)
_MOST_ERROR = 0.85  # chosen, of the force: noise of the response made a stiffness 2 % wrong at 0.81, 69 % at 0.89
_FAR_FROM_ZERO = 5.0  # chosen, standard deviations of the response: a cube was explained at 5, not so at 10
_MOST_ALIASED = 0.005  # chosen, of the deflection's rms: a cubic was 5 sigma off at 0.010, 1 sigma at 0.002
# chosen, nat: cubes left at most 9 to a law without a name, 28 where harmonics fold back; gaps 23 to 2430 (README)
_MOST_GAIN = 30.0
_SURE = 5.0  # sigmas below 0 from which a coefficient counts as negative (choice)
_WIDE = 10.0  # prior sigma of a coefficient, in rms of the force over that of its column (choice)


@dataclass(frozen=True, slots=True)
class ForcedDiagnosis:
    """Outcome, with the linear part (mass, damping, stiffness in force per unit of the response) of either model."""

    outcome: Diagnosis[RegressionTerm, RegressionModel]
    recordings: tuple[ForcedRecording, ...]
    scale: Floats
    noise: NoiseShare
    consistent: tuple[ConsistentFit | None, ConsistentFit | None] = (None, None)
    notes: tuple[str, ...] = ()

    def linear(self, extended: bool) -> Floats:
        """Mass, damping and stiffness, (3,)."""
        consistent = self.consistent[extended]
        return self.start(extended)[1][:3] if consistent is None else consistent.values[:3]

    def linear_sigmas(self, extended: bool) -> Floats:
        """Sigmas of mass, damping and stiffness, (3,)."""
        consistent = self.consistent[extended]
        if consistent is not None:
            return np.array([consistent.value(name)[1] for name in LINEAR])
        return np.array([self._fit(extended).value(name)[1] for name in LINEAR]) / self.scale[:3]

    def start(self, extended: bool) -> tuple[list[str], Floats]:
        """Accepted laws of a model, and the coefficients by bias compensation, (c,): three, and all laws."""
        fitted = self._fit(extended)
        shift = self._shift(fitted)
        laws = [name for name in LAWS if name in fitted.keys]
        each = {name: fitted.value(name)[0] + shift[name] for name in (*LINEAR, *laws)}
        return laws, np.array([each.get(name, 0.0) for name in (*LINEAR, *LAWS)]) / self.scale

    def _fit(self, extended: bool) -> RegressionFit:
        return self.outcome.final if extended else self.outcome.null

    def coefficient(self, cause: Cause[RegressionTerm]) -> tuple[float, float]:
        """Coefficient of a law in force per its power of the response, and its sigma."""
        name = cause.term.name
        consistent = self.consistent[True]
        if consistent is not None:
            return consistent.value(name)
        unit = float(self.scale[3 + list(LAWS).index(name)])
        return (cause.values[0] + self._shift(self.outcome.final)[name]) / unit, cause.sigmas[0] / unit

    def noise_ratio(self) -> float:
        """Largest share of the normal matrix of either model that the response's noise makes."""
        fits = (self.outcome.null, self.outcome.final)
        return max(self.noise.ratio(fitted.keys, _log_noise(fitted)) for fitted in fits)

    def _shift(self, fitted: RegressionFit) -> dict[str, float]:
        return self.noise.shift(fitted.keys, fitted.values, _log_noise(fitted))

    def negative(self) -> list[str]:
        """Which of mass, damping and stiffness lie below 0 beyond chance."""
        each = zip(LINEAR, self.linear(True).tolist(), self.linear_sigmas(True).tolist(), strict=True)
        return [name for name, value, sigma in each if value < -_SURE * sigma]


class _Forced(Regressions):
    """Rows of the equation of motion, and the laws that may explain them, with and without a name."""

    def __init__(
        self, response: RegressionResponse, laws: Sequence[RegressionTerm], nameless: Sequence[RegressionTerm]
    ) -> None:
        super().__init__([response], laws)
        self._nameless = tuple(nameless)

    def objection(
        self, null: RegressionFit, before: Sequence[Check], path: SelectionPath[RegressionTerm, RegressionModel]
    ) -> str:
        """A law without a name that the accepted ones leave room for, in words."""
        del null, before
        accepted = path.fitted
        gains = {
            term.name: self.fit((*accepted.terms, term), accepted).log_likelihood - accepted.log_likelihood
            for term in self._nameless
        }
        name = max(gains, key=lambda each: gains[each])
        return f"{name} explains more (by {gains[name]:.0f} nat)" if gains[name] > _MOST_GAIN else ""

    def plausible(self, fitted: RegressionFit) -> bool:
        """Whether no law of damping feeds energy in: one that does stands for another law."""
        damps = {QuadraticDamping.name, CoulombFriction.name} & set(fitted.keys)
        return all(fitted.value(name)[0] > 0.0 for name in damps)


def _log_noise(fitted: RegressionFit) -> float:
    return fitted.value(f"noise 0 of {FORCE}")[0]


def diagnose_forced(
    recordings: Sequence[ForcedRecording], band_hz: tuple[float, float], most: int, progress: Progress
) -> ForcedDiagnosis:
    """Judge recordings of one oscillator.

    Raises
    ------
    RecordingError
        Recordings differ in rate, a segment holds too few frequencies of the band, each has a gap, most rows are lost,
        the response is another derivative of the deflection than it says, its integral is noise, or force and response
        have opposite signs.
    """
    grids = [evenly(entry.name, entry.t_s, entry.force, entry.response, band_hz[1]) for entry in recordings]
    step_s = 1.0 / _common_rate_hz(recordings, grids)
    rows = equation_rows(recordings, grids, band_hz)
    start_s = _aligned(rows, step_s)
    refuse_integrated_noise(rows)
    delay_s = _delay(rows, start_s, step_s)
    equation = _weighted(rows, delay_s)
    outcome = diagnose(_regressions(rows, equation, delay_s, step_s), most, progress)
    diagnosis = ForcedDiagnosis(outcome, rows.recordings, equation.scale, _noise_share(rows, equation, delay_s))
    before, after = (consistent_fit(rows, delay_s or None, *diagnosis.start(extended)) for extended in (False, True))
    diagnosis = replace(diagnosis, consistent=(before, after))
    if {"mass", "stiffness"} <= set(diagnosis.negative()):
        raise RecordingError(
            "mass and stiffness come out negative: force and response have opposite signs (change the sign of one in "
            "the mapping), or the response is an acceleration (name its channel response_<what>_mps2)"
        )
    notes = [note for even in grids for note in even.notes] + _offsets(recordings)
    notes += _delayed(outcome.final, delay_s, step_s) if delay_s else []
    notes += _unfitted(rows, delay_s, trusted=after is not None) + _aliased(diagnosis, rows)
    return replace(diagnosis, notes=tuple(notes))


@dataclass(frozen=True, slots=True)
class _WeightedEquation:
    """Force (2 n,) without its delay, and columns (s, 2 n) over ``scale`` (s,).

    ``noise`` (2 n,) is the relative noise of each row, ``variance`` (2 n,) its variance over that of the response.
    """

    force: Floats
    columns: Floats
    scale: Floats
    noise: Floats
    variance: Floats


def _weighted(rows: EquationRows, delay_s: float) -> _WeightedEquation:
    force, columns = rows.force(delay_s), real_rows(rows.table[1:])
    scale = np.sqrt(np.mean(columns**2, axis=1)) / np.sqrt(np.mean(force**2))
    columns = columns / scale[:, None]
    return _WeightedEquation(force, columns, scale, *row_noise(rows, force, columns, scale))


def _regressions(rows: EquationRows, equation: _WeightedEquation, delay_s: float, step_s: float) -> _Forced:
    """The equation as a regression on mass, damping, stiffness and the rest of a delay, and laws that may join."""
    linear = tuple(
        Coefficient(name, FORCE, column, _WIDE, "", f"rms of its force over the force's, {name}")
        for name, column in zip(LINEAR, equation.columns, strict=False)
    )
    if delay_s:  # its error is one of damping
        late = rows.force_per_delay(delay_s)
        linear += (Coefficient(DELAY, FORCE, late, step_s, "s", "what is left of the delay"),)
    force, rms = equation.force, float(np.sqrt(np.mean(equation.force**2)))
    group, block, omega = np.zeros(len(force), dtype=np.int64), np.tile(rows.block, 2), np.tile(rows.omega, 2)
    bounds = (0.0, 1e-3 * rms, 0.1 * rms)
    response = RegressionResponse(
        FORCE, force, equation.noise, group, block, omega, *bounds, linear, independent_ratio=_INDEPENDENT
    )
    units = [unit for unit, _ in LAWS.values()]
    laws = [_term(*each) for each in zip(LAWS, equation.columns[3:], units, strict=True)]
    further = nameless_columns(rows)
    further *= rms / np.sqrt(np.mean(further**2, axis=1, keepdims=True))
    nameless = [_term(name, column, "") for name, column in zip(NAMELESS, further, strict=True)]
    return _Forced(response, laws, nameless)


def _term(name: str, column: Floats, unit: str) -> RegressionTerm:
    return RegressionTerm(name, "", (Coefficient(name, FORCE, column, _WIDE, "", f"rms of its force, {unit}"),))


def _noise_share(rows: EquationRows, equation: _WeightedEquation, delay_s: float) -> NoiseShare:
    """Part of the normal matrix that the response's noise makes; it has none in the delay's column."""
    omega, kind = np.tile(rows.omega, 2), np.tile(rows.kind, 2)
    added = np.pad(added_by_noise(omega, kind, rows.slopes, equation.variance, equation.scale), ((0, 1), (0, 1)))
    white = np.concatenate([equation.columns, rows.force_per_delay(delay_s)[None, :]]) / equation.noise
    return NoiseShare((*LINEAR, *LAWS, DELAY), white, added)


def _delayed(final: RegressionFit, delay_s: float, step_s: float) -> list[str]:
    """A delay that was removed, in words."""
    rest_s, sigma_s = final.value(DELAY)
    comes = "late" if delay_s > 0.0 else "early"
    return [
        f"the force comes {abs(delay_s + rest_s) * 1e3:.3f} ± {sigma_s * 1e3:.3f} ms {comes} against the response, "
        f"{abs(delay_s + rest_s) / step_s:.2f} rows: removed; look for filters or clocks that differ"
    ]


def _unfitted(rows: EquationRows, delay_s: float, *, trusted: bool) -> list[str]:
    """A large part of the force that no equation of motion explains, in words."""
    error = error_ratio(rows.table[0], rows.table[1:], rows.omega, delay_s)
    if error <= _MOST_ERROR:
        return []
    trust = "laws may be hidden" if trusted else "do not trust its coefficients"
    return [
        f"the equation leaves {100.0 * error:.0f} % of the force: the response is noise for the most part, or has "
        f"another cause; {trust}"
    ]


def _aliased(diagnosis: ForcedDiagnosis, rows: EquationRows) -> list[str]:
    """Harmonics of the accepted laws beyond half the rate, which fold back into the response."""
    accepted = {
        cause.term.name: diagnosis.coefficient(cause)[0]
        for cause in (*diagnosis.outcome.causes, *diagnosis.outcome.nearest_causes)
    }
    if not accepted:
        return []
    laws = np.array([accepted.get(name, 0.0) for name in LAWS])
    ratio = beyond_half_rate(rows, diagnosis.linear(True), laws)
    if ratio <= _MOST_ALIASED:
        return []
    half_hz = 0.5 * _common_rate_hz(rows.recordings, rows.grids)
    if diagnosis.consistent[1] is None:
        harm = "coefficients may be off by many sigmas"
    else:
        harm = "coefficients allow for that, verdict and held-out error do not"
    return [
        f"by the law {100.0 * ratio:.2g} % of the response's rms lies beyond half the rate, {half_hz:.4g} Hz, and "
        f"folds back: {harm}; record at twice the rate or more"
    ]


def _offsets(recordings: Sequence[ForcedRecording]) -> list[str]:
    """Displacements that stay so far from zero that the powers in the laws are straight lines there."""
    displaced = [entry for entry in recordings if entry.kind is ResponseKind.DISPLACEMENT]
    away = {entry.name: abs(float(np.mean(entry.response) / np.std(entry.response))) for entry in displaced}
    return [
        f"{name}: the response is {ratio:.3g} times its standard deviation from 0, where a square or a cube is a "
        "straight line: subtract its value at rest, or no law shows"
        for name, ratio in away.items()
        if ratio > _FAR_FROM_ZERO
    ]


def _common_rate_hz(recordings: Sequence[ForcedRecording], grids: Sequence[EvenRecording]) -> float:
    """Rate of all recordings.

    Raises
    ------
    RecordingError
        They differ: one delay and one noise are fitted to all, and both go by the row.
    """
    rates_hz = np.array([even.rate_hz for even in grids])
    if float(np.ptp(rates_hz)) > _SAME_RATE * float(rates_hz.max()):
        each = ", ".join(f"{entry.name} {hz:.4g} Hz" for entry, hz in zip(recordings, rates_hz.tolist(), strict=True))
        raise RecordingError(f"the recordings differ in rate: {each}; diagnose those of one rate together")
    return float(rates_hz.mean())


def _aligned(rows: EquationRows, step_s: float) -> float:
    """Delay of the force in s that fits best without weights.

    Raises
    ------
    RecordingError
        The equation fits a response of another kind far better.
    """
    start_s, error = least_error(rows.table[0], rows.table[1:], rows.omega, step_s)
    stated = rows.recordings[0].kind
    if any(entry.kind is not stated for entry in rows.recordings):
        return start_s
    source = (rows.recordings, rows.grids, rows.band_hz)
    others = {kind: equation_rows(*source, kind) for kind in ResponseKind if kind is not stated}
    errors = {kind: least_error(each.table[0], each.table[1:], each.omega, step_s)[1] for kind, each in others.items()}
    other = another_kind(stated, {stated: error, **errors})
    if other is not None:
        raise RecordingError(
            f"the response is called {stated} and fits as {other}: the error of the force is then "
            f"{100.0 * errors[other]:.0f} instead of {100.0 * error:.0f} %; "
            f"name its channel response_<what>_{other.unit}"
        )
    return start_s


def _delay(rows: EquationRows, start_s: float, step_s: float) -> float:
    """Delay in s of the force that makes the weighted equation likeliest, 0 where it gains too little."""
    if not start_s:
        return 0.0
    near = minimize_scalar(
        lambda delay_s: -_log_likelihood(rows, delay_s), bounds=(start_s - step_s, start_s + step_s), method="bounded"
    )
    gained = _INDEPENDENT * (-float(near.fun) - _log_likelihood(rows, 0.0))
    return float(near.x) if gained > _DELAY_GAIN else 0.0


def _log_likelihood(rows: EquationRows, delay_s: float) -> float:
    equation = _weighted(rows, delay_s)
    force, columns, noise = equation.force, equation.columns, equation.noise
    left = np.linalg.lstsq((columns / noise).T, force / noise, rcond=None)[0] @ columns - force
    return profile_log_likelihood(left**2, noise**2)

"""Free decays as the engine asks them: laws of frequency and damping, each begun at many places and refitted."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from companion.diagnosis.free_decay.adequacy import checks
from companion.diagnosis.free_decay.laws import Extension, Follows, Law, laws_for
from companion.diagnosis.free_decay.likelihood import FreeDecayFit, filter_all, fit_best_of
from companion.diagnosis.free_decay.model import FreeDecayModel, key_of
from companion.diagnosis.free_decay.record import FreeDecay, quiet_samples
from companion.diagnosis.selection.check import Check
from companion.diagnosis.selection.cross_validation import HeldOut, hold_out
from companion.diagnosis.selection.diagnosis import Diagnosis
from companion.diagnosis.selection.diagnosis import diagnose as diagnose_recordings
from companion.diagnosis.selection.forward_selection import ENOUGH
from companion.diagnosis.selection.normal_scores import normal_score
from companion.diagnosis.selection.recordings import (
    Cause,
    Prediction,
    Progress,
    Recordings,
    SelectionPath,
    no_correlation,
)
from companion.diagnosis.selection.score_tests import Candidate, Screening
from companion.params.airframe import Uncertain
from companion.records import Bools, Floats

_FREQUENCIES = 13  # where the first search begins, over two prior sigmas either way (choice)
_LEAKAGES = np.array([[0.0], [-1.0], [-2.0], [-3.0]])  # chosen: logarithms of factors at which leakage begins again
_DEEP = 40  # chosen: steps, at most, of a fit that decides
_QUICK = 10  # chosen: steps of a fit that ranks: enough to order, cheap enough for many
_FOLD = 4  # steps of a fit on half of the blocks, from the fit on all (choice)
_RINGS = 0.15  # a damping ratio above that is no mode (choice)
_BLOCK_S = 1.0  # chosen: length of a block, long beside a period and short beside a recording
_GUARD_S = 0.1  # chosen: left out at either edge of a fitted block, so that neighbours share no error


@dataclass(frozen=True, slots=True)
class _FittedCandidate(Candidate[Extension]):
    """A candidate with the fit by which it was ranked."""

    fitted: FreeDecayFit | None = None


@dataclass(frozen=True, slots=True)
class FreeDecayDiagnosis:
    """Outcome of a search.

    Attributes
    ----------
    outcome : Diagnosis
    errors : tuple of HeldOut
        Of the null, then after each accepted law.
    alone : dict of str to HeldOut
        Of each named frequency law alone, by what it says.
    ahead_s : float
        Time by which the acceleration was predicted ahead, one period.
    """

    outcome: Diagnosis[Extension, FreeDecayModel]
    errors: tuple[HeldOut, ...]
    alone: dict[str, HeldOut]
    ahead_s: float

    @property
    def null(self) -> FreeDecayFit:
        """One mode of constant frequency and damping."""
        return self.outcome.null

    @property
    def final(self) -> FreeDecayFit:
        """With all that was accepted."""
        return self.outcome.final

    @property
    def accepted(self) -> list[Cause[Extension]]:
        """In the order in which they were accepted."""
        causes = {cause.term.key: cause for cause in (*self.outcome.causes, *self.outcome.nearest_causes)}
        return [causes[term.key] for term in self.final.terms]


def diagnose(
    recordings: Sequence[FreeDecay],
    frequency_hz: Uncertain,
    damping: Uncertain,
    band_hz: tuple[float, float],
    most: int = 5,
    progress: Progress = lambda _what, _ratio: None,
) -> FreeDecayDiagnosis:
    """Judge recordings of one structure jointly, with what is one recording's own fitted to it alone.

    ``frequency_hz`` and ``damping`` are as believed before, ``band_hz`` is where modes may be; at most ``most``
    laws are accepted.
    """
    decays = FreeDecays(recordings, frequency_hz, damping, band_hz)
    outcome = diagnose_recordings(decays, most, progress)
    progress("hold out blocks", 0.0)
    inner = hold_out(decays, outcome.stages[1:-1])
    ends = (outcome.gain.before, outcome.gain.after) if outcome.gain is not None else ()
    laws = {
        entry.term.key: entry.fitted
        for entry in outcome.screening.candidates
        if isinstance(entry, _FittedCandidate) and entry.fitted is not None and _worth_alone(entry)
    }
    alone = dict(zip(laws, hold_out(decays, list(laws.values())), strict=True))
    return FreeDecayDiagnosis(outcome, (*ends[:1], *inner, *ends[1:]), alone, decays.ahead / recordings[0].rate_hz)


def _worth_alone(entry: Candidate[Extension]) -> bool:
    law = entry.term
    return isinstance(law, Law) and bool(law.effect) and law.follows is Follows.FREQUENCY and entry.log_odds > ENOUGH


class FreeDecays(Recordings[Extension, FreeDecayModel]):
    """Recordings of one structure that decays after impulses."""

    def __init__(
        self, recordings: Sequence[FreeDecay], frequency_hz: Uncertain, damping: Uncertain, band_hz: tuple[float, float]
    ) -> None:
        self._belief, self._band_hz = (frequency_hz, damping), band_hz
        self._all = [np.ones(len(entry.t_s), dtype=np.bool_) for entry in recordings]
        self._null = self._fit_null(recordings)
        self._recordings = self._null.state.recordings
        self._offered = laws_for(sorted(recordings[0].channels))

    @property
    def log_count(self) -> float:
        """Logarithm of how many samples there are."""
        return math.log(sum(len(entry.t_s) for entry in self._recordings))

    @property
    def ahead(self) -> int:
        """Samples in a period of the believed model's mode."""
        return max(round(self._recordings[0].rate_hz / math.exp(float(self._null.values[0]))), 1)

    def null(self) -> FreeDecayFit:
        """One mode of constant frequency and damping."""
        return self._null

    def _fit_null(self, recordings: Sequence[FreeDecay]) -> FreeDecayFit:
        model = FreeDecayModel(recordings, *self._belief)
        at, entry = model.index("log frequency"), model.parameters[0]
        offered = np.tile(model.centres, (_FREQUENCIES, 1))
        offered[:, at] = entry.centre + entry.sigma * np.linspace(-2.0, 2.0, _FREQUENCIES)
        fitted = fit_best_of(model, offered, self._all, _DEEP)
        # leakage that was fitted away while the noise was still too large has no slope by which to come back
        rows = np.tile(fitted.values, (len(_LEAKAGES) + 1, 1))
        rows[1:, [model.index(f"impulse to noise #{k}") for k in range(len(recordings))]] = _LEAKAGES
        fitted = fit_best_of(model, rows, self._all, _DEEP)
        return dataclasses.replace(fitted, state=FreeDecayModel(_followed(fitted), *self._belief))

    def fit(
        self, terms: Sequence[Extension], near: FreeDecayFit, wider: float = 1.0, quick: bool = False
    ) -> FreeDecayFit:
        """Fit with some laws from what another fit has in common with it."""
        del quick
        model = FreeDecayModel(self._recordings, *self._belief, terms, wider)
        fitted = fit_best_of(model, model.values_from(near.keys, near.values)[None, :], self._all, _DEEP)
        return self._with_its_amplitude(fitted, wider, _DEEP)

    def screen(self, fitted: FreeDecayFit, progress: Progress) -> Screening[Extension]:
        """Refit with each further law in a few steps: a frequency that moves far is not told by its score at 0."""
        remaining = [entry for entry in self._offered if entry not in fitted.terms]
        candidates = []
        for i, entry in enumerate(remaining):
            progress(f"try: {entry.key}", i / len(remaining))
            candidate = self._tried(entry, fitted)
            if candidate is not None:
                candidates.append(candidate)
        return no_correlation(candidates)

    def refit(
        self, fitted: FreeDecayFit, candidate: Candidate[Extension]
    ) -> tuple[Candidate[Extension], FreeDecayFit] | None:
        """The fit by which it was ranked."""
        del fitted
        assert isinstance(candidate, _FittedCandidate)
        return None if candidate.fitted is None else (candidate, candidate.fitted)

    def plausible(self, fitted: FreeDecayFit) -> bool:
        """Whether a second mode rings, and within the band, or what adds damping takes none away; true of all else."""
        term = fitted.terms[-1]
        if isinstance(term, Law):
            return term.follows is not Follows.ADDED_DAMPING or fitted.value(key_of(term))[0] > 0.0
        frequency_hz, zeta = (math.exp(fitted.value(f"second log {name}")[0]) for name in ("frequency", "damping"))
        return self._band_hz[0] < frequency_hz < self._band_hz[1] and zeta < _RINGS

    def checks(self, fitted: FreeDecayFit) -> list[Check]:
        """Whether the innovations are white, of the expected size, and steady."""
        return checks(fitted)

    def folds(self) -> list[Callable[[FreeDecayFit], list[Prediction]]]:
        """Two of interleaved blocks."""
        return [lambda fitted, parity=parity: self._predict(fitted, parity) for parity in range(2)]  # type: ignore[misc]

    def objection(
        self, null: FreeDecayFit, before: Sequence[Check], path: SelectionPath[Extension, FreeDecayModel]
    ) -> str:
        """Laws that only describe."""
        del null, before
        nameless = [term.key for term in path.fitted.terms if not term.effect]
        return f"left over: {'; '.join(nameless)}" if nameless else ""

    def _tried(self, entry: Extension, current: FreeDecayFit) -> _FittedCandidate | None:
        model = FreeDecayModel(self._recordings, *self._belief, (*current.terms, entry))
        start = model.values_from(current.keys, current.values)
        fitted = fit_best_of(model, _starts(entry, model, start, wide=not current.terms), self._all, _QUICK)
        fitted = self._with_its_amplitude(fitted, 1.0, _QUICK)
        if not self.plausible(fitted):
            return None
        extra = len(fitted.values) - len(current.values)
        power = max(2.0 * (fitted.log_likelihood - current.log_likelihood), 0.0)
        z = normal_score(float(chi2.logsf(power, extra))) if power else 0.0
        return _FittedCandidate(entry, z, fitted.log_evidence - current.log_evidence, fitted=fitted)

    def _with_its_amplitude(self, fitted: FreeDecayFit, wider: float, rounds: int) -> FreeDecayFit:
        """Fit again with the amplitude that its filter follows, where a law depends on it."""
        if not any(isinstance(term, Law) and term.by_amplitude for term in fitted.terms):
            return fitted
        model = FreeDecayModel(_followed(fitted), *self._belief, fitted.terms, wider)
        return fit_best_of(model, fitted.values[None, :], self._all, rounds)

    def _predict(self, fitted: FreeDecayFit, parity: int) -> list[Prediction]:
        """Fit again on every other block and predict the acceleration one period ahead on the rest.

        Impulses cannot be predicted: only samples are scored before which none came within the prediction.
        """
        inside = [_in_fold(record, parity) for record in self._recordings]
        masks = [in_fold & _clear_of_edges(record) for record, in_fold in zip(self._recordings, inside, strict=True)]
        again = fit_best_of(fitted.state, fitted.values[None, :], masks, _FOLD)
        filtered = filter_all(fitted.state, [again.values[None, :]] * len(self._recordings), self.ahead)
        predictions = []
        for record, innovations, in_fold in zip(self._recordings, filtered, inside, strict=True):
            assert innovations.ahead is not None
            e, s = innovations.innovation[0], innovations.variance[0]
            terms, error = -0.5 * (e**2 / s + np.log(s)), record.up_mps2 - innovations.ahead[0]
            block, quiet = (record.t_s // _BLOCK_S).astype(int), quiet_samples(record, self.ahead)
            for k in np.unique(block[~in_fold]):
                still = (block == k) & quiet
                predictions.append(
                    Prediction(
                        {"acceleration": float(np.sum(terms[still]))},
                        float(np.sum(error[still] ** 2)),
                        float(np.sum(record.up_mps2[still] ** 2)),
                        int(still.sum()),
                    )
                )
        return predictions


def _followed(fitted: FreeDecayFit) -> list[FreeDecay]:
    """Recordings with the first mode's amplitude as the filter follows it, over its rms in all of them."""
    recordings, values = fitted.state.recordings, fitted.values[None, :]
    amplitudes = []
    for k, filtered in enumerate(filter_all(fitted.state, [values] * len(recordings))):
        modes, rate_hz = fitted.state.modes(values, k), recordings[k].rate_hz
        omega, u, v = modes.omega_radps[0, :, 0], filtered.state[0, :, 0], filtered.state[0, :, 1]
        after = np.hypot(u / omega.mean(), v / omega)
        fading = np.exp(-modes.zeta[0, :, 0] * omega / rate_hz)
        for step in range(filtered.state.shape[2], 0, -1):  # as many samples as states pass before it is followed
            after[step - 1] = after[step] / fading[step]
        middle = np.concatenate([after[:1] / fading[:1], after[:-1]]) * np.sqrt(fading)
        # the model's sample is the mean of a step, by so much less than the recording's, which is of the middle
        amplitudes.append(middle * np.sinc(omega / math.tau / rate_hz))
    rms_m = math.sqrt(0.5 * float(np.mean(np.concatenate(amplitudes) ** 2)))
    return [
        dataclasses.replace(record, amplitude=amplitude / rms_m, rms_m=rms_m)
        for record, amplitude in zip(recordings, amplitudes, strict=True)
    ]


def _in_fold(record: FreeDecay, parity: int) -> Bools:
    return np.asarray((record.t_s // _BLOCK_S).astype(int) % 2 == parity)


def _clear_of_edges(record: FreeDecay) -> Bools:
    within = record.t_s % _BLOCK_S
    return np.asarray((within > _GUARD_S) & (within < _BLOCK_S - _GUARD_S))


def _starts(entry: Extension, model: FreeDecayModel, start: Floats, wide: bool) -> Floats:
    """Initial vectors (b, p) of a fit: with a frequency that moves far the likelihood has many local maxima."""
    rows = []
    if not isinstance(entry, Law):
        for ratio in entry.starts:
            for follow in (0.0, 1.0):
                row = start.copy()
                row[model.index("second log frequency")] = start[0] + math.log(ratio)
                row[model.index("second follow")] = follow
                row[model.index("second log participation")] = -3.0
                rows.append(row)
        return np.array(rows)
    middle = _middle(entry, model.recordings) if entry.follows is Follows.FREQUENCY else 0.0
    shifts = np.linspace(-0.3, 0.3, 9) if wide and entry.follows is Follows.FREQUENCY else [0.0]
    for shift in shifts:
        for value in entry.starts:
            row = start.copy()
            row[0] += shift - value * middle
            row[model.index(key_of(entry))] = value
            rows.append(row)
    return np.array(rows)


def _middle(law: Law, recordings: Sequence[FreeDecay]) -> float:
    """Mean of a law's basis where the energy is: there the frequency stays if it is begun with the law."""
    weights = np.concatenate([record.amplitude**2 for record in recordings])
    return float(np.average(np.concatenate([law.basis(record) for record in recordings]), weights=weights))

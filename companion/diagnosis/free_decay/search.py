"""From free decays to what their frequency follows: try every law, accept by evidence, keep what predicts."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.diagnosis.free_decay.cross_validation import PredictionError, folds, prediction_error
from companion.diagnosis.free_decay.laws import Extension, Follows, Law, laws_for
from companion.diagnosis.free_decay.likelihood import FreeDecayFit, Mask, fit
from companion.diagnosis.free_decay.model import FreeDecayModel, key_of
from companion.diagnosis.free_decay.record import FreeDecay
from companion.params.airframe import Uncertain
from companion.records import Floats

ENOUGH = 6.0
"""Log Bayes factor above which a law is accepted."""
_FREQUENCIES = 13  # where the first search begins, over two prior sigmas either way
_DEEP = 40  # steps of a fit that decides
_QUICK = 10  # steps of a fit that ranks
_RINGS = 0.15  # a damping ratio above that is no mode
Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class Tried:
    """One extension on top of what was accepted before it."""

    extension: Extension
    fitted: FreeDecayFit
    log_bayes_factor: float
    bic: float


@dataclass(frozen=True, slots=True)
class FreeDecayDiagnosis:
    """Outcome of a search.

    Attributes
    ----------
    null, final : RingingFit
    accepted : tuple of Tried
        In the order in which they were accepted.
    rounds : tuple of tuple of Tried
        All that was tried in each round, best first; the first round is against the null.
    errors : tuple of HeldOutError
        Of the null, then after each accepted extension.
    alone : dict of str to HeldOutError
        Of each frequency law alone, by what it says.
    """

    null: FreeDecayFit
    final: FreeDecayFit
    accepted: tuple[Tried, ...]
    rounds: tuple[tuple[Tried, ...], ...]
    errors: tuple[PredictionError, ...]
    alone: dict[str, PredictionError]


def search(
    recordings: Sequence[FreeDecay],
    frequency_hz: Uncertain,
    damping: Uncertain,
    band_hz: tuple[float, float],
    most: int = 5,
    progress: Progress = lambda _what, _ratio: None,
) -> FreeDecayDiagnosis:
    """Judge recordings of one structure jointly, with what is one recording's own fitted to it alone.

    ``frequency_hz`` and ``damping`` are as believed before, ``band_hz`` is where modes may be; at most ``most``
    extensions are accepted.
    """
    masks = [np.ones(len(entry.t_s), dtype=np.bool_) for entry in recordings]
    progress("fit a mode of constant frequency", 0.0)
    null = _null(FreeDecayModel(recordings, frequency_hz, damping), masks)
    offered = laws_for(sorted(recordings[0].channels))
    current, accepted, rounds = null, list[Tried](), list[tuple[Tried, ...]]()
    while len(accepted) < most:
        remaining = [entry for entry in offered if entry not in current.model.extensions]
        tried = list[Tried]()
        for i, entry in enumerate(remaining):
            progress(f"round {len(rounds) + 1}: {entry.text}", i / len(remaining))
            tried.append(_try(entry, current, masks))
        tried = sorted(
            (entry for entry in tried if _is_a_mode(entry, band_hz)), key=lambda entry: -entry.log_bayes_factor
        )
        rounds.append(tuple(tried))
        if not tried or tried[0].log_bayes_factor < ENOUGH:
            break
        deep = fit(tried[0].fitted.model, tried[0].fitted.values[None, :], masks, _DEEP)
        best = _against(tried[0].extension, deep, current)
        accepted.append(best)
        current = best.fitted
    stages = [null, *(entry.fitted for entry in accepted)]
    errors = _scored(stages, progress, "hold out blocks")
    alone = {} if not rounds else _alone(rounds[0], progress)
    return FreeDecayDiagnosis(null, current, tuple(accepted), tuple(rounds), tuple(errors), alone)


def _null(model: FreeDecayModel, masks: Sequence[Mask]) -> FreeDecayFit:
    at, entry = model.index("log frequency"), model.parameters[0]
    offered = np.tile(model.centres, (_FREQUENCIES, 1))
    offered[:, at] = entry.centre + entry.sigma * np.linspace(-2.0, 2.0, _FREQUENCIES)
    return fit(model, offered, masks, _DEEP)


def _try(entry: Extension, current: FreeDecayFit, masks: Sequence[Mask]) -> Tried:
    before = current.model
    model = FreeDecayModel(before.recordings, before.frequency_hz, before.damping, (*before.extensions, entry))
    start = model.values_from(before, current.values)
    offered = _starts(entry, model, start, wide=not before.extensions)
    return _against(entry, fit(model, offered, masks, _QUICK), current)


def _is_a_mode(tried: Tried, band_hz: tuple[float, float]) -> bool:
    """Whether a second mode rings, and within the band; true of all that is no second mode."""
    if isinstance(tried.extension, Law):
        return True
    frequency_hz, zeta = (math.exp(tried.fitted.value(f"second log {name}")[0]) for name in ("frequency", "damping"))
    return band_hz[0] < frequency_hz < band_hz[1] and zeta < _RINGS


def _starts(entry: Extension, model: FreeDecayModel, start: Floats, wide: bool) -> Floats:
    """Initial vectors (b, p) of a climb: a frequency that swings far has many small hills."""
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
    shifts = np.linspace(-0.3, 0.3, 9) if wide and entry.follows is Follows.FREQUENCY else [0.0]
    for shift in shifts:
        for value in entry.starts:
            row = start.copy()
            row[0] += shift
            row[model.index(key_of(entry))] = value
            rows.append(row)
    return np.array(rows)


def _against(entry: Extension, fitted: FreeDecayFit, current: FreeDecayFit) -> Tried:
    extra = len(fitted.values) - len(current.values)
    bic = -2.0 * (fitted.best.log_likelihood - current.best.log_likelihood) + extra * math.log(fitted.count)
    return Tried(entry, fitted, fitted.best.log_evidence - current.best.log_evidence, bic)


def _scored(stages: Sequence[FreeDecayFit], progress: Progress, what: str) -> list[PredictionError]:
    recordings = stages[0].model.recordings
    frequency_hz = math.exp(float(stages[0].values[0]))
    ahead = max(round(recordings[0].rate_hz / frequency_hz), 1)
    errors = []
    for i, stage in enumerate(stages):
        progress(what, i / len(stages))
        errors.append(prediction_error(stage, folds(recordings), ahead))
    return errors


def _alone(first: Sequence[Tried], progress: Progress) -> dict[str, PredictionError]:
    laws = [
        tried
        for tried in first
        if isinstance(tried.extension, Law)
        and tried.extension.name
        and tried.extension.follows is Follows.FREQUENCY
        and tried.log_bayes_factor > ENOUGH
    ]
    errors = _scored([tried.fitted for tried in laws], progress, "hold out blocks for each law alone") if laws else []
    return {tried.extension.text: error for tried, error in zip(laws, errors, strict=True)}

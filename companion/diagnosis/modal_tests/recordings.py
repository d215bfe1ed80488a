"""Runs of a vibration test under the engine: a mode has one frequency, or one for each value of a channel.

The frequencies f_k of run k, known to sigma_k, are a linear regression

    f_k = f + sum_l d_l [level of run k is l] + e_k,      e_k ~ N(0, sigma_k^2),

with d_l the change of a channel's further levels against its first. A term is one channel and moves every mode that
changed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effects.stiffness.covariate_frequency import CovariateFrequency
from companion.diagnosis.modal_tests.frequency_changes import (
    CHANGED_Z,
    ChangedMode,
    Channel,
    changed_modes,
    disagreement_within,
    has_changed,
)
from companion.diagnosis.modal_tests.vibration import ModeOverRuns
from companion.diagnosis.selection.check import Check
from companion.diagnosis.selection.diagnosis import Diagnosis, diagnose
from companion.diagnosis.selection.recordings import Prediction, Progress
from companion.diagnosis.selection.regression import (
    Coefficient,
    RegressionFit,
    RegressionModel,
    RegressionResponse,
    Regressions,
    RegressionTerm,
)
from companion.errors import RecordingError

ONE_RUN = "one run has nothing to be compared with"
"""Reason of a verdict on a test of a single run."""
_WIDE = 0.1  # relative prior sigma of a frequency and of its change (choice)
_NOISE_KNOWN = 1e-9  # prior sigma of the logarithm of a noise that the modal fits have measured


@dataclass(frozen=True, slots=True)
class ModalTestDiagnosis:
    """Outcome, all modes of all runs, those that changed (most first), and the tests of one frequency in all runs."""

    outcome: Diagnosis[RegressionTerm, RegressionModel]
    modes: tuple[ModeOverRuns, ...]
    changed: tuple[ChangedMode, ...]
    one_frequency: tuple[Check, ...]


class ModalTestRuns(Regressions):
    """Frequencies of all runs, and the channels that came back to a value."""

    def __init__(self, modes: Sequence[ModeOverRuns], changed: Sequence[ChangedMode]) -> None:
        self._modes, self._changed = modes, changed
        self._channels = {channel.name: channel for channel in (changed[0].channels if changed else ())}
        terms = [_term(channel, changed) for channel in self._channels.values() if channel.came_back]
        leading = [entry.mode for entry in changed]
        super().__init__(
            [_response(mode) for mode in (*leading, *(mode for mode in modes if mode not in leading))], terms
        )

    def not_identifiable(self, null: RegressionFit) -> str:
        """Channels that go hand in hand with run order, where none that came back explains the change; a single run."""
        del null
        if len(self._modes[0].runs) < 2:
            return ONE_RUN
        if not self._changed or self._changed[0].causes():
            return ""
        return " and ".join(self._changed[0].confounded())

    def checks(self, fitted: RegressionFit) -> list[Check]:
        """Agreement of each mode's frequencies in runs of equal level."""
        levels = [self._channels[term.channel].levels for term in fitted.terms] or [(0,) * len(self._modes[0].runs)]
        return [_check(mode, levels[0]) for mode in self._modes]

    def folds(self) -> list[Callable[[RegressionFit], list[Prediction]]]:
        """Each run in turn whose levels other runs have too."""
        levels = [channel.levels for channel in self._channels.values() if channel.came_back]
        repeated = [k for k in range(len(self._modes[0].runs)) if all(entry.count(entry[k]) > 1 for entry in levels)]
        return [lambda fitted, k=k: [self._predict(fitted, float(k))] for k in repeated]  # type: ignore[misc]

    def foretells(self, term: RegressionTerm) -> bool:
        """Whether any run's level was measured again."""
        del term
        return bool(self.folds())


def diagnose_modal_test(
    modes: Sequence[ModeOverRuns], constants: Sequence[Mapping[str, float]], progress: Progress
) -> ModalTestDiagnosis:
    """Judge the modes of all runs, ``constants`` being what was set in each.

    Raises
    ------
    RecordingError
        No mode stands out.
    """
    if not modes:
        raise RecordingError("no mode stands out of the responses: check 'band_hz' and the channels of the mapping")
    changed = changed_modes(modes, constants)
    runs = ModalTestRuns(modes, changed)
    outcome = diagnose(runs, 1, progress)
    return ModalTestDiagnosis(outcome, tuple(modes), tuple(changed), tuple(runs.checks(outcome.null)))


def _response(mode: ModeOverRuns) -> RegressionResponse:
    runs = np.arange(len(mode.runs))
    near_hz, alike = mode.near_hz, np.zeros(len(runs), dtype=np.int64)
    sigma_hz = _WIDE * near_hz
    return RegressionResponse(
        _label(mode),
        mode.frequency_hz,
        mode.sigma_hz,
        alike,
        runs.astype(np.float64),
        runs.astype(np.float64),
        near_hz,
        sigma_hz,
        noise=1.0,
        noise_sigma=_NOISE_KNOWN,
    )


def _term(channel: Channel, changed: Sequence[ChangedMode]) -> RegressionTerm:
    levels = np.array(channel.levels)
    coefficients = [
        Coefficient(
            f"{_label(entry.mode)} at level {level + 1} of {channel.name}",
            _label(entry.mode),
            (levels == level).astype(np.float64),
            _WIDE * entry.mode.near_hz,
            "Hz",
            f"change of the frequency against the lowest value of {channel.name}",
        )
        for entry in changed
        for level in range(1, levels.max() + 1)
    ]
    return RegressionTerm(CovariateFrequency.name, channel.name, tuple(coefficients))


def _check(mode: ModeOverRuns, levels: Sequence[int]) -> Check:
    name = f"one frequency near {mode.near_hz:.2f} Hz in all runs"
    return Check(name, disagreement_within(mode, levels), CHANGED_Z if has_changed(mode) else math.inf)


def _label(mode: ModeOverRuns) -> str:
    return f"mode near {mode.near_hz:.4f} Hz"

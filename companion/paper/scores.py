"""Scores of an experiment's shots: errors of every ranging method, blur, phase, and shots left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from companion.evaluation.metrics import rms
from companion.evaluation.true_geometry import TrueReading
from companion.paper.experiments import Outcome
from companion.paper.findings import percent
from companion.paper.shots import WAYS, ScoredShot
from companion.records import Floats, Side


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """All experiments by key, in the order of the report, and their scores at peaks and at random instants.

    ``draws`` holds, of the experiments that were repeated, the scores at peaks of the further draws by their seed.
    """

    seed: int
    outcomes: Mapping[str, Outcome]
    peaks: Mapping[str, dict[str, Any]]
    randoms: Mapping[str, dict[str, Any]]
    draws: Mapping[str, Mapping[int, dict[str, Any]]] = field(default_factory=dict)

    @classmethod
    def of(
        cls, outcomes: Sequence[Outcome], seed: int, draws: Mapping[str, Mapping[int, dict[str, Any]]] | None = None
    ) -> Results:
        """Score everything."""
        return cls(
            seed,
            {outcome.trial.key: outcome for outcome in outcomes},
            {outcome.trial.key: summary(outcome, True) for outcome in outcomes},
            {outcome.trial.key: summary(outcome, False) for outcome in outcomes},
            draws or {},
        )

    @property
    def of_paper(self) -> list[str]:
        """Keys of the experiments that the paper did."""
        return [key for key, outcome in self.outcomes.items() if outcome.trial.of_paper]

    @property
    def untried(self) -> list[str]:
        """Keys of the experiments that the paper did not do."""
        return [key for key, outcome in self.outcomes.items() if not outcome.trial.of_paper]


def summary(outcome: Outcome, planned: bool) -> dict[str, Any]:
    """Scores of the shots at peaks (``planned``), or of those at random instants."""
    shots = [shot for shot in outcome.flown.shots if shot.planned == planned]
    scores: dict[str, Any] = {
        "shots": len(shots),
        "trusted": sum(shot.reject is None for shot in shots),
        "not_trusted": dict(sorted(Counter(str(shot.reject) for shot in shots if shot.reject is not None).items())),
        "toe_rms_mrad": rms([1e3 * shot.toe_rad for shot in shots]),
        "blur_median_px": _median([shot.blur_px for shot in shots]),
        "phase_median_deg": _median([shot.phase_deg for shot in shots]),
    }
    for way in WAYS:
        scores[way] = errors(shot.all_features[way] for shot in shots)
        if any(shot.upper for shot in shots):
            scores[f"{way}_upper_third"] = errors(shot.upper.get(way) for shot in shots)
    scores["published_trusted"] = errors(shot.all_features["published"] for shot in shots if shot.reject is None)
    scores["removed"] = _removed(scores["rigid"], scores["corrected"])
    scores["removed_of_in_trim"] = _removed(scores["in_trim"], scores["corrected"])
    return scores


def errors(readings: Iterable[TrueReading | None]) -> dict[str, Any]:
    """Range errors in percent where there is a range, and in inverse range, which is finite for parallel axes too.

    ``without`` counts shots that this way gives no reading for; ``beyond_infinity`` those whose axes do not meet.
    """
    offered = list(readings)
    made = [reading for reading in offered if reading is not None]
    inverse = np.array([reading.inverse_pm for reading in made])
    true = np.array([reading.true_inverse_pm for reading in made])
    met = inverse > 0
    off_percent = 100.0 * np.abs(true[met] / inverse[met] - 1.0)
    return {
        "n": len(made),
        "without": len(offered) - len(made),
        "beyond_infinity": int(np.sum(~met)),
        "rms_percent": rms(off_percent),
        "median_percent": _median(off_percent),
        "median_range_m": _median(1.0 / inverse[met]),
        "inverse_rms_pm": rms(inverse - true),
        "inverse_mean_pm": float(np.mean(inverse - true)) if made else float("nan"),
    }


def rms_error(scores: Mapping[str, Any], digits: int = 2) -> str:
    """Rms range error of one way, as :func:`errors` has it, as a percentage of range."""
    return percent(scores["rms_percent"] / 100, digits)


def toe_error_mrad(outcome: Outcome, scores: Mapping[str, Any]) -> tuple[float, float]:
    """Mean and spread of a way's error as relative toe, ``B (1/Z_read - 1/Z)``; ``scores`` is that way's entry.

    The mean over a few seconds is the slow part (trim, tilt bias, calibration), the spread is what moves.
    """
    factor = 1e3 * outcome.baseline_m
    mean, total = factor * scores["inverse_mean_pm"], factor * scores["inverse_rms_pm"]
    return mean, float(np.sqrt(max(total**2 - mean**2, 0.0)))


def one_tip_toe_error_mrad(shots: Sequence[ScoredShot]) -> float:
    """Rms of what a correction by one tip alone, taken for symmetric, would get wrong (the paper's assumption)."""
    return rms([1e3 * (2.0 * shot.tip_rad[Side.RIGHT] - shot.toe_rad) for shot in shots])


def _median(values: Sequence[float] | Floats) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _removed(before: dict[str, Any], after: dict[str, Any]) -> float:
    """Share of the error in inverse range that is gone."""
    return 1.0 - after["inverse_rms_pm"] / before["inverse_rms_pm"] if before["inverse_rms_pm"] else float("nan")

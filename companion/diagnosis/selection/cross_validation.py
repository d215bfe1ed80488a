"""Gain of naming a cause: parameters fitted on some blocks of a recording, scored on the others.

Blocks are interleaved with guard gaps; each is scored by a model that was not fitted to it. Intervals are block
bootstraps. Scores are log likelihoods by channel; errors are the kind's own (toe, acceleration one period ahead).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from companion.diagnosis.selection.block_bootstrap import Interval, share_gone, sum_with_interval
from companion.diagnosis.selection.fisher_scoring import State
from companion.diagnosis.selection.fit import Fit
from companion.diagnosis.selection.recordings import Prediction, Recordings
from companion.diagnosis.selection.score_tests import TermT
from companion.records import Floats


class HeldOut:
    """Predictions of a model for blocks that it was not fitted to."""

    def __init__(self, blocks: Sequence[Prediction]) -> None:
        self.blocks = tuple(blocks)

    @cached_property
    def squared_error(self) -> Floats:
        """Squared error of each block, (b,)."""
        return np.array([block.squared_error for block in self.blocks])

    @property
    def rms(self) -> float:
        """Error over all blocks; 0 where nothing was predicted."""
        return float(np.sqrt(self.squared_error.sum() / max(sum(block.count for block in self.blocks), 1)))

    @property
    def share_of_signal(self) -> float:
        """Error over the signal's own rms; above 1 it is worse than predicting 0."""
        signal = sum(block.squared_signal for block in self.blocks)
        return float(np.sqrt(self.squared_error.sum() / max(signal, 1e-300)))

    def gained(self, before: HeldOut) -> dict[str, Interval]:
        """Gain in log score over another model, by channel and in ``total``."""
        names = sorted({name for block in self.blocks for name in block.log_scores})
        table = {
            name: np.array(
                [
                    new.log_scores.get(name, 0.0) - old.log_scores.get(name, 0.0)
                    for new, old in zip(self.blocks, before.blocks, strict=True)
                ]
            )
            for name in names
        }
        table["total"] = np.sum([table[name] for name in names], axis=0)
        return {name: sum_with_interval(values) for name, values in table.items()}

    def gone(self, before: HeldOut) -> Interval:
        """Relative decrease of the squared error against another model, with its 95 % interval."""
        return share_gone(before.squared_error, self.squared_error)


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """Predictions of two models for blocks that they were not fitted to.

    ``believed`` is the log prior of the nuisances with the terms, less that without them, nat.
    """

    before: HeldOut
    after: HeldOut
    believed: float

    @property
    def log_score(self) -> dict[str, Interval]:
        """Gain by channel and in total ("total") with its 95 % interval, nat."""
        return self.after.gained(self.before)

    @property
    def predicts(self) -> bool:
        """Whether held-out blocks hold numbers whose error of prediction is known."""
        return any(block.count for block in self.before.blocks)

    @property
    def improves(self) -> bool:
        """Whether the total log score, with the change of the nuisances' log prior added, is better.

        A nuisance far beyond its prior predicts as well as the effect for which it stands.
        """
        return self.log_score["total"][0] + self.believed > 0.0


def hold_out(
    recordings: Recordings[TermT, State],
    fits: Sequence[Fit[TermT, State]],
    progress: Callable[[float], None] = lambda _ratio: None,
) -> list[HeldOut]:
    """Predictions of every fit for all blocks, each from the fit repeated without that block."""
    predictions: list[list[Prediction]] = [[] for _ in fits]
    folds = recordings.folds()
    for i, fold in enumerate(folds):
        for k, fitted in enumerate(fits):
            predictions[k] += fold(fitted)
            progress((i * len(fits) + k + 1) / (len(folds) * len(fits)))
    return [HeldOut(blocks) for blocks in predictions]


def cross_validate(
    recordings: Recordings[TermT, State],
    before: Fit[TermT, State],
    after: Fit[TermT, State],
    progress: Callable[[float], None] = lambda _ratio: None,
) -> CrossValidation:
    """Fit both models without some blocks and score them on these, until every block was one of them."""
    believed = before.neg_log_prior(before.nuisances) - after.neg_log_prior(after.nuisances)
    first, second = hold_out(recordings, [before, after], progress)
    return CrossValidation(first, second, believed)

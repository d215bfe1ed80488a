"""Gain of naming a cause: parameters fitted on some blocks of a recording, scored on the others.

Blocks are interleaved with guard gaps; each is scored by the model that has not seen it. The interval is a block
bootstrap. Scores are log likelihoods, by channel; the toe's error is turned into metres of range at stated distances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import expect
from companion.diagnosis.selection.block_bootstrap import Interval, share_gone, sum_with_interval
from companion.diagnosis.selection.fit import FlightFit, fit
from companion.records import Floats

DISTANCES_M = (20.0, 60.0, 100.0)
_GUARD_S = 0.5
_BLOCK_S = 6.0
_WIDER = 5.0  # what is learnt on half of the data is theirs, not the prior's


@dataclass(frozen=True, slots=True)
class CrossValidation:
    """Scores on blocks that were not fitted.

    Attributes
    ----------
    log_score : dict of str to (float, float, float)
        Gain by channel and in total ("total"): mean per block times blocks, and its 95 % interval.
    toe_rms_rad : (float, float)
        Of the measured toe about the predicted one, before and after.
    toe_interval : (float, float)
        95 % of the share of that error's square which is gone.
    range_rms_m : dict of float to (float, float)
        The same at each distance, before and after.
    believed : float
        How much likelier the airframe's parameters are by their priors with the effects than without, in nat.
    """

    log_score: dict[str, Interval]
    toe_rms_rad: tuple[float, float] | None
    toe_interval: tuple[float, float] | None
    range_rms_m: dict[float, tuple[float, float]]
    believed: float

    @property
    def improves(self) -> bool:
        """Whether the total log score is better, beliefs included.

        An airframe parameter that has gone far beyond its prior foretells as well as the effect for which it stands.
        """
        return self.log_score["total"][0] + self.believed > 0.0


def cross_validate(
    models: Sequence[FlightModel],
    before: FlightFit,
    after: FlightFit,
    progress: Callable[[float], None] = lambda _ratio: None,
    most: int = 6,
) -> CrossValidation:
    """Fit both models on every other block and score them on the blocks between, and the other way round.

    Of a short recording there are fewer than ``most`` blocks: each must hold exposures between its guards and margins.
    """
    blocks = [
        _blocks(model, min(most, max(2, 2 * int(model.observations.duration_s / (2.0 * _BLOCK_S))))) for model in models
    ]
    scores: list[dict[str, float]] = []
    residuals: list[tuple[Floats, Floats]] = []
    for fold in range(2):
        train = [block for pieces in blocks for block in pieces[fold::2]]
        test = [block for pieces in blocks for block in pieces[1 - fold :: 2]]
        first = _again(train, before)
        progress((2 * fold + 1) / 4.0)
        second = _again(train, after)
        progress((2 * fold + 2) / 4.0)
        for block in test:
            old, new = _judge(block, first), _judge(block, second)
            scores.append({name: new[0][name] - old[0][name] for name in new[0]})
            residuals.append((old[1], new[1]))
    count = len(models[0].belief.nuisances)
    return _summary(scores, residuals, models, before.neg_log_prior(count) - after.neg_log_prior(count))


def _blocks(model: FlightModel, count: int) -> list[FlightModel]:
    observations = model.observations
    length = observations.duration_s / count
    windows = [(k * length + _GUARD_S, (k + 1) * length - _GUARD_S) for k in range(count)]
    return [
        FlightModel(model.belief, observations.window(*window), model.top_hz, model.recording) for window in windows
    ]


def _again(train: Sequence[FlightModel], fitted: FlightFit) -> FlightFit:
    return fit(train, fitted.terms, fitted.values, rounds=3, wider=_WIDER)


def _judge(block: FlightModel, fitted: FlightFit) -> tuple[dict[str, float], Floats]:
    (expectation,) = expect([block], fitted.values, fitted.terms)
    return block.log_scores(expectation), expectation.toe_residual_rad


def _summary(
    scores: Sequence[dict[str, float]],
    residuals: Sequence[tuple[Floats, Floats]],
    models: Sequence[FlightModel],
    believed: float,
) -> CrossValidation:
    names = sorted({name for entry in scores for name in entry})
    table = {name: np.array([entry.get(name, 0.0) for entry in scores]) for name in names}
    table["total"] = np.sum([table[name] for name in names], axis=0)
    gains = {name: sum_with_interval(values) for name, values in table.items()}
    squares = np.array([[float(np.sum(old**2)), float(np.sum(new**2)), len(old)] for old, new in residuals])
    if not squares[:, 2].sum():
        return CrossValidation(gains, None, None, {}, believed)
    before, after = np.sqrt(squares[:, :2].sum(0) / squares[:, 2].sum()).tolist()
    _, low, high = share_gone(squares[:, 0], squares[:, 1])
    per_rad = {d: d**2 / models[0].baseline_m for d in DISTANCES_M}
    metres = {d: (scale * before, scale * after) for d, scale in per_rad.items()}
    return CrossValidation(gains, (before, after), (low, high), metres, believed)

"""Error of the acceleration one period ahead, on blocks of which a law was not fitted.

Blocks are interleaved with guard gaps. Nobody can foresee an impulse: only samples are scored before which none came
within the prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.diagnosis.free_decay.likelihood import FreeDecayFit, Mask, filter_all, fit
from companion.diagnosis.free_decay.record import FreeDecay
from companion.diagnosis.selection.block_bootstrap import Interval, share_gone, sum_with_interval
from companion.records import Floats

_BLOCK_S = 1.0
_GUARD_S = 0.1
_QUIET = 0.02  # of the mean square above the band
_ROUNDS = 4  # steps from the fit on all blocks, which is near


@dataclass(frozen=True, slots=True)
class Fold:
    """Which samples of each recording are fitted, and which scored."""

    fitted: tuple[Mask, ...]
    scored: tuple[Mask, ...]


@dataclass(frozen=True, slots=True)
class PredictionError:
    """Error one period ahead on blocks not fitted.

    Attributes
    ----------
    rms_mps2 : float
    share : float
        Of the signal's own rms there; above 1 it is worse than foretelling nothing.
    ahead_s : float
    log_score : float
        Log likelihood of the scored samples.
    squares, powers, scores : (blocks,)
        Squared error, squared signal and log likelihood by block.
    """

    rms_mps2: float
    variance_ratio: float
    ahead_s: float
    log_score: float
    squares: Floats
    powers: Floats
    scores: Floats

    def gone(self, before: PredictionError) -> Interval:
        """Share of the squared error of ``before`` that is gone."""
        return share_gone(before.squares, self.squares)

    def gained(self, before: PredictionError) -> Interval:
        """Gain in log score over ``before``."""
        return sum_with_interval(self.scores - before.scores)


def folds(recordings: Sequence[FreeDecay]) -> list[Fold]:
    """Two folds of interleaved blocks."""
    folds_of = []
    for parity in range(2):
        fitted, scored = [], []
        for record in recordings:
            within = record.t_s % _BLOCK_S
            in_fold = (record.t_s // _BLOCK_S).astype(int) % 2 == parity
            fitted.append(in_fold & (within > _GUARD_S) & (within < _BLOCK_S - _GUARD_S))
            scored.append(~in_fold)
        folds_of.append(Fold(tuple(fitted), tuple(scored)))
    return folds_of


def prediction_error(fitted: FreeDecayFit, splits: Sequence[Fold], ahead: int) -> PredictionError:
    """Fit again on each fold and score on the rest; what is a recording's own is fitted on its fitted blocks too."""
    recordings = fitted.model.recordings
    squares, powers, scores = [], [], []
    for fold in splits:
        again = fit(fitted.model, fitted.values[None, :], fold.fitted, _ROUNDS)
        vectors = [again.values[None, :]] * len(recordings)
        for record, filtered, mask in zip(
            recordings, filter_all(fitted.model, vectors, ahead), fold.scored, strict=True
        ):
            assert filtered.ahead is not None
            still = mask & quiet_samples(record, ahead)
            e, s = filtered.innovation[0], filtered.variance[0]
            terms = -0.5 * (e**2 / s + np.log(s))
            block = (record.t_s // _BLOCK_S).astype(int)
            for k in np.unique(block[mask]):
                in_block = block == k
                error = (record.up_mps2 - filtered.ahead[0])[in_block & still]
                squares.append(float(np.sum(error**2)))
                powers.append(float(np.sum(record.up_mps2[in_block & still] ** 2)))
                scores.append(float(np.sum(terms[in_block & mask])))
    count = sum(
        int((m & quiet_samples(record, ahead)).sum())
        for p in splits
        for record, m in zip(recordings, p.scored, strict=True)
    )
    error, power = np.array(squares), np.array(powers)
    return PredictionError(
        float(np.sqrt(error.sum() / max(count, 1))),
        float(np.sqrt(error.sum() / max(power.sum(), 1e-300))),
        ahead / recordings[0].rate_hz,
        float(np.sum(scores)),
        error,
        power,
        np.array(scores),
    )


def quiet_samples(record: FreeDecay, ahead: int) -> Mask:
    """Samples before which no impulse came within ``ahead`` steps."""
    loud = record.impulse_mps2**2 > _QUIET * float(np.mean(record.impulse_mps2**2))
    near = np.convolve(loud, np.ones(ahead + 2))[: len(loud)] > 0.5
    return np.asarray(~near)

"""What a law is worth: the acceleration one period ahead, on blocks of which it was not fitted.

Blocks are interleaved with guard gaps. A knock cannot be foreseen by anybody: only samples are scored before which no
knock came within the prediction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.diagnosis.free_decay.likelihood import FreeDecayFit, Mask, filter_all, fit
from companion.diagnosis.free_decay.record import FreeDecay
from companion.records import Floats

_BLOCK_S = 1.0
_GUARD_S = 0.1
_QUIET = 0.02  # of the mean square above the band
_DRAWS = 1000
_ROUNDS = 4


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
    share: float
    ahead_s: float
    log_score: float
    squares: Floats
    powers: Floats
    scores: Floats

    def gone(self, before: PredictionError) -> tuple[float, float, float]:
        """Share of the squared error of ``before`` that is gone, and its 95 % interval over the blocks."""
        draws = np.random.default_rng(7).integers(0, len(self.squares), (_DRAWS, len(self.squares)))
        spread = 1.0 - self.squares[draws].sum(1) / before.squares[draws].sum(1)
        low, high = np.percentile(spread, [2.5, 97.5])
        return 1.0 - float(self.squares.sum() / before.squares.sum()), float(low), float(high)

    def gained(self, before: PredictionError) -> tuple[float, float, float]:
        """Gain in log score over ``before``, and its 95 % interval over the blocks."""
        each = self.scores - before.scores
        draws = np.random.default_rng(7).integers(0, len(each), (_DRAWS, len(each)))
        low, high = np.percentile(each[draws].sum(1), [2.5, 97.5])
        return float(each.sum()), float(low), float(high)


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
    """Samples before which no knock came within ``ahead`` steps."""
    loud = record.impulse_mps2**2 > _QUIET * float(np.mean(record.impulse_mps2**2))
    near = np.convolve(loud, np.ones(ahead + 2))[: len(loud)] > 0.5
    return np.asarray(~near)

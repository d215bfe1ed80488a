"""Fits a ringing model: Fisher scoring on the innovations of a filter that runs all differences at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from companion.diagnosis.free_decay.kalman import Filtered, Modes, run
from companion.diagnosis.free_decay.model import FreeDecayModel
from companion.records import Floats

Mask = npt.NDArray[np.bool_]
_STEP = 1e-4
_SHARES = (0.5, 0.2, 0.07, 0.02, 0.005)
_ENOUGH = 0.1
_LONGEST_MOVE = 2.0  # prior sigmas


@dataclass(frozen=True, slots=True)
class FreeDecayFit:
    """A fitted model.

    Attributes
    ----------
    model : RingingModel
    values, sigmas : (p,)
        Most probable, and posterior standard deviations.
    log_likelihood, log_evidence : float
        Evidence by Laplace's approximation.
    count : int
        Samples that were judged.
    """

    model: FreeDecayModel
    values: Floats
    sigmas: Floats
    log_likelihood: float
    log_evidence: float
    count: int

    def value(self, key: str) -> tuple[float, float]:
        """A parameter and its sigma."""
        at = self.model.index(key)
        return float(self.values[at]), float(self.sigmas[at])


def fit(model: FreeDecayModel, start: Floats, masks: Sequence[Mask], rounds: int = 25) -> FreeDecayFit:
    """Climb from ``start`` (p,); ``masks`` say which samples of each recording count."""
    values, centres, sigmas = start.copy(), model.centres, model.sigmas
    score, gradient, information = _scored(model, values, masks)
    for _ in range(rounds):
        move = np.linalg.solve(information, gradient)
        if float(gradient @ move) < _ENOUGH:
            break
        move *= min(1.0, _LONGEST_MOVE / float(np.max(np.abs(move / sigmas))))
        reached = _scored(model, values + move, masks)
        if not reached[0] > score:
            offered = np.stack([values + fraction * move for fraction in _SHARES])
            gained = log_likelihoods(model, offered, masks) - 0.5 * np.sum(((offered - centres) / sigmas) ** 2, 1)
            best = int(np.argmax(gained))
            if not gained[best] > score:
                break
            move, reached = _SHARES[best] * move, _scored(model, offered[best], masks)
        gained_now, score = reached[0] - score, reached[0]
        values, gradient, information = values + move, reached[1], reached[2]
        if gained_now < _ENOUGH:
            break
    _, log_det = np.linalg.slogdet(information)
    spread = np.sqrt(np.diag(np.linalg.inv(information)))
    likelihood = score + 0.5 * float(np.sum(((values - centres) / sigmas) ** 2))
    evidence = score - float(np.sum(np.log(sigmas))) - 0.5 * float(log_det)
    return FreeDecayFit(model, values, spread, likelihood, evidence, sum(int(mask.sum()) for mask in masks))


def begin(model: FreeDecayModel, offered: Floats, masks: Sequence[Mask]) -> Floats:
    """The most probable of some vectors (b, p)."""
    centres, sigmas = model.centres, model.sigmas
    scores = log_likelihoods(model, offered, masks) - 0.5 * np.sum(((offered - centres) / sigmas) ** 2, 1)
    return np.asarray(offered[int(np.nanargmax(scores))])


def log_likelihoods(model: FreeDecayModel, offered: Floats, masks: Sequence[Mask]) -> Floats:
    """Of all recordings, for each vector (b, p)."""
    filtered = filter_all(model, [offered] * len(model.recordings))
    return np.asarray(
        np.sum([_log_likelihood(recording, mask) for recording, mask in zip(filtered, masks, strict=True)], axis=0)
    )


def filter_all(model: FreeDecayModel, vectors: Sequence[Floats], ahead: int = 0) -> list[Filtered]:
    """Filter every recording under vectors (b, p) of its own, all in one sweep."""
    each = [model.modes(values, k) for k, values in enumerate(vectors)]
    longest = max(len(record.t_s) for record in model.recordings)
    # what is shorter is followed by samples that say nothing
    modes = Modes(
        np.concatenate([_longer(record.omega_radps, longest) for record in each]),
        np.concatenate([_longer(record.zeta, longest) for record in each]),
        np.concatenate([_longer(record.load, longest) for record in each]),
        np.concatenate([_longer(record.noise, longest) for record in each]),
    )
    y = [np.tile(np.pad(record.up_mps2, (0, longest - len(record.t_s))), (len(v), 1))
         for record, v in zip(model.recordings, vectors, strict=True)]  # fmt: skip
    filtered = run(modes, np.concatenate(y), 1.0 / model.recordings[0].rate_hz, ahead)
    filtered_by_recording, at = [], 0
    for record, values in zip(model.recordings, vectors, strict=True):
        rows, length = slice(at, at + len(values)), len(record.t_s)
        predicted = None if filtered.ahead is None else filtered.ahead[rows, :length]
        filtered_by_recording.append(
            Filtered(filtered.innovation[rows, :length], filtered.variance[rows, :length], predicted)
        )
        at += len(values)
    return filtered_by_recording


def _longer(values: Floats, length: int) -> Floats:
    extra = [(0, 0)] * values.ndim
    extra[1] = (0, length - values.shape[1])
    return np.pad(values, extra, mode="edge")


def _log_likelihood(filtered: Filtered, mask: Mask) -> Floats:
    terms = filtered.innovation**2 / filtered.variance + np.log(filtered.variance)
    return np.asarray(-0.5 * np.sum(terms[:, mask], axis=1))


def _scored(model: FreeDecayModel, values: Floats, masks: Sequence[Mask]) -> tuple[float, Floats, Floats]:
    """Log posterior, its gradient, and the information."""
    centres, sigmas = model.centres, model.sigmas
    moved = [_around(model, values, k) for k in range(len(model.recordings))]
    filtered = filter_all(model, moved)
    score = -0.5 * float(np.sum(((values - centres) / sigmas) ** 2))
    gradient = -(values - centres) / sigmas**2
    information = np.diag(1.0 / sigmas**2)
    for k, (recording, mask) in enumerate(zip(filtered, masks, strict=True)):
        places = [*range(model.shared), *model.own(k)]
        score += float(_log_likelihood(recording, mask)[0])
        e, s = recording.innovation[0, mask], recording.variance[0, mask]
        step = (_STEP * sigmas[places])[:, None]
        de = (recording.innovation[1:, mask] - e) / step
        ds = (recording.variance[1:, mask] - s) / step
        gradient[places] += -(de @ (e / s)) - 0.5 * (ds @ (1.0 / s - e**2 / s**2))
        information[np.ix_(places, places)] += (de / s) @ de.T + 0.5 * (ds / s**2) @ ds.T
    return score, gradient, information


def _around(model: FreeDecayModel, values: Floats, recording: int) -> Floats:
    """The vector, and it with a small step in everything that concerns a recording."""
    places = [*range(model.shared), *model.own(recording)]
    rows = np.tile(values, (len(places) + 1, 1))
    rows[range(1, len(rows)), places] += _STEP * model.sigmas[places]
    return rows

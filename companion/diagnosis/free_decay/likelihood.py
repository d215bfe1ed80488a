"""Likelihood of free decays from innovations of a filter; all difference quotients of a vector run in one sweep."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from companion.diagnosis.free_decay.kalman import Filtered, Modes, run
from companion.diagnosis.free_decay.laws import Extension
from companion.diagnosis.free_decay.model import FreeDecayModel
from companion.diagnosis.selection.fisher_scoring import NormalPrior, Parameter, Scores
from companion.diagnosis.selection.fit import Fit, climb
from companion.records import Bools, Floats

FreeDecayFit = Fit[Extension, FreeDecayModel]
_STEP = 1e-4  # of a parameter's prior sigma, for differences (numerical)


class FreeDecayLikelihood:
    """Recordings under a model; ``masks`` say which samples of each recording count."""

    def __init__(self, model: FreeDecayModel, masks: Sequence[Bools]) -> None:
        self._model, self._masks = model, masks
        self.parameters: Sequence[Parameter] = model.parameters

    def log_likelihood(self, values: Floats, near: FreeDecayModel | None = None) -> float:
        """Log likelihood of all recordings at a vector (p,)."""
        del near
        return float(self.log_likelihoods(values[None, :])[0])

    def log_likelihoods(self, offered: Floats) -> Floats:
        """Log likelihood of all recordings for each vector (b, p)."""
        filtered = filter_all(self._model, [offered] * len(self._model.recordings))
        each = [_log_likelihood(*entry) for entry in zip(filtered, self._masks, strict=True)]
        return np.asarray(np.sum(each, axis=0))

    def best_of(self, offered: Floats) -> Floats:
        """The most probable of some vectors (b, p)."""
        prior = NormalPrior(self.parameters)
        heights = self.log_likelihoods(offered) + [prior.log_density(values) for values in offered]
        return np.asarray(offered[int(np.nanargmax(heights))])

    def scores(self, values: Floats) -> Scores[FreeDecayModel]:
        """Log likelihood, gradient (p,) and information (p, p) of innovations e with variance s.

        With de, ds by a parameter: g = -sum (de e / s + ds (1 - e^2 / s) / 2s), J = sum (de de / s + ds ds / 2s^2).
        """
        model, count = self._model, len(values)
        height, gradient, information = 0.0, np.zeros(count), np.zeros((count, count))
        moved = [_around(model, values, k) for k in range(len(model.recordings))]
        for k, (filtered, mask) in enumerate(zip(filter_all(model, moved), self._masks, strict=True)):
            places = [*range(model.shared), *model.own_indices(k)]
            height += float(_log_likelihood(filtered, mask)[0])
            e, s = filtered.innovation[0, mask], filtered.variance[0, mask]
            step = (_STEP * model.sigmas[places])[:, None]
            de = (filtered.innovation[1:, mask] - e) / step
            ds = (filtered.variance[1:, mask] - s) / step
            gradient[places] += -(de @ (e / s)) - 0.5 * (ds @ (1.0 / s - e**2 / s**2))
            information[np.ix_(places, places)] += (de / s) @ de.T + 0.5 * (ds / s**2) @ ds.T
        return Scores(height, gradient, information, model)


def fit_best_of(model: FreeDecayModel, offered: Floats, masks: Sequence[Bools], rounds: int = 25) -> FreeDecayFit:
    """Climb from the most probable of some vectors (b, p); ``masks`` say which samples of each recording count."""
    likelihood = FreeDecayLikelihood(model, masks)
    return climb(likelihood, model.extensions, model.blocks(), likelihood.best_of(offered), rounds)


def filter_all(model: FreeDecayModel, vectors: Sequence[Floats], ahead: int = 0) -> list[Filtered]:
    """Filter every recording under vectors (b, p) of its own, all in one sweep."""
    each = [model.modes(values, k) for k, values in enumerate(vectors)]
    longest = max(len(record.t_s) for record in model.recordings)
    # what is shorter is followed by samples that say nothing, at its mean frequency, which is the reference of u
    modes = Modes(
        np.concatenate([_longer(record.omega_radps, longest) for record in each]),
        np.concatenate([_longer(record.zeta, longest) for record in each]),
        np.concatenate([_longer(record.load, longest) for record in each]),
        np.concatenate([_longer(record.noise, longest) for record in each]),
        np.concatenate([record.start for record in each]),
        np.concatenate([record.drift for record in each]),
    )
    y = [np.tile(np.pad(record.up_mps2, (0, longest - len(record.t_s))), (len(v), 1))
         for record, v in zip(model.recordings, vectors, strict=True)]  # fmt: skip
    rows = [len(values) for values in vectors]
    step_s = np.repeat([1.0 / record.rate_hz for record in model.recordings], rows)
    filtered = run(modes, np.concatenate(y), step_s, ahead)
    filtered_by_recording, at = [], 0
    for record, values in zip(model.recordings, vectors, strict=True):
        row, length = slice(at, at + len(values)), len(record.t_s)
        predicted = None if filtered.ahead is None else filtered.ahead[row, :length]
        filtered_by_recording.append(
            Filtered(
                filtered.innovation[row, :length],
                filtered.variance[row, :length],
                filtered.state[row, :length],
                predicted,
            )
        )
        at += len(values)
    return filtered_by_recording


def _longer(values: Floats, length: int) -> Floats:
    extra = [(0, 0)] * values.ndim
    extra[1] = (0, length - values.shape[1])
    return np.pad(values, extra, mode="mean")


def _log_likelihood(filtered: Filtered, mask: Bools) -> Floats:
    terms = filtered.innovation**2 / filtered.variance + np.log(filtered.variance)
    return np.asarray(-0.5 * np.sum(terms[:, mask], axis=1))


def _around(model: FreeDecayModel, values: Floats, recording: int) -> Floats:
    """The vector, and it with a small step in everything that concerns a recording."""
    places = [*range(model.shared), *model.own_indices(recording)]
    rows = np.tile(values, (len(places) + 1, 1))
    rows[range(1, len(rows)), places] += _STEP * model.sigmas[places]
    return rows

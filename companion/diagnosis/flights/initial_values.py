"""Initial values of a fit: levels, colours, dampings and noise that make the model's spectra as large as the data's.

The Whittle likelihood has poor maxima far from the best one: where the data lie a thousand times above the belief,
noise and damping move anywhere to make up for it. Each sensor's noise therefore begins at the floor of its spectrum,
and the rest at a regression on the logarithm of the spectra, which is nearly linear in the unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from companion.diagnosis.model.belief import is_range_only
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.linear_spectra import STATIONS
from companion.records import Floats

_CHUNK = 8  # bins of one mean: the logarithm of their mean power is near normal (choice)
_PARTS = 14  # chosen: bands of a spectrum, wide beside a mode
_STEP = 1e-3  # of a prior sigma, for a difference quotient (numerical)
_GAUSS_NEWTON_STEPS = 12  # chosen: at most; the fit goes on from there
_CLOSE = 1.6  # mean square of residuals over that by chance, below which a start is good enough (choice)
_ENOUGH = 1e-3  # gain per point, in sum of squares, below which the steps end (choice)
_MOST = 2.0  # chosen: prior sigmas in one step: no start runs away


def initial_values(models: Sequence[FlightModel]) -> list[Floats]:
    """Two vectors of nuisances (p,) from which to fit without effects; one may end in a poor maximum, hardly both."""
    believed = np.zeros(len(models[0].belief.nuisances))
    return [regressed_start(models, believed), noise_floor_start(models, believed)]


def regressed_start(models: Sequence[FlightModel], start: Floats) -> Floats:
    """Nuisances from which a fit without effects should start, (p,)."""
    belief = models[0].belief
    sigmas = belief.sigmas
    free = [i for i, entry in enumerate(belief.nuisances) if not is_range_only(entry.name)]
    measured = np.concatenate([_logarithms(_power(model)) for model in models])

    def residual(values: Floats) -> Floats:
        modelled = [np.real(np.einsum("iif->if", model.acceleration_spectrum(values))) for model in models]
        return np.asarray((measured - np.concatenate([_logarithms(power) for power in modelled])) * np.sqrt(_CHUNK))

    values = start.copy()
    deviation = residual(values)
    if not len(deviation) or np.mean(deviation**2) < _CLOSE:
        return values
    values, deviation = min(
        ((candidate, residual(candidate)) for candidate in (values, noise_floor_start(models, values))),
        key=lambda power: _penalised_squares(power[1], power[0], sigmas),
    )
    for _ in range(_GAUSS_NEWTON_STEPS):
        slopes = np.stack([(residual(_moved(values, i, sigmas)) - deviation) / (_STEP * sigmas[i]) for i in free], 1)
        better = _step(residual, values, deviation, slopes, free, sigmas)
        if better is None:
            break
        gained = _penalised_squares(deviation, values, sigmas) - _penalised_squares(better[1], better[0], sigmas)
        values, deviation = better
        if gained < _ENOUGH * len(deviation):
            break
    return values


def noise_floor_start(models: Sequence[FlightModel], start: Floats) -> Floats:
    """Nuisances (p,) of ``start`` with each sensor's noise at the lowest part of its spectrum."""
    belief, values = models[0].belief, start.copy()
    for model in models:
        edges = np.geomspace(float(model.band_hz[0]), float(model.band_hz[-1]) * 1.0001, _PARTS + 1)
        band_of = np.digitize(model.band_hz, edges)
        for side, power in zip(model.observations.sides, _power(model), strict=True):
            means = [float(power[band_of == k].mean()) for k in range(1, _PARTS + 1) if np.sum(band_of == k) > _CHUNK]
            believed = 0.5 * belief.airframe.sensor(STATIONS[side]).accel_noise_mps2_rthz ** 2
            for i, entry in enumerate(belief.nuisances):
                is_noise = entry.name == f"{side.name.lower()}.noise"
                if is_noise and entry.concerns(model.recording) and means and believed > 0.0:
                    values[i] = 0.5 * np.log(min(means) / believed)
    return values


def _step(
    residual: Callable[[Floats], Floats],
    values: Floats,
    deviation: Floats,
    slopes: Floats,
    free: list[int],
    sigmas: Floats,
) -> tuple[Floats, Floats] | None:
    """One step of damped Gauss and Newton that lowers the sum of squares with the priors; None where there is none."""
    prior = 1.0 / sigmas[free] ** 2
    normal, descent = slopes.T @ slopes + np.diag(prior), -slopes.T @ deviation - prior * values[free]
    for damping in (1e-3, 1e-1, 1.0, 10.0, 100.0):
        move = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), descent)
        candidate = values.copy()
        candidate[free] += np.clip(move, -_MOST * sigmas[free], _MOST * sigmas[free])
        try:
            after = residual(candidate)
        except (ValueError, FloatingPointError, np.linalg.LinAlgError):
            continue
        if _penalised_squares(after, candidate, sigmas) < _penalised_squares(deviation, values, sigmas):
            return candidate, after
    return None


def _penalised_squares(deviation: Floats, values: Floats, sigmas: Floats) -> float:
    return float(np.sum(deviation**2) + np.sum((values / sigmas) ** 2))


def _moved(values: Floats, i: int, sigmas: Floats) -> Floats:
    perturbed = values.copy()
    perturbed[i] += _STEP * sigmas[i]
    return perturbed


def _power(model: FlightModel) -> Floats:
    return np.asarray(np.abs(model.data_in_band()) ** 2)


def _logarithms(power: Floats) -> Floats:
    """Logarithms of means over neighbouring frequencies, all channels in one row."""
    trimmed = power[:, : power.shape[1] // _CHUNK * _CHUNK]
    return np.asarray(np.log(trimmed.reshape(len(power), -1, _CHUNK).mean(2)).ravel())

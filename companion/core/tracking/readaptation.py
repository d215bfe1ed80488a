"""Change of the filter's parameters: sensor noise, spectral fit, model and trial on what was measured, in stages."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from companion.core.kernels.arrays import Epochs
from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.model import DiscreteWingModel, WingParameters
from companion.core.tracking.rigid_body import join
from companion.core.tracking.row_noise import RowNoise
from companion.core.tracking.spread_work import Stages
from companion.core.tracking.states import SensorNoise, StateLayout
from companion.params.airframe import Wing
from companion.records import Floats

_CREDIBLE_SIGMAS = 5.0  # chosen: of the prior; a jump of the lateral force on lifting off gave a scale of 30
_LOOK_S = 1.0  # chosen: often enough for noise that is new; its median square is right to 15 %
_BLIND_S = 1.75  # derived: the first fit begins after 1.5 s, the second after 2
_SEGMENTS = 5  # chosen: of 40 ms each, late ones of up to 0.1 s; filtered in one stage


class NewParameters(NamedTuple):
    """Noise and model with which a filter may go on.

    Attributes
    ----------
    row_noise : RowNoise
    model : DiscreteWingModel
        At the parameters of the fit.
    tried : SeparatedBiasFilter or None
        Filter that has run on this model and noise; None where they changed too little.
    segments : int
        Number of the trial's segments that it has run over.
    """

    row_noise: RowNoise
    model: DiscreteWingModel
    tried: SeparatedBiasFilter | None
    segments: int


def fresh_filter(
    layout: StateLayout,
    sensors: SensorNoise,
    wing: Wing,
    keep: int,
    model: DiscreteWingModel,
    noise: RowNoise,
    linearised_at: Floats | None = None,
) -> SeparatedBiasFilter:
    """Filter at its prior, with a history of ``keep`` steps.

    Where it filters again what another has filtered, its rows are linearised at that one's bias parameters (c,), if
    the prior can believe them all.
    """
    kalman = SeparatedBiasFilter(layout, sensors, model, wing.trim_bend_m.value, wing.bend_per_g_m.value, keep)
    kalman.take_noise(noise)
    if linearised_at is not None and np.all(np.abs(linearised_at) < _CREDIBLE_SIGMAS * layout.bias_parameter_sigma):
        kalman.linearise_at(linearised_at)
    return kalman


def newest_innovations(kalman: SeparatedBiasFilter, step_s: float) -> tuple[Floats, Floats]:
    """Innovations (n, 9) of the last second and their covariance (n, 9, 9), by which noise is learned.

    None early on: by a gust that is only believed they tell of its error, and not of the sensors' noise.
    """
    count = min(kalman.steps, round(_LOOK_S / step_s), kalman.history_length)
    return kalman.innovations(count if kalman.steps * step_s >= _BLIND_S else 0, of_all=True)


def readapt(
    fit: Stages[WingParameters],
    row_noise: RowNoise,
    innovations: tuple[Floats, Floats],
    model: Callable[[WingParameters], DiscreteWingModel],
    trial: Callable[[DiscreteWingModel, RowNoise], SeparatedBiasFilter | None],
    epochs: list[Epochs],
) -> Stages[NewParameters]:
    """Learn the noise, fit the parameters, build the model and try it.

    Parameters
    ----------
    fit : generator
        Stages of the spectral fit.
    row_noise : RowNoise
        As learned until now; it stays as it is.
    innovations : (n, 9), (n, 9, 9) float64
        Innovations of the last second and their predicted covariance.
    model : callable
        Builds the model at given parameters.
    trial : callable
        Gives the filter that is to be tried, or None.
    epochs : list of Epochs
        Segments on which it is tried; those that come while it is under way are tried too, as far as time allows.

    Returns
    -------
    NewParameters
    """
    learned = copy.deepcopy(row_noise)
    learned.learn(*innovations)
    yield
    parameters = yield from fit
    yield
    new_model = model(parameters)
    learned.take_vertical(tips=parameters[1].noise_ratio, root=parameters[0].noise_ratio)
    yield
    tried, segments = trial(new_model, learned), 0
    while tried is not None and segments < len(epochs):
        tried.run(join(epochs[segments : segments + _SEGMENTS]))
        segments = min(segments + _SEGMENTS, len(epochs))
        yield
    if tried is not None:
        tried.linearise_at(None)
    return NewParameters(learned, new_model, tried, segments)

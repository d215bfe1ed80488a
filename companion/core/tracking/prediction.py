"""Prediction of the wing without measurements, for the trigger's plan."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.model import DiscreteWingModel, modal_propagation
from companion.core.tracking.rigid_body import MeasurementBuilder
from companion.core.tracking.states import StateLayout
from companion.core.tracking.streams import SampleBuffer
from companion.native.library import ARRAY, RECORD, kernel, packed
from companion.records import Floats, Ints


@dataclass(frozen=True, slots=True)
class Forecast:
    """Wing over the coming instants.

    Attributes
    ----------
    t_host_ns : (n,) int64
    q_m : (n, 2) float64
        Symmetric and antisymmetric modal coordinate, trim bend included.
    q_covariance : (n, 2, 2) float64
        With the symmetric one measured from the static bend, whose own error turns no camera.
    slope_rate_radps : (n, 2) float64
        Rate of the left and right tip slope, all modes included.
    slope_rate_covariance : (n, 2, 2) float64
    body_rate_radps : (3,) float64
        At the newest instant; it is not predicted.
    """

    t_host_ns: Ints
    q_m: Floats
    q_covariance: Floats
    slope_rate_radps: Floats
    slope_rate_covariance: Floats
    body_rate_radps: Floats


class Newest(NamedTuple):
    """Filter at the newest instant, that instant, and the body rate (3,), rad/s, measured last."""

    kalman: SeparatedBiasFilter
    t_host_ns: int
    body_rate_radps: Floats


def previewed(newest: Newest, builder: MeasurementBuilder, streams: Iterable[SampleBuffer], step_ns: int) -> Newest:
    """The same, moved on in a copy by the samples that all these streams have, which others may still overtake.

    A shot is planned better with these: the reorder window is a quarter of a 5 Hz wing's period.
    """
    reach_ns = min((stream.newest_ns or 0 for stream in streams), default=0)
    count = (reach_ns - newest.t_host_ns) // step_ns
    if count < 1:
        return newest
    epochs, kalman = builder.preview(newest.t_host_ns, step_ns, count), newest.kalman.fork(newest.kalman.model)
    kalman.run(epochs)
    reached_ns = newest.t_host_ns + count * step_ns
    return Newest(kalman, reached_ns, epochs.body_rate_radps[-1]) if kalman.finite else newest


class Forecaster:
    """Prediction of the modes through matrices that are cached while the model stays the same.

    With ``E`` the rows of the modal coordinates and rates, ``E A^k`` and ``E W_k E^T``, ``W_k`` the process noise
    summed over k steps, depend on the model alone; a forecast is then one product with the state and one with its
    covariance, for all instants together.
    """

    def __init__(self, layout: StateLayout) -> None:
        self._layout = layout
        self._modal_size = layout.antisymmetric.span.stop  # the modes and their loads come first
        self._modal_states = [index for pair in layout.pairs for index in pair]
        self._output_indices = _output_indices(layout, self._modal_states)
        self._model: DiscreteWingModel | None = None
        self._step_ns = 0
        self._transition_powers = np.empty((len(self._modal_states), 0, self._modal_size))
        self._accumulated_Q = np.empty((len(self._modal_states), len(self._modal_states), 0))
        self._slope = np.empty((2, len(self._modal_states)))

    def run(self, newest: Newest, horizon_ns: int, step_ns: int) -> Forecast:
        """Predict from the newest state in steps up to the horizon, ns; the body rate is held."""
        kalman, newest_ns, body_rate = newest
        count = max(int(horizon_ns // step_ns), 1)
        if kalman.model is not self._model or step_ns != self._step_ns or count > self._accumulated_Q.shape[2]:
            self._prepare(kalman.model, step_ns, count)
        snapshot = _FilterSnapshot(
            kalman.state_and_sensitivity, kalman.one_and_bias, kalman.covariance, kalman.bias_parameter_covariance
        )
        values, spread = run_ahead(
            self._transition_powers, self._accumulated_Q, self._slope, self._output_indices, snapshot
        )
        stamps = newest_ns + step_ns * np.arange(1, count + 1, dtype=np.int64)
        return Forecast(stamps, values[0, :count], spread[0, :count], values[1, :count], spread[1, :count], body_rate)

    def _prepare(self, model: DiscreteWingModel, step_ns: int, count: int) -> None:
        """Powers of the transition and sums of the process noise for a model and a step."""
        modal_states, modal = self._modal_states, slice(0, self._modal_size)
        if step_ns * 1e-9 == model.step_s:
            transition, noise = model.transition[modal, modal], model.noise[modal, modal]
        else:
            transition, noise = modal_propagation(self._layout, model.parameters, step_ns * 1e-9)
        self._transition_powers, self._accumulated_Q = powers(
            np.ascontiguousarray(transition), np.ascontiguousarray(noise), self._output_indices.modal_states, count
        )
        self._slope[:, ::2], self._slope[:, 1::2] = 0.0, model.slope[:, modal_states[::2]]
        self._model, self._step_ns = model, step_ns


class _FilterSnapshot(NamedTuple):
    """Filter's state, bias parameters and covariances: see ``SeparatedBiasFilter``."""

    state_and_sensitivity: Floats
    one_and_bias: Floats
    covariance: Floats
    bias_parameter_covariance: Floats


class _OutputIndices(NamedTuple):
    """Indices of the outputs: modal states (m,), the modal coordinates among these, the static bend's coordinate.

    For each uncertain slope factor: its bias parameter, the place of its mode's rate, and the sides' signs, (f, 2).
    """

    modal_states: Ints
    q: Ints
    static: int
    constant: Ints
    rate: Ints
    signs: Floats


def _output_indices(layout: StateLayout, modal_states: list[int]) -> _OutputIndices:
    """Indices of the outputs for a layout."""
    factors = [(column - 1, modal_states.index(v), sign) for column, _, v, sign in layout.slope_factors]
    constant, rate_at = (np.array([factor[k] for factor in factors], dtype=np.int64) for k in (0, 1))
    signs = np.array([factor[2] for factor in factors], dtype=np.float64).reshape(-1, 2)
    q = np.array([modal_states.index(family.q) for family in layout.families], dtype=np.int64)
    return _OutputIndices(np.array(modal_states, dtype=np.int64), q, layout.symmetric.q, constant, rate_at, signs)


_powers = kernel("forecast_powers", ARRAY, ARRAY, ARRAY, ARRAY, ARRAY)
_run = kernel("forecast_run", ARRAY, ARRAY, ARRAY, RECORD, RECORD, ARRAY, ARRAY)
_pack_indices, _pack_snapshot = packed(_OutputIndices), packed(_FilterSnapshot)


def powers(transition: Floats, noise: Floats, modal_states: Ints, count: int) -> tuple[Floats, Floats]:
    """``E A^k``, (m, count, n), and ``E W_k E^T``, (m, m, count), for the selected states ``E``."""
    m = len(modal_states)
    transition_powers, process_cov = np.empty((m, count, len(noise))), np.empty((m, m, count))
    _powers(transition, noise, modal_states, transition_powers, process_cov)
    return transition_powers, process_cov


def run_ahead(
    transition_powers: Floats, noise: Floats, slope: Floats, indices: _OutputIndices, snapshot: _FilterSnapshot
) -> tuple[Floats, Floats]:
    """Modal coordinates and slope rates at all instants, (2, k, 2), and covariances, (2, k, 2, 2).

    Modal states follow from the state by ``transition_powers`` (m, k, n), with process covariance ``noise`` (m, m, k).
    The modal coordinates' covariance is that of their deviation from the static bend.
    """
    count = transition_powers.shape[1]
    values, spread = np.empty((2, count, 2)), np.empty((2, count, 2, 2))
    _run(transition_powers, noise, slope, _pack_indices(indices), _pack_snapshot(snapshot), values, spread)
    return values, spread

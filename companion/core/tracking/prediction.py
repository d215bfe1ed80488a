"""Where the wing will be: the state run ahead with nothing but its own model, for the trigger's plan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.core.tracking.filter import Kalman
from companion.core.tracking.model import StepModel, modal_propagation
from companion.core.tracking.states import Layout
from companion.records import Floats, Ints


@dataclass(frozen=True, slots=True)
class Forecast:
    """The wing over the coming instants.

    Attributes
    ----------
    t_host_ns : (n,) int64
    q_m : (n, 2) float64
        Symmetric and antisymmetric modal coordinate, trim bend included.
    q_covariance : (n, 2, 2) float64
    slope_rate_radps : (n, 2) float64
        Rate of the left and right tip slope, all modes in it.
    slope_rate_covariance : (n, 2, 2) float64
    body_rate_radps : (3,) float64
        Of the newest instant; it is not predicted.
    """

    t_host_ns: Ints
    q_m: Floats
    q_covariance: Floats
    slope_rate_radps: Floats
    slope_rate_covariance: Floats
    body_rate_radps: Floats


class Forecaster:
    """Runs the modes ahead through matrices that are kept for as long as the model stays the same.

    With ``E`` the rows of the modal coordinates and rates, ``E A^k`` and ``E W_k E^T`` depend on the model alone; a
    forecast is then one product with the state and one with its covariance, for all instants together.
    """

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._modal = layout.antisymmetric.span.stop  # the modes and their loads come first
        self._kept = [index for pair in layout.pairs for index in pair]
        self._places = _places(layout, self._kept)
        self._model: StepModel | None = None
        self._step_ns = 0
        self._ahead = np.empty((len(self._kept), 0, self._modal))
        self._noise = np.empty((len(self._kept), len(self._kept), 0))
        self._slope = np.empty((2, len(self._kept)))

    def run(self, kalman: Kalman, newest_ns: int, body_rate: Floats, horizon_ns: int, step_ns: int) -> Forecast:
        """Predict from the newest state in steps of ``step_ns`` up to ``horizon_ns``."""
        count = max(int(horizon_ns // step_ns), 1)
        if kalman.model is not self._model or step_ns != self._step_ns or count > self._noise.shape[2]:
            self._prepare(kalman.model, step_ns, count)
        known = _Known(kalman.columns, kalman.weights, kalman.covariance, kalman.constants_covariance)
        values, spread = _run_ahead(self._ahead, self._noise, self._slope, self._places, known)
        stamps = newest_ns + step_ns * np.arange(1, count + 1, dtype=np.int64)
        return Forecast(stamps, values[0, :count], spread[0, :count], values[1, :count], spread[1, :count], body_rate)

    def _prepare(self, model: StepModel, step_ns: int, count: int) -> None:
        kept, modal = self._kept, slice(0, self._modal)
        if step_ns * 1e-9 == model.step_s:
            transition, noise = model.transition[modal, modal], model.noise[modal, modal]
        else:
            transition, noise = modal_propagation(self._layout, model.parameters, step_ns * 1e-9)
        self._ahead, self._noise = _powers(
            np.ascontiguousarray(transition), np.ascontiguousarray(noise), self._places.kept, count
        )
        self._slope[:, ::2], self._slope[:, 1::2] = 0.0, model.slope[:, kept[::2]]
        self._model, self._step_ns = model, step_ns


@compiled
def _powers(transition: Floats, noise: Floats, kept: Ints, count: int) -> tuple[Floats, Floats]:
    """``E A^k``, (m, count, n), and ``E W_k E^T``, (m, m, count), where ``E`` picks what is kept."""
    ahead, blurred = np.empty((len(kept), count, len(noise))), np.empty((len(kept), len(kept), count))
    rows, covariance = np.eye(len(noise))[kept], np.zeros_like(noise)
    for k in range(count):
        rows = rows @ transition
        covariance = transition @ covariance @ transition.T + noise
        ahead[:, k], blurred[:, :, k] = rows, covariance[kept][:, kept]
    return ahead, blurred


class _Known(NamedTuple):
    """The filter's knowledge: see :class:`companion.core.tracking.filter.Kalman`."""

    columns: Floats
    weights: Floats
    covariance: Floats
    constants_covariance: Floats


class _Places(NamedTuple):
    """Where things are: ``kept`` (m,) of the state, the modal coordinates among these, the static bend's coordinate.

    Of each uncertain slope factor: its constant, the place of its mode's rate, and the sides' signs, (f, 2).
    """

    kept: Ints
    q: Ints
    static: int
    constant: Ints
    rate: Ints
    signs: Floats


@compiled
def _run_ahead(ahead: Floats, noise: Floats, slope: Floats, places: _Places, known: _Known) -> tuple[Floats, Floats]:
    """Modal coordinates and slope rates at all instants, (2, k, 2), and covariances, (2, k, 2, 2).

    What is kept of the modes follows from the state by ``ahead`` (m, k, n), and is blurred by ``noise`` (m, m, k).
    """
    m, count, n = ahead.shape
    rest = np.zeros(n)
    rest[places.static] = known.columns[-1] @ known.weights
    deviation = known.columns[:n] @ known.weights - rest
    by_constants = np.ascontiguousarray(known.columns[:n, 1:])
    covariance = known.covariance[:n, :n] + by_constants @ known.constants_covariance @ by_constants.T
    outputs = _outputs(slope, places, known.weights)
    rows = (outputs @ ahead.reshape(m, -1)).reshape(-1, n)
    turned, moved = (rows @ covariance).reshape(4, count, n), (rows @ deviation).reshape(4, count)
    carried, every = (outputs @ noise.reshape(m, -1)).reshape(4, m, count), np.ones(n)
    rows_of, still = rows.reshape(4, count, n), outputs @ rest[places.kept]
    values, spread = np.empty((2, count, 2)), np.empty((2, count, 2, 2))
    for pair in range(2):
        for i in range(2):
            one = 2 * pair + i
            values[pair, :, i] = moved[one] + still[one]
            for j in range(i, 2):
                other = 2 * pair + j
                shared = (turned[one] * rows_of[other]) @ every + outputs[other] @ carried[one]
                spread[pair, :, i, j] = shared
                spread[pair, :, j, i] = shared
    for k in range(len(places.rate)):
        rate, at = ahead[places.rate[k]] @ deviation + rest[places.kept[places.rate[k]]], places.constant[k]
        spread[1, :, 0, 0] += known.constants_covariance[at, at] * rate**2
        spread[1, :, 1, 1] += known.constants_covariance[at, at] * rate**2
    return values, spread


@compiled
def _outputs(slope: Floats, places: _Places, weights: Floats) -> Floats:
    """Both modal coordinates, then both slope rates by the slope factors as known now, of what is kept, (4, m)."""
    outputs = np.zeros((4, slope.shape[1]))
    for side in range(2):
        outputs[side, places.q[side]] = 1.0
        outputs[2 + side] = slope[side]
        for k in range(len(places.rate)):
            outputs[2 + side, places.rate[k]] += places.signs[k, side] * weights[1 + places.constant[k]]
    return outputs


def _places(layout: Layout, kept: list[int]) -> _Places:
    found = []
    for name, family in zip(("symmetric", "antisymmetric"), layout.families, strict=True):
        for key, rate in ((f"slope.{name}", family.v), (f"slope.second_{name}", family.v2)):
            column = layout.column(key)
            if column is not None:
                found.append((column - 1, kept.index(rate), family.sign))
    constant, rate_at = (np.array([factor[k] for factor in found], dtype=np.int64) for k in (0, 1))
    signs = np.array([factor[2] for factor in found], dtype=np.float64).reshape(-1, 2)
    q = np.array([kept.index(family.q) for family in layout.families], dtype=np.int64)
    return _Places(np.array(kept, dtype=np.int64), q, layout.symmetric.q, constant, rate_at, signs)

"""Where the wing will be: the state run ahead with nothing but its own model, for the trigger's plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.mode.kalman import Kalman
from companion.core.mode.layout import Layout
from companion.core.mode.model import StepModel, modal_propagation
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
        self._q = [self._kept.index(family.q) for family in layout.families]
        self._pick = np.eye(len(self._kept))[self._q]
        self._factors = _factors(layout, self._kept)
        self._model: StepModel | None = None
        self._step_ns = 0
        self._ahead = np.empty((len(self._kept), 0, self._modal))
        self._noise = np.empty((0, len(self._kept), len(self._kept)))
        self._slope = np.empty((2, len(self._kept)))

    def run(
        self, kalman: Kalman, newest_ns: int, static_m: float, body_rate: Floats, horizon_ns: int, step_ns: int
    ) -> Forecast:
        """Predict from the newest state in steps of ``step_ns`` up to ``horizon_ns``."""
        count = max(int(horizon_ns // step_ns), 1)
        self._prepare(kalman, step_ns, count)
        rest = np.zeros(self._modal)
        rest[self._layout.symmetric.q] = static_m
        modes = (self._ahead @ (kalman.state[: self._modal] - rest)).T + rest[self._kept]
        rows = self._slope.copy()
        for column, at, sign in self._factors:
            rows[:, at] += sign * kalman.constants[column]
        spread = self._spread(np.concatenate([self._pick, rows]), kalman.covariance_of(self._modal))
        rate_cov = spread[:, 2:, 2:]
        for column, at, _ in self._factors:
            loose = kalman.constants_covariance[column, column] * modes[:, at] ** 2
            rate_cov[:, 0, 0] += loose
            rate_cov[:, 1, 1] += loose
        stamps = newest_ns + step_ns * np.arange(1, count + 1, dtype=np.int64)
        q, rate = modes[:count, self._q], modes[:count] @ rows.T
        q_cov, rate_cov = spread[:count, :2, :2], rate_cov[:count]
        return Forecast(stamps, q, np.ascontiguousarray(q_cov), rate, np.ascontiguousarray(rate_cov), body_rate)

    def _spread(self, outputs: Floats, covariance: Floats) -> Floats:
        """Covariance of these outputs (o, m) of the modal coordinates and rates at every instant, (k, o, o)."""
        m, count, n = self._ahead.shape
        o = len(outputs)
        rows = outputs @ self._ahead.reshape(m, count * n)
        turned = (rows.reshape(o * count, n) @ covariance).reshape(o, count, n)
        both = (outputs[:, None, :, None] * outputs[None, :, None, :]).reshape(o * o, m * m)
        by_load = self._noise.reshape(count, m * m) @ both.T
        spread: Floats = turned.transpose(1, 0, 2) @ rows.reshape(o, count, n).transpose(1, 2, 0)
        return spread + by_load.reshape(count, o, o)

    def _prepare(self, kalman: Kalman, step_ns: int, count: int) -> None:
        model, kept = kalman.model, self._kept
        if model is self._model and step_ns == self._step_ns and count <= len(self._noise):
            return
        transition, noise = modal_propagation(self._layout, model.parameters, step_ns * 1e-9)
        rows, places = np.eye(self._modal)[kept], np.ix_(kept, kept)
        self._ahead = np.empty((len(kept), count, self._modal))
        self._noise = np.empty((count, len(kept), len(kept)))
        covariance = np.zeros_like(noise)
        for k in range(count):
            rows = rows @ transition
            covariance = transition @ covariance @ transition.T + noise
            self._ahead[:, k], self._noise[k] = rows, covariance[places]
        self._slope[:, ::2], self._slope[:, 1::2] = 0.0, model.slope[:, kept[::2]]
        self._model, self._step_ns = model, step_ns


def _factors(layout: Layout, kept: list[int]) -> list[tuple[int, int, Floats]]:
    """Of each uncertain slope factor: its constant, the place of its mode's rate, and the sides' signs."""
    found = []
    for name, family in zip(("symmetric", "antisymmetric"), layout.families, strict=True):
        for key, rate in ((f"slope.{name}", family.v), (f"slope.second_{name}", family.v2)):
            column = layout.column(key)
            if column is not None:
                found.append((column - 1, kept.index(rate), np.array(family.sign)))
    return found

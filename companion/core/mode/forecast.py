"""Where the wing will be: the state run ahead with nothing but its own model, for the trigger's plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.mode.estimates import slope_by_factor
from companion.core.mode.kalman import Kalman
from companion.core.mode.model import StepModel, propagation
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
    """Keeps the transition over one forecast step for as long as the model stays the same."""

    def __init__(self) -> None:
        self._model: StepModel | None = None
        self._step_ns = 0
        self._transition = np.empty((0, 0))
        self._noise = np.empty((0, 0))

    def run(
        self, kalman: Kalman, newest_ns: int, static_m: float, body_rate: Floats, horizon_ns: int, step_ns: int
    ) -> Forecast:
        """Predict from the newest state in steps of ``step_ns`` up to ``horizon_ns``."""
        self._prepare(kalman, step_ns)
        layout = kalman.layout
        n, count = layout.size, max(int(horizon_ns // step_ns), 1)
        x, p = kalman.state, kalman.total_covariance
        rest = np.zeros(n)
        rest[layout.symmetric.q] = static_m
        rows = _rate_rows(kalman)
        q_index = [family.q for family in layout.families]
        q, rate = np.empty((count, 2)), np.empty((count, 2))
        q_cov, rate_cov = np.empty((count, 2, 2)), np.empty((count, 2, 2))
        a, w = self._transition, self._noise
        for k in range(count):
            x = rest + a @ (x - rest)
            p = a @ p @ a.T + w
            q[k], q_cov[k] = x[q_index], p[np.ix_(q_index, q_index)]
            rate[k] = rows @ x
            rate_cov[k] = rows @ p @ rows.T
        factor = slope_by_factor(layout, np.ones(n), "v")
        sizes = factor**2 @ np.diag(kalman.constants_covariance)
        rate_cov += (np.sqrt(sizes) / np.maximum(np.abs(rows).max(axis=1), 1e-9) * rate)[:, :, None] ** 2 * np.eye(2)
        stamps = newest_ns + step_ns * np.arange(1, count + 1, dtype=np.int64)
        return Forecast(stamps, q, q_cov, rate, rate_cov, body_rate)

    def _prepare(self, kalman: Kalman, step_ns: int) -> None:
        layout, model = kalman.layout, kalman.model
        if model is not self._model or step_ns != self._step_ns:
            self._transition, self._noise = propagation(layout, kalman.noise, model.parameters, step_ns * 1e-9)
            self._model, self._step_ns = model, step_ns


def _rate_rows(kalman: Kalman) -> Floats:
    """Tip slope rates of a state, slope factors as estimated."""
    layout, n = kalman.layout, kalman.layout.size
    rows = np.zeros((2, n))
    for family in layout.families:
        for q, v in ((family.q, family.v), (family.q2, family.v2)):
            rows[:, v] = kalman.model.slope[:, q]
    for name, family in zip(("symmetric", "antisymmetric"), layout.families, strict=True):
        for key, at in ((f"slope.{name}", family.v), (f"slope.second_{name}", family.v2)):
            column = layout.column(key)
            if column is not None:
                rows[:, at] += np.array(family.sign) * kalman.constants[column - 1]
    return rows

"""Where the wing will be: the state run ahead with nothing but its own model, for the trigger's plan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.mode.kalman import Kalman
from companion.core.mode.layout import Layout
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
    """Runs the modes ahead through matrices that are kept for as long as the model stays the same.

    With ``E`` the rows of the modal coordinates and rates, ``E A^k`` and ``E W_k E^T`` depend on the model alone; a
    forecast is then one product with the state and one with its covariance.
    """

    def __init__(self) -> None:
        self._model: StepModel | None = None
        self._step_ns = 0
        self._ahead = np.empty((0, 0, 0))
        self._noise = np.empty((0, 0, 0))

    def run(
        self, kalman: Kalman, newest_ns: int, static_m: float, body_rate: Floats, horizon_ns: int, step_ns: int
    ) -> Forecast:
        """Predict from the newest state in steps of ``step_ns`` up to ``horizon_ns``."""
        count = max(int(horizon_ns // step_ns), 1)
        self._prepare(kalman, step_ns, count)
        layout, x = kalman.layout, kalman.state
        rest = np.zeros(layout.size)
        rest[layout.symmetric.q] = static_m
        ahead, kept = self._ahead[:count], _kept(layout)
        modes = rest[kept] + ahead @ (x - rest)
        spread = ahead @ kalman.total_covariance @ ahead.transpose(0, 2, 1) + self._noise[:count]
        rows = _rate_rows(kalman)[:, kept]
        rate = modes @ rows.T
        rate_cov = rows @ spread @ rows.T
        rate_cov += _factor_variance(kalman, modes)[:, :, None] * np.eye(2)
        q_at = [kept.index(family.q) for family in layout.families]
        stamps = newest_ns + step_ns * np.arange(1, count + 1, dtype=np.int64)
        return Forecast(stamps, modes[:, q_at], spread[:, q_at][:, :, q_at], rate, rate_cov, body_rate)

    def _prepare(self, kalman: Kalman, step_ns: int, count: int) -> None:
        layout, model = kalman.layout, kalman.model
        if model is self._model and step_ns == self._step_ns and count <= len(self._ahead):
            return
        transition, noise = propagation(layout, kalman.noise, model.parameters, step_ns * 1e-9)
        rows = np.eye(layout.size)[_kept(layout)]
        self._ahead = np.empty((count, *rows.shape))
        self._noise = np.empty((count, len(rows), len(rows)))
        covariance = np.zeros_like(noise)
        for k in range(count):
            rows = rows @ transition
            covariance = transition @ covariance @ transition.T + noise
            self._ahead[k], self._noise[k] = rows, covariance[np.ix_(_kept(layout), _kept(layout))]
        self._model, self._step_ns = model, step_ns


def _kept(layout: Layout) -> list[int]:
    """The states that a forecast is about: deflection and rate of every mode."""
    return [index for pair in layout.pairs for index in pair]


def _factor_variance(kalman: Kalman, modes: Floats) -> Floats:
    """What the slope factors' uncertainty adds to the variance of the tip slope rates, (n, 2)."""
    layout = kalman.layout
    added = np.zeros((len(modes), 2))
    kept = _kept(layout)
    for name, family in zip(("symmetric", "antisymmetric"), layout.families, strict=True):
        for key, at in ((f"slope.{name}", family.v), (f"slope.second_{name}", family.v2)):
            column = layout.column(key)
            if column is not None:
                variance = kalman.constants_covariance[column - 1, column - 1]
                added += (variance * modes[:, kept.index(at)] ** 2)[:, None]
    return added


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

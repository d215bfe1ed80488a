"""The reference estimate of a truth run: deflection, slope and peaks, as well as anybody could know them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tools.reference.kalman import Filtered, filtered, smoothed
from tools.reference.observer import REFERENCE_STEP_S, Dynamics, Layout, dynamics, initial_covariance, layout_of
from tools.reference.priors import Sensitivity, constants_of
from tools.reference.spec import TruthSpec
from tools.reference.truth import SEGMENT_S
from tools.reference.views import views

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Estimate:
    """Deflection of the first modes [symmetric, antisymmetric], trim included, and slope of the tips [left, right].

    Arrays are (S, n, 2); ``symmetric_slope_sigma_rad`` (S, n) is that of the tips' mean.
    """

    q_m: Floats
    q_sigma_m: Floats
    slope_rad: Floats
    symmetric_slope_sigma_rad: Floats


class Oracle:
    """The reference filter after all the data of a run; instants are multiples of ``REFERENCE_STEP_S``."""

    def __init__(self, spec: TruthSpec, samples: tuple[Floats, Floats, Floats]) -> None:
        self.spec = spec
        self.layout = layout_of(spec)
        self.constants = constants_of(spec)
        self.first = [self.layout.q(0), self.layout.q(1)]
        data = views(spec, self.layout, samples)
        errors = Sensitivity(spec, self.layout, self.constants, data.means, data.rows)
        self.segments, self.segment_of = _segments(spec, self.layout, len(data.values))
        self.excess = data.excess
        P = initial_covariance(spec, self.layout)
        self.run: Filtered = filtered(self.segments, self.segment_of, data, P, errors)

    def causal(self, t_s: Floats) -> Estimate:
        """Estimate at ``t_s`` from the samples before it."""
        at = steps_of(t_s)
        return self._estimate(self.run.states[at], self.run.covariances[at], at)

    def smoothed(self, t_s: Floats, lag_s: float) -> Estimate:
        """Estimate at ``t_s`` from the samples up to ``lag_s`` later."""
        at, lag = steps_of(t_s), round(lag_s / REFERENCE_STEP_S)
        return self._estimate(*smoothed(self.run, at, lag), at + lag)

    def forecast(self, t_s: float, seed_index: int, count: int) -> Floats:
        """Deflections about trim (count, 2) 1, 2, ... ms after ``t_s``, from the samples before ``t_s``.

        The load factor of the last step is held.
        """
        k = int(steps_of(np.array([t_s]))[0])
        system = self.segments[self.segment_of[min(k, len(self.segment_of) - 1)]]
        push = system.fine_push * self.excess[k - 1, seed_index]
        theta = self.run.constants(k)[0][seed_index]
        x = self.run.states[k, seed_index] @ np.concatenate([[1.0], theta])
        deflections = np.empty((count, 2))
        for j in range(count):
            x = system.fine @ x + push
            deflections[j] = x[self.first]
        return deflections

    def _estimate(self, columns: Floats, covariances: Floats, told_at: Ints) -> Estimate:
        """Put state and constants together, for every instant and seed."""
        shape = columns.shape[1::-1]
        q, sigma, slope = np.empty((*shape, 2)), np.empty((*shape, 2)), np.empty((*shape, 2))
        spread = np.empty(shape)
        for i, step in enumerate(told_at):
            theta, of_theta = self.run.constants(int(step))
            for s in range(shape[0]):
                state = columns[i, s, :, 0] + columns[i, s, :, 1:] @ theta[s]
                rows, by_constants = self._rows(state, theta[s])
                by_constants += rows @ columns[i, s, :, 1:]
                P = rows @ covariances[i, s] @ rows.T + by_constants @ of_theta[s] @ by_constants.T
                trim = self.spec.trim_bend_m + self._theta("trim", theta[s])
                q[s, i] = state[self.first] + np.array([trim, 0.0])
                sigma[s, i] = np.sqrt(np.diag(P)[:2])
                slope[s, i] = self._slope(state, theta[s], trim)
                spread[s, i] = np.sqrt(P[2, 2])
        return Estimate(q, sigma, slope, spread)

    def _rows(self, state: Floats, theta: Floats) -> tuple[Floats, Floats]:
        """Derivatives of [q symmetric, q antisymmetric, mean slope of the tips] by state and by constants."""
        rows, by_constants = np.zeros((3, self.layout.size)), np.zeros((3, len(theta)))
        rows[[0, 1], self.first] = 1.0
        for i in (0, 2)[: self.layout.modes - 1]:
            factor = self.spec.modes[i].slope_radpm
            rows[2, self.layout.q(i)] = factor * (1 + self._theta(f"slope{i}", theta))
            column = self.constants.index(f"slope{i}")
            if column is not None:
                by_constants[2, column] = factor * (state[self.layout.q(i)] + (self.spec.trim_bend_m if i == 0 else 0))
        column = self.constants.index("trim")
        if column is not None:
            by_constants[0, column] = 1.0
            by_constants[2, column] = rows[2, self.first[0]]
        return rows, by_constants

    def _slope(self, state: Floats, theta: Floats, trim_m: float) -> Floats:
        slope = np.zeros(2)
        for i, mode in enumerate(self.spec.modes):
            q = state[self.layout.q(i)] + (trim_m if i == 0 else 0.0)
            sign = np.array([-1.0 if i == 1 else 1.0, 1.0])
            slope += mode.slope_radpm * (1 + self._theta(f"slope{i}", theta)) * q * sign
        return slope

    def _theta(self, name: str, theta: Floats) -> float:
        column = self.constants.index(name)
        return 0.0 if column is None else float(theta[column])


def steps_of(t_s: Floats) -> Ints:
    """Index of the step that begins at ``t_s``."""
    return np.asarray(np.round(t_s / REFERENCE_STEP_S), dtype=np.int64)


def _segments(spec: TruthSpec, layout: Layout, steps: int) -> tuple[list[Dynamics], Ints]:
    if not spec.drift_per_s:
        return [dynamics(spec, layout, 0.0)], np.zeros(steps, dtype=np.int64)
    per = round(SEGMENT_S / REFERENCE_STEP_S)
    segment_of = np.arange(steps) // per
    return [dynamics(spec, layout, i * SEGMENT_S) for i in range(int(segment_of[-1]) + 1)], segment_of

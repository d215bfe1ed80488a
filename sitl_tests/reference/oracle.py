"""The reference estimate of a truth run: deflection, slope and peaks, as well as anybody could know them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sitl_tests.reference.kalman import Filtered, filtered, smoothed
from sitl_tests.reference.observer import (
    REFERENCE_STEP_S,
    Dynamics,
    Layout,
    dynamics,
    initial_covariance,
    layout_of,
)
from sitl_tests.reference.spec import TruthSpec
from sitl_tests.reference.truth import SEGMENT_S
from sitl_tests.reference.views import views

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Estimate:
    """Deflection about trim of the first modes [symmetric, antisymmetric] and slope about trim [left, right].

    Arrays are (S, n, 2); sigmas likewise, ``symmetric_slope_sigma_rad`` (S, n) is that of the tips' mean.
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
        data = views(spec, self.layout, samples)
        self.first = [self.layout.q(0), self.layout.q(1)]
        self.segments, segment_of = _segments(spec, self.layout, len(data.values))
        self.segment_of = segment_of
        self.excess = data.excess
        P = initial_covariance(spec, self.layout)
        self.run: Filtered = filtered(self.segments, segment_of, data, P)

    def causal(self, t_s: Floats) -> Estimate:
        """Estimate at ``t_s`` from the samples before it."""
        at = steps_of(t_s)
        return self._estimate(self.run.states[at], self.run.covariances[at])

    def smoothed(self, t_s: Floats, lag_s: float) -> Estimate:
        """Estimate at ``t_s`` from the samples up to ``lag_s`` later."""
        states, covariances = smoothed(self.run, steps_of(t_s), round(lag_s / REFERENCE_STEP_S))
        return self._estimate(states, covariances)

    def forecast(self, t_s: Floats, seed_index: int, count: int) -> Floats:
        """Deflections about trim (len(t), count, 2) 1, 2, ... ms after each ``t_s``, from the samples before it.

        The load factor of the last step is held.
        """
        found = np.empty((len(t_s), count, 2))
        for i, k in enumerate(steps_of(t_s)):
            system = self.segments[self.segment_of[min(k, len(self.segment_of) - 1)]]
            push = system.fine_push * self.excess[k - 1, seed_index]
            x = self.run.states[k, seed_index, :, 0]
            for j in range(count):
                x = system.fine @ x + push
                found[i, j] = x[self.first]
        return found

    def _estimate(self, states: Floats, covariances: Floats) -> Estimate:
        at = self.first
        q = states[:, :, at, 0].swapaxes(0, 1)
        variance = np.stack([covariances[:, :, i, i] for i in at], axis=-1)
        row = np.zeros((2, self.layout.size))
        for i, mode in enumerate(self.spec.modes):
            row[:, self.layout.q(i)] = mode.slope_radpm * np.array([-1.0 if i == 1 else 1.0, 1.0])
        slope = np.einsum("tn,ksn->skt", row, states[..., 0])
        even = row.mean(axis=0)
        spread = np.sqrt(np.einsum("n,ksnm,m->sk", even, covariances, even))
        return Estimate(q, np.sqrt(variance.swapaxes(0, 1)), slope, spread)


def steps_of(t_s: Floats) -> Ints:
    """Index of the step that begins at ``t_s``."""
    return np.asarray(np.round(t_s / REFERENCE_STEP_S), dtype=np.int64)


def _segments(spec: TruthSpec, layout: Layout, steps: int) -> tuple[list[Dynamics], Ints]:
    if not spec.drift_per_s:
        return [dynamics(spec, layout, 0.0)], np.zeros(steps, dtype=np.int64)
    per = round(SEGMENT_S / REFERENCE_STEP_S)
    segment_of = np.arange(steps) // per
    return [dynamics(spec, layout, i * SEGMENT_S) for i in range(int(segment_of[-1]) + 1)], segment_of

"""The filter: one fused step per cell, for the state and its sensitivity to every constant at once.

With ``x1 = A x0 + b u + w`` and ``z = H1 x1 + H0 x0 + D c + e``, put ``G = H1 A + H0``, ``C = A P G^T + Q H1^T`` and
``S = G P G^T + H1 Q H1^T + R``. Then ``K = C S^-1``, ``x1 = A x0 + b u + K (z - G x0)``, ``P1 = A P A^T + Q - K
C^T``: exact for noise that is in the process and in the measurement alike. Column 0 of ``X`` is the state if all
constants were zero, the others are its derivative by each constant: the same linear filter, run on ``-D`` (Friedland
1969). What the innovations say about the constants is summed in information form and solved a few times a second.
"""

from __future__ import annotations

import copy
from collections.abc import Collection

import numpy as np

from companion.core.kernels import filter_loops as kernel_loops
from companion.core.kernels import filter_numpy as kernel_numpy
from companion.core.kernels.arrays import Data, Fixed, Memory, Step, make_history
from companion.core.kernels.compiled import COMPILED, compiled
from companion.core.tracking.error_jacobians import own_scales
from companion.core.tracking.model import Parameters, StepModel, stationary
from companion.core.tracking.rigid_body import Cells
from companion.core.tracking.states import P_LEFT, ROOT_ERRORS, ROWS, SENSOR_ERRORS, Y_LEFT, Z_LEFT, Layout, Noise
from companion.records import Floats, Ints

kernel = kernel_loops if COMPILED else kernel_numpy
_SOLVE_EVERY = 25
# The root's own errors stay at their priors (Schmidt's consider states): its filtered, unevenly sent samples have noise
# that is not white, and what that would teach about its scale is wrong. The biases of its rates are learned.
_CONSIDERED = frozenset(f"root.{error}" for error in SENSOR_ERRORS)
_WANDERING = tuple(f"root.{error}" for error in ROOT_ERRORS)  # what was learned of them ages


class Kalman:
    """State, covariance and constants; see the module's equations.

    Attributes
    ----------
    columns : (n + 1, 1 + c) float64
        ``[x | dx/dc]``; the last row is the static bend over the coming step.
    covariance : (n, n) float64
        Of the state, given the constants.
    constants : (c,) float64
    constants_covariance : (c, c) float64
    steps : int
        Steps done.
    finite : bool
        False once the numbers have run away: only a fresh filter helps.
    """

    def __init__(
        self, layout: Layout, noise: Noise, model: StepModel, trim_m: float, bend_per_g_m: float, keep: int
    ) -> None:
        self.layout, self.noise, self.model = layout, noise, model
        n, c = layout.size, len(layout.constants)
        self.columns = np.zeros((n + 1, 1 + c))
        self.columns[layout.symmetric.q, 0] = trim_m
        self._bend_per_g_m, self._bend = bend_per_g_m, layout.column("bend_per_g")
        if (trim := layout.column("trim")) is not None:
            self.columns[layout.symmetric.q, trim] = 1.0
        self.covariance = stationary(layout, noise, model)
        self.constants = np.zeros(c)
        self.constants_covariance = np.diag(layout.constant_sigma**2)
        self._prior = np.diag(1.0 / layout.constant_sigma**2)
        estimated = np.array([name not in _CONSIDERED for name in layout.constants], dtype=bool)
        self._estimated, self._considered = np.flatnonzero(estimated), np.flatnonzero(~estimated)
        wandering = [column for name in _WANDERING if (column := layout.column(name)) is not None]
        self._wandering = np.array(wandering, np.int64)
        self._retained = float(np.exp(-_SOLVE_EVERY * model.step_s / noise.bias_time_s))
        self._weights = np.concatenate([[1.0], self.constants])
        self._unsolved = self.steps = 0
        self.finite = True
        self._memory = Memory(self.columns, self.covariance, np.zeros((1 + c, 1 + c)), self._weights, np.zeros(2))
        self.history = make_history(keep, n, c, ROWS)
        self._fixed = _fixed(layout, noise, model.step_s, trim_m, bend_per_g_m)
        self.use(model)

    def fork(self, model: StepModel) -> Kalman:
        """Another filter that knows what this one knows and goes on with ``model``; it remembers a single step."""
        other = copy.copy(self)
        other.columns, other.covariance = self.columns.copy(), self.covariance.copy()
        other.constants, other.constants_covariance = self.constants.copy(), self.constants_covariance.copy()
        other._weights = self._weights.copy()
        gathered = self._memory.information.copy()
        other._memory = Memory(other.columns, other.covariance, gathered, other._weights, np.zeros(2))
        other.history = make_history(1, self.layout.size, len(self.constants), ROWS)
        other.steps = 0
        if model is not self.model:
            other.use(model)
        else:
            other._step = self._step._replace(number=other._kept_motion(self._step.motion))
        return other

    def reopen(self, names: Collection[str]) -> None:
        """Forget what is known of some constants: from here on they are others, as uncertain as in the beginning.

        What the state owes to the old ones stays in it, with their uncertainty: they are integrated out.
        """
        self._solve()
        for name in names:
            column = self.layout.column(name)
            if column is not None and name not in _CONSIDERED:
                self._integrate_out(column)
        self._solve()

    def _integrate_out(self, column: int) -> None:
        gathered = self._memory.information
        rest = np.flatnonzero(np.arange(len(gathered)) != column)
        strength = gathered[column, column] + self._prior[column - 1, column - 1]
        shares = gathered[column, rest] / strength  # with minus sign: how the constant follows from the rest
        gathered[np.ix_(rest, rest)] -= strength * np.outer(shares, shares)
        gathered[column, :], gathered[:, column] = 0.0, 0.0
        owed = self.columns[:-1, column].copy()
        self.columns[:-1, rest] -= np.outer(owed, shares)
        self.covariance += np.outer(owed, owed) / strength
        self.columns[:, column] = 0.0

    @property
    def kept(self) -> int:
        """How many steps the history holds at most."""
        return len(self.history.state)

    @property
    def state(self) -> Floats:
        """The best estimate of the state, (n,)."""
        state: Floats = self.columns[:-1] @ self._weights
        return state

    @property
    def weights(self) -> Floats:
        """One and the constants: what the columns are summed with, (1 + c,)."""
        return self._weights

    @property
    def static_m(self) -> float:
        """Static bend over the newest step, constants included."""
        return float(self.columns[-1] @ self._weights)

    @property
    def bend_per_g_m(self) -> float:
        """Bend per g as known by now."""
        return self._bend_per_g_m + (float(self.constants[self._bend - 1]) if self._bend is not None else 0.0)

    @property
    def total_covariance(self) -> Floats:
        """Covariance of the state with that of the constants folded in."""
        v = self.columns[:-1, 1:]
        total: Floats = self.covariance + v @ self.constants_covariance @ v.T
        return total

    @property
    def swing_covariance(self) -> Floats:
        """The same with the symmetric deflection counted from the static bend: what is unknown of this is no swing."""
        v = self.columns[:-1, 1:].copy()
        v[self.layout.symmetric.q] -= self.columns[-1, 1:]
        total: Floats = self.covariance + v @ self.constants_covariance @ v.T
        return total

    @property
    def surprise(self) -> float:
        """Mean square of the last second's normalised innovations, steps bounded: one where the model is right."""
        square, count = self._memory.surprise
        return float(square / count) if count > 0.0 else 1.0

    def excess(self, count: int) -> Floats:
        """What of the newest ``count`` steps' rows teaches nothing, (count, 9): see the history."""
        excess: Floats = self.history.excess[np.arange(self.steps - count, self.steps) % self.kept]
        return excess

    def run(self, cells: Cells) -> None:
        """Take a run of cells."""
        data = Data(
            cells.rows,
            cells.present,
            cells.vertical,
            cells.lateral,
            cells.tilted,
            cells.lateral_gain,
            cells.load,
            cells.sensitivity,
            cells.cut,
            cells.shaken,
        )
        first = 0
        while first < len(cells) and self.finite:
            last = min(len(cells), first + _SOLVE_EVERY - self._unsolved)
            self.finite = kernel.run_cells(
                self._fixed, self._step, data, self._memory, self.history, first, last, self.steps
            )
            self.steps += last - first
            self._unsolved += last - first
            if self._unsolved >= _SOLVE_EVERY:
                self._solve()
                self._age()
            first = last

    def use(self, model: StepModel) -> None:
        """Go on with another model of the same wing."""
        if model is not self.model:
            self._keep_acceleration(model.parameters)
        self.model = model
        n = self.layout.size
        ahead, now = model.transition, np.eye(n, n + 1)
        middle, rate = 0.5 * (now + ahead), (ahead - now) / model.step_s
        watch = [model.slope @ middle, model.slope @ rate]
        for _, q, sign in _slope_terms(self.layout):
            for side, turn in ((0, 1.0), (1, -1.0)):
                watch += [-sign[side] * middle[q : q + 1], -turn * sign[side] * rate[q : q + 1]]
        motion = np.ascontiguousarray(model.transition[:, :n])
        to, of = (np.ascontiguousarray(index) for index in np.nonzero(motion))
        self._step = Step(
            motion=motion,
            static=np.ascontiguousarray(model.transition[:, n]),
            to=to,
            of=of,
            share=motion[to, of],
            number=self._kept_motion(motion),
            sense=np.ascontiguousarray(model.sense),
            noise=np.ascontiguousarray(model.noise),
            cross=np.ascontiguousarray(model.cross.T),
            measured=np.ascontiguousarray(model.measured),
            watch=np.ascontiguousarray(np.concatenate(watch)),
            cut=model.cut,
            rough=model.rough,
        )

    def _kept_motion(self, motion: Floats) -> int:
        """Put a motion where the history has it for its steps; give its number."""
        kept = self.history.transition
        free = np.setdiff1d(np.arange(len(kept)), self.history.by)
        if not len(free):
            self.history = self.history._replace(transition=np.concatenate([kept, np.empty_like(kept)]))
            return self._kept_motion(motion)
        self.history.transition[free[0]] = motion
        return int(free[0])

    def _keep_acceleration(self, parameters: Parameters) -> None:
        """Give the loads what other springs and dampers take from the tips.

        What is known well is the acceleration, load less spring, and hardly the slow bend. Were the load kept, the
        difference between two stiffnesses would pass for a measurement of the bend.
        """
        n, turn = self.layout.size, np.eye(self.layout.size + 1)
        for family, old, new in zip(self.layout.families, self.model.parameters, parameters, strict=True):
            corner = 2.0 * np.pi * new.corner_2_hz
            for q, before, after in (
                (family.q, (old.frequency_hz, old.damping), (new.frequency_hz, new.damping)),
                (family.q2, (old.frequency_2_hz, old.damping_2), (new.frequency_2_hz, new.damping_2)),
            ):
                stiffer = 4.0 * np.pi**2 * (after[0] ** 2 - before[0] ** 2)
                damped = 4.0 * np.pi * (after[0] * after[1] - before[0] * before[1])
                turn[q + 2, q : q + 2] += stiffer, damped + stiffer / corner
                turn[q + 3, q : q + 2] += stiffer, damped
                if q == self.layout.symmetric.q:
                    turn[q + 2 : q + 4, n] -= stiffer
        state = turn[:n, :n]
        self.columns[:] = turn @ self.columns
        self.covariance[:] = state @ self.covariance @ state.T
        if self.steps:  # the smoother comes back this way
            at = (self.steps - 1) % self.kept
            turned = state @ self.history.transition[self.history.by[at]]
            self.history.by[at] = self._kept_motion(turned)
            self.history.drawn[at] = self.history.drawn[at] @ state.T

    def _age(self) -> None:
        sigma = self.layout.constant_sigma
        _wander(self._memory.information, self.columns, self.covariance, self._wandering, sigma, self._retained)

    def _solve(self) -> None:
        self._unsolved = 0
        if not len(self.constants):
            return
        _solve_constants(
            self._memory.information,
            self.layout.constant_sigma,
            self._estimated,
            self._considered,
            self.constants,
            self.constants_covariance,
        )
        self._weights[1:] = self.constants


@compiled
def _wander(gathered: Floats, columns: Floats, covariance: Floats, those: Ints, sigma: Floats, r: float) -> None:
    """Let what wanders have wandered since the last solution: of old it was ``r`` times the new, and some noise.

    The noise is integrated out of what was gathered; what the state owes to it becomes the state's own variance.
    """
    for column in those:
        noise = (1.0 - r * r) * sigma[column - 1] ** 2
        known, owed = gathered[column].copy(), columns[:-1, column].copy()
        gain = noise / (1.0 + noise * known[column])
        columns[:-1] -= gain * np.outer(owed, known)
        covariance += gain * np.outer(owed, owed)
        gathered -= gain * np.outer(known, known)
        gathered[column, :] *= r
        gathered[:, column] *= r
        columns[:-1, column] *= r


@compiled
def _solve_constants(
    gathered: Floats, sigma: Floats, known: Ints, left: Ints, constants: Floats, covariance: Floats
) -> None:
    """The constants and their covariance from what was gathered, in place; ``left`` are those that stay as they are."""
    information = gathered[known + 1][:, known + 1] + np.diag(1.0 / sigma[known] ** 2)
    inner = np.linalg.inv(information)
    inner = 0.5 * (inner + inner.T)
    turned = -inner @ gathered[known + 1][:, left + 1]
    loose = turned * sigma[left] ** 2
    outer = inner + loose @ turned.T
    constants[known] = -inner @ np.ascontiguousarray(gathered[known + 1, 0])
    for i in range(len(known)):
        for j in range(len(known)):
            covariance[known[i], known[j]] = outer[i, j]
        for j in range(len(left)):
            covariance[known[i], left[j]] = loose[i, j]
            covariance[left[j], known[i]] = loose[i, j]


def _fixed(layout: Layout, noise: Noise, step_s: float, trim_m: float, bend_per_g_m: float) -> Fixed:
    biases = dict(layout.bias)
    factors = [
        (row + side, column) for column, _, _ in _slope_terms(layout) for side in (0, 1) for row in (Y_LEFT, P_LEFT)
    ]
    own = own_scales(layout)
    return Fixed(
        step_s=step_s,
        trim_m=trim_m,
        bend_per_g_m=bend_per_g_m,
        root_z=noise.root_z,
        root_y=noise.root_y,
        trim=layout.column("trim") or 0,
        bend=layout.column("bend_per_g") or 0,
        own=noise.own,
        lateral_bias=np.array([biases.get(Y_LEFT + side, -1) for side in (0, 1)], np.int64),
        leaning=np.array([layout.column(f"{place}.mx") or 0 for place in ("left", "right")], np.int64),
        vertical_bias=np.array([biases.get(Z_LEFT + side, -1) for side in (0, 1)], np.int64),
        own_bias=noise.own_bias,
        force_bias=layout.column("bz") or 0,
        factor_rows=np.array([row for row, _ in factors], np.int64),
        factor_columns=np.array([column for _, column in factors], np.int64),
        own_rows=np.array([row for row, _, _ in own], np.int64),
        own_columns=np.array([column for _, column, _ in own], np.int64),
        own_signs=np.array([sign for _, _, sign in own], np.float64),
    )


def _slope_terms(layout: Layout) -> list[tuple[int, int, tuple[float, float]]]:
    terms = []
    for name, family in zip(("symmetric", "antisymmetric"), layout.families, strict=True):
        for key, q in ((f"slope.{name}", family.q), (f"slope.second_{name}", family.q2)):
            column = layout.column(key)
            if column is not None:
                terms.append((column, q, family.sign))
    return terms

"""The filter: one fused step per cell, for the state and its sensitivity to every constant at once.

With ``x1 = A x0 + b u + w`` and ``z = H1 x1 + H0 x0 + D c + e``, put ``G = H1 A + H0``, ``C = A P G^T + Q H1^T`` and
``S = G P G^T + H1 Q H1^T + R``. Then ``K = C S^-1``, ``x1 = A x0 + b u + K (z - G x0)``, ``P1 = A P A^T + Q - K
C^T``: exact for noise that is in the process and in the measurement alike. Column 0 of ``X`` is the state if all
constants were zero, the others are its derivative by each constant: the same linear filter, run on ``-D`` (Friedland
1969). What the innovations say about the constants is summed in information form and solved a few times a second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from companion.core.mode.layout import M_LEFT, P_LEFT, ROWS, Y_LEFT, Z_LEFT, Layout, Noise
from companion.core.mode.model import StepModel
from companion.core.mode.rigid import Cells
from companion.core.mode.sensitivity import own_scales
from companion.records import Floats, Ints

_SOLVE_EVERY = 25
_LOAD_TIME_S = 0.1
# The root's own errors stay at their priors (Schmidt's consider states): its filtered, unevenly sent samples have noise
# that is not white, and what that would teach about its scale is wrong.
_CONSIDERED = "root."
_EYE = np.eye(ROWS)
_POWERS = 1 << np.arange(ROWS)


@dataclass(slots=True)
class History:
    """What the smoother needs of each step, in rings of ``size``; slot ``k % size`` is step ``k``.

    ``weighted`` is ``G^T S^-1``. Only the rows that were present are filled; ``weighted`` and ``gain`` are zero for
    the rest.
    """

    size: int
    transition: list[Floats]
    sense: Floats
    gain: Floats
    weighted: Floats
    innovation: Floats
    state: Floats
    covariance: Floats
    static_m: Floats


@dataclass(frozen=True, slots=True)
class _View:
    """What a pattern of present rows leaves of the model; ``lateral`` lists (row, bias state, side) of the slope
    rows, ``vertical`` (row, side) of the vertical means.

    ``own`` are rows, columns and signs of the sensitivities that are to be taken at the prediction instead of at the
    measurement, which holds the innovation itself.
    """

    rows: Ints
    square: tuple[Ints, ...]
    sense: Floats
    cross: Floats
    measured: Floats
    lateral: list[tuple[int, int, int]]
    vertical: list[tuple[int, int]]
    own: tuple[Ints, Ints, Floats]


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
    """

    def __init__(
        self, layout: Layout, noise: Noise, model: StepModel, trim_m: float, bend_per_g_m: float, keep: int
    ) -> None:
        self.layout, self.noise, self.model = layout, noise, model
        self._trim_m, self._bend_per_g_m = trim_m, bend_per_g_m
        n, c = layout.size, len(layout.constants)
        self.columns = np.zeros((n + 1, 1 + c))
        self.columns[layout.symmetric.q, 0] = trim_m
        self._trim, self._bend = layout.column("trim"), layout.column("bend_per_g")
        if self._trim is not None:
            self.columns[layout.symmetric.q, self._trim] = 1.0
        self.covariance = model.stationary.copy()
        self.constants = np.zeros(c)
        self.constants_covariance = np.diag(layout.constant_sigma**2)
        self._information = np.zeros((1 + c, 1 + c))
        self._prior = np.diag(1.0 / layout.constant_sigma**2)
        self._sigma = layout.constant_sigma
        estimated = np.array([not name.startswith(_CONSIDERED) for name in layout.constants], dtype=bool)
        self._estimated, self._considered = np.flatnonzero(estimated), np.flatnonzero(~estimated)
        self._unsolved = 0
        self._weights = np.concatenate([[1.0], self.constants])
        self.steps = 0
        self.history = History(
            keep,
            [model.transition] * keep,
            np.zeros((keep, ROWS, n)),
            np.zeros((keep, n, ROWS)),
            np.zeros((keep, n, ROWS)),
            np.zeros((keep, ROWS, 1 + c)),
            np.zeros((keep, n, 1 + c)),
            np.zeros((keep, n, n)),
            np.zeros((keep, 1 + c)),
        )
        self._views: dict[int, _View] = {}
        self.use(model)

    @property
    def state(self) -> Floats:
        """The best estimate of the state, (n,)."""
        state: Floats = self.columns[:-1] @ self._weights
        return state

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

    def run(self, cells: Cells) -> None:
        """Take a run of cells."""
        if not len(cells):
            return
        sensor = self._sensor_noise(cells)
        data = np.concatenate([cells.rows[:, :, None], -cells.sensitivity], axis=2)
        patterns = cells.present @ _POWERS
        for k in range(len(cells)):
            self._step(cells, k, data[k], sensor[k], int(patterns[k]))
            if self._unsolved >= _SOLVE_EVERY:
                self._solve()

    def _sensor_noise(self, cells: Cells) -> Floats:
        out = np.zeros((len(cells), ROWS, ROWS))
        gain = cells.lateral_gain
        index = np.arange(ROWS)
        out[:, index, index] = self.noise.own
        out[:, index[Y_LEFT:P_LEFT], index[Y_LEFT:P_LEFT]] *= gain**2
        out[:, :M_LEFT, :M_LEFT] += self.noise.root_z
        out[:, Y_LEFT:P_LEFT, Y_LEFT:P_LEFT] += self.noise.root_y * gain[:, :, None] * gain[:, None, :]
        return out

    def _step(self, cells: Cells, k: int, data: Floats, sensor: Floats, pattern: int) -> None:
        model, x, h = self.model, self.columns, self.history
        n, at = len(x) - 1, self.steps % h.size
        self._static_bend(float(cells.load[k]))
        view = self._view(pattern)
        self._turn(cells, k, data, view)
        h.state[at], h.covariance[at], h.transition[at] = x[:n], self.covariance, model.transition
        h.static_m[at] = x[n]
        m = len(view.rows)
        a = model.transition[:, :n]
        grown = a @ self.covariance @ a.T + model.noise
        if m:
            for local, bias, side in view.lateral:
                view.sense[local, bias] = cells.lateral_gain[k, side]
            g = view.sense[:, :n]
            pg = self.covariance @ g.T
            c = a @ pg + view.cross
            s = g @ pg + view.measured + sensor[view.square]
            _, inverse, _ = lapack.dposv(s, _EYE[:m, :m])
            gain = c @ inverse
            innovation = data[view.rows] - view.sense @ x
            rows, columns, signs = view.own
            innovation[rows, columns] += signs * (innovation @ self._weights)[rows]
            grown -= gain @ c.T
            x[:n] = model.transition @ x + gain @ innovation
            self._information += innovation.T @ (inverse @ innovation)
            h.weighted[at, :, :m] = g.T @ inverse
            h.gain[at, :, :m], h.sense[at, :m], h.innovation[at, :m] = gain, g, innovation
        else:
            x[:n] = model.transition @ x
        h.weighted[at, :, m:], h.gain[at, :, m:], h.innovation[at, m:] = 0.0, 0.0, 0.0
        self.covariance = 0.5 * (grown + grown.T)
        self._unsolved += 1
        self.steps += 1

    def _view(self, pattern: int) -> _View:
        """The model's rows that a pattern of present ones leaves."""
        view = self._views.get(pattern)
        if view is None:
            rows = self._rows_of((pattern >> np.arange(ROWS)) & 1)
            biases = dict(self.layout.bias)
            lateral = [
                (local, biases[int(row)], int(row) - Y_LEFT)
                for local, row in enumerate(rows)
                if Y_LEFT <= row < P_LEFT and int(row) in biases
            ]
            model = self.model
            cross, measured = np.ascontiguousarray(model.cross[:, rows]), model.measured[np.ix_(rows, rows)]
            vertical = [(local, int(row) - Z_LEFT) for local, row in enumerate(rows) if row < M_LEFT]
            square = np.ix_(rows, rows)
            own = self._own_of(rows)
            view = _View(rows, square, model.sense[rows], cross, measured, lateral, vertical, own)
            self._views[pattern] = view
        return view

    def _rows_of(self, present: Ints) -> Ints:
        """The rows to use: moments are left out where they would tell nothing beside a gyro."""
        use = present.copy()
        for side in (0, 1):
            use[M_LEFT + side] &= int(self.model.rough or not present[P_LEFT + side])
        return np.flatnonzero(use)

    def _own_of(self, rows: Ints) -> tuple[Ints, Ints, Floats]:
        local = {int(row): at for at, row in enumerate(rows)}
        there = [(local[row], column, sign) for row, column, sign in own_scales(self.layout) if row in local]
        at, columns, signs = zip(*there, strict=True) if there else ((), (), ())
        return np.array(at, np.int64), np.array(columns, np.int64), np.array(signs, np.float64)

    def _static_bend(self, load: float) -> None:
        last = self.columns[-1]
        last[0] = self._trim_m + self._bend_per_g_m * load
        if self._trim is not None:
            last[self._trim] = 1.0
        if self._bend is not None:
            # smoothed, because the noise of the load is in the innovations too
            last[self._bend] += self.model.step_s / _LOAD_TIME_S * (load - last[self._bend])

    def _turn(self, cells: Cells, k: int, data: Floats, view: _View) -> None:
        """Fill in what depends on the state: the tip's own tilt, and the columns of the slope factors.

        The tilt is linearised where the state is believed to be, for through it gravity shows slow bending.
        """
        seen = self._watch @ (self.columns @ self._weights)
        slopes, rates = seen[:2], seen[2:4]
        tilt = -(cells.vertical[k] * slopes + cells.lateral[k])
        data[Z_LEFT:M_LEFT, 0] -= 0.5 * cells.vertical[k] * slopes**2
        for local, side in view.vertical:
            view.sense[local] = self.model.sense[Z_LEFT + side] + tilt[side] * self._watch[side]
        data[Y_LEFT:P_LEFT, 0] += cells.tilted[k] * rates
        data[self._factor_rows, self._factor_columns] = seen[4:]

    def use(self, model: StepModel) -> None:
        """Go on with another model of the same wing."""
        self.model = model
        self._views.clear()
        n = self.layout.size
        ahead, now = model.transition, np.eye(n, n + 1)
        middle, rate = 0.5 * (now + ahead), (ahead - now) / model.step_s
        watch = [model.slope @ middle, model.slope @ rate]
        rows, columns = [], []
        for column, q, sign in _slope_terms(self.layout):
            for side, turn in ((0, 1.0), (1, -1.0)):
                watch += [-sign[side] * middle[q : q + 1], -turn * sign[side] * rate[q : q + 1]]
                rows += [Y_LEFT + side, P_LEFT + side]
                columns += [column, column]
        self._watch = np.concatenate(watch)
        self._factor_rows, self._factor_columns = np.array(rows, np.int64), np.array(columns, np.int64)

    def _solve(self) -> None:
        self._unsolved = 0
        if not len(self.constants):
            return
        known, left = self._estimated, self._considered
        information = self._prior[np.ix_(known, known)] + self._information[np.ix_(known + 1, known + 1)]
        _, covariance, _ = lapack.dposv(information, np.eye(len(known)))
        self.constants[known] = -covariance @ self._information[known + 1, 0]
        prior = self._sigma[left] ** 2
        turned = -covariance @ self._information[np.ix_(known + 1, left + 1)]
        self.constants_covariance[np.ix_(known, known)] = covariance + (turned * prior) @ turned.T
        self.constants_covariance[np.ix_(known, left)] = turned * prior
        self.constants_covariance[np.ix_(left, known)] = (turned * prior).T
        self._weights[1:] = self.constants


def _slope_terms(layout: Layout) -> list[tuple[int, int, tuple[float, float]]]:
    terms = []
    for name, family in zip(("symmetric", "antisymmetric"), layout.families, strict=True):
        for key, q in ((f"slope.{name}", family.q), (f"slope.second_{name}", family.q2)):
            column = layout.column(key)
            if column is not None:
                terms.append((column, q, family.sign))
    return terms

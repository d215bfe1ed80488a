"""The true wing: the simulator's own integrator of the model's equation, step by step or a whole flight at once.

    q'' + C q' + K (q - q_static) = g(t) + forces of effects

Load and load factor are held over half a millisecond. The linear part advances by its exact exponential; effects that
add forces are integrated by Runge-Kutta.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg import expm

from companion.core.wing.model import Memories, WingModel
from companion.records import Floats

SUBSTEP_S = 0.0005  # chosen: half a knot, for the middle of a Hermite step; loads are held over it


def adds_forces(model: WingModel) -> bool:
    """Tell whether an effect in force overrides the ``force`` hook, so that the model is not linear."""
    return any(effect.forces_modes() for effect in model.effects)


class WingStepper:
    """The wing advanced step by step, when the loads are not known in advance (a real autopilot flies it).

    Parameters
    ----------
    model : WingModel
        The true wing, effects included.
    load_factor : float
        The wing starts at rest under it.
    step_s : float
        Length of every step.
    """

    def __init__(self, model: WingModel, load_factor: float = 1.0, step_s: float = SUBSTEP_S) -> None:
        self.model = model
        self.step_s = step_s
        self.t_s = 0.0
        self.q_m = model.q_static(load_factor)
        self.qdot_mps = np.zeros(model.count)
        self._transition, self._drive = _exponential(model, step_s)
        self._nonlinear = adds_forces(model)
        self._memories: Memories | None = None

    def step(self, gust_mps2: Floats, load_factor: float) -> None:
        """Advance by one step under a modal gust load (n,) and a load factor, both held."""
        if self._nonlinear:
            self._runge_kutta(gust_mps2, load_factor)
        else:
            n = self.model.count
            load = gust_mps2 + self.model.structure.stiffness_radps2 @ self.model.q_static(load_factor)
            state = self._transition @ np.concatenate([self.q_m, self.qdot_mps]) + self._drive @ load
            self.q_m, self.qdot_mps = state[:n], state[n:]
        self.t_s += self.step_s

    def _runge_kutta(self, load: Floats, factor: float) -> None:
        h, t, q, v = self.step_s, self.t_s, self.q_m, self.qdot_mps
        self._memories = self.model.remembered(t, q, v, factor, self._memories)
        slope, memories = self.model.acceleration, self._memories
        a1 = slope(t, q, v, load, factor, memories)
        v2 = v + h / 2 * a1
        a2 = slope(t + h / 2, q + h / 2 * v, v2, load, factor, memories)
        v3 = v + h / 2 * a2
        a3 = slope(t + h / 2, q + h / 2 * v2, v3, load, factor, memories)
        v4 = v + h * a3
        a4 = slope(t + h, q + h * v3, v4, load, factor, memories)
        self.q_m = q + h / 6 * (v + 2 * v2 + 2 * v3 + v4)
        self.qdot_mps = v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)


def integrate(model: WingModel, gust_mps2: Floats, load_factor: Floats, start_s: float = 0.0) -> tuple[Floats, Floats]:
    """Integrate a whole flight from rest under the first load factor, in steps of :data:`SUBSTEP_S`.

    Parameters
    ----------
    model : WingModel
        The true wing, effects included.
    gust_mps2 : (m, n) float64
        Load on each mode, held over each step.
    load_factor : (m,) float64
        At the middle of each step.
    start_s : float
        Time of the first step's start, for effects that depend on time.

    Returns
    -------
    q_m, qdot_mps : (m + 1, n) float64
        At the ends of the steps, the start included.
    """
    if adds_forces(model):
        stepper = WingStepper(model, float(load_factor[0]))
        stepper.t_s = start_s
        return _stepped(stepper, gust_mps2, load_factor)
    from scipy.signal import lfilter  # 0.8 s to import, so late

    n = model.count
    structure = model.structure
    trim, per_g = structure.static_trim_m, structure.static_per_g_m
    load = gust_mps2 + (trim + per_g * (load_factor[:, None] - 1.0)) @ structure.stiffness_radps2.T
    values, vectors = np.linalg.eig(model.state_space().a)
    growth = np.exp(values * SUBSTEP_S)
    # the exponential of each eigenvalue over a step in which the load is held
    push = (growth - 1.0) / values * (load @ np.linalg.inv(vectors)[:, n:].T)
    z = np.empty((len(load) + 1, 2 * n), dtype=np.complex128)
    z[0] = np.linalg.solve(vectors, np.concatenate([model.q_static(float(load_factor[0])), np.zeros(n)]))
    for mode in range(2 * n):
        carried: Any = [growth[mode] * z[0, mode]]
        z[1:, mode] = lfilter([1.0], [1.0, -growth[mode]], push[:, mode], zi=carried)[0]
    state = (z @ vectors.T).real
    return state[:, :n], state[:, n:]


def _stepped(stepper: WingStepper, gust: Floats, load_factor: Floats) -> tuple[Floats, Floats]:
    n = stepper.model.count
    q, qdot = np.empty((len(gust) + 1, n)), np.empty((len(gust) + 1, n))
    q[0], qdot[0] = stepper.q_m, stepper.qdot_mps
    for index, (load, factor) in enumerate(zip(gust, load_factor.tolist(), strict=True), start=1):
        stepper.step(load, factor)
        q[index], qdot[index] = stepper.q_m, stepper.qdot_mps
    return q, qdot


def _exponential(model: WingModel, step_s: float) -> tuple[Floats, Floats]:
    """Transition (2n, 2n) and the effect (2n, n) of a load held over one step."""
    space = model.state_space()
    size, n = len(space.a), model.count
    block = np.zeros((size + n, size + n))
    block[:size, :size], block[:size, size:] = space.a, space.b_load
    power = np.asarray(expm(block * step_s))
    return power[:size, :size], power[:size, size:]

"""The steps of the stranger's wing: each mode by its matrix exponential, all other forces by Heun's rule.

Compiled where numba is installed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
SLIPPERS = 4  # springs of a slipping joint, which yield one after the other


def _compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    try:
        from numba import njit
    except ModuleNotFoundError:
        return function
    compiled: Callable[..., Any] = njit(cache=True)(function)
    return compiled


class Plant(NamedTuple):
    """Modes (n,): propagators by a step, and what couples them; ``lift`` (2, n) of the tips against the fuselage."""

    spring: Array
    drag: Array
    q_of_q: Array
    q_of_v: Array
    v_of_q: Array
    v_of_v: Array
    q_of_f: Array
    v_of_f: Array
    lift: Array
    per_force: Array  # modal acceleration per force on a tip that gives the first mode 1 m/s^2
    coupling: Array  # (n, n) further stiffness
    drag_coupling: Array  # (n, n)


class Laws(NamedTuple):
    """Forces of state and time; what is 0 is not there."""

    kappa: float
    square: float
    fifth: float
    bilinear: float
    beta: float
    dry: float
    gap: float
    pumped: float  # damping that grows with squared deflection, 1/(m^2 s)
    slip: float
    reach_m: float
    swing: float
    swing_hz: float
    phase_rad: float
    jump: float
    jump_s: float
    further_omega: float
    further_zeta: float
    drag_along: float  # coupling of the further oscillator with the first mode


def _advance(plant: Any, laws: Any, load: Any, stiffer: Any, thicker: Any, dt: float, begun_s: float) -> Any:
    """Motion (n + 1, m) of n modes and a further oscillator, and their accelerations, under ``load`` (n + 1, m).

    ``stiffer`` and ``thicker`` (m,) multiply all stiffnesses and dampings in time.
    """
    n, count = len(plant.spring), load.shape[1]
    q, v, f = np.zeros(n), np.zeros(n), np.zeros(n)
    path, accel = np.zeros((n + 1, count)), np.zeros((n + 1, count))
    held = np.zeros((2, SLIPPERS))
    q2, v2 = 0.0, 0.0
    k1 = plant.spring[0]
    decay2, omega2 = laws.further_zeta * laws.further_omega, laws.further_omega
    before, w, rate, tip = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    ahead_q, ahead_v = np.zeros(n), np.zeros(n)
    for i in range(count):
        t = i * dt + begun_s
        swung = 1.0 + laws.swing * math.cos(2.0 * math.pi * laws.swing_hz * t + laws.phase_rad)
        if t >= laws.jump_s:
            swung *= (1.0 + laws.jump) ** 2
        stiff, thick = stiffer[i] * swung - 1.0, thicker[i] - 1.0
        for stage in range(2):
            at_q, at_v = (q, v) if stage == 0 else (ahead_q, ahead_v)
            for s in range(2):
                w[s], rate[s] = 0.0, 0.0
                for r in range(n):
                    w[s] += plant.lift[s, r] * at_q[r]
                    rate[s] += plant.lift[s, r] * at_v[r]
                x, u = w[s], rate[s]
                bent = laws.kappa * x**3 + laws.square * x**2 + laws.fifth * x**5 + laws.bilinear * max(x, 0.0)
                bent -= min(max(x, -laws.gap), laws.gap)
                tip[s] = -k1 * bent - laws.beta * abs(u) * u - laws.dry * math.tanh(u / 0.003) - laws.pumped * x * x * u
                if laws.slip > 0.0:
                    stretch = 0.0
                    for j in range(SLIPPERS):
                        reach = laws.reach_m * (0.4 + 0.4 * j)
                        z = min(max(held[s, j] + x - before[s], -reach), reach)
                        if stage == 0:
                            held[s, j] = z
                        stretch += (x - z) / SLIPPERS
                    tip[s] += k1 * laws.slip * stretch
                if stage == 0:
                    before[s] = x
            for r in range(n):
                force = load[r, i] - stiff * plant.spring[r] * at_q[r] - thick * plant.drag[r] * at_v[r]
                force += plant.per_force[r] * 0.5 * (plant.lift[0, r] * tip[0] + plant.lift[1, r] * tip[1])
                for c in range(n):
                    force -= plant.coupling[r, c] * at_q[c] + plant.drag_coupling[r, c] * at_v[c]
                if r == 0:
                    force -= laws.drag_along * q2
                if stage == 0:
                    f[r] = force
                    accel[r, i] = force - plant.spring[r] * q[r] - plant.drag[r] * v[r]
                    path[r, i] = q[r]
                else:
                    f[r] = 0.5 * (f[r] + force)
            if stage == 0:
                for r in range(n):
                    ahead_q[r] = plant.q_of_q[r] * q[r] + plant.q_of_v[r] * v[r] + plant.q_of_f[r] * f[r]
                    ahead_v[r] = plant.v_of_q[r] * q[r] + plant.v_of_v[r] * v[r] + plant.v_of_f[r] * f[r]
        for r in range(n):
            moved = plant.q_of_q[r] * q[r] + plant.q_of_v[r] * v[r] + plant.q_of_f[r] * f[r]
            v[r] = plant.v_of_q[r] * q[r] + plant.v_of_v[r] * v[r] + plant.v_of_f[r] * f[r]
            q[r] = moved
        if omega2 > 0.0:
            # half implicit: first the speed, then the place
            a2 = load[n, i] - omega2**2 * q2 - 2.0 * decay2 * v2 - laws.drag_along * path[0, i]
            path[n, i], accel[n, i] = q2, a2
            v2 += dt * a2
            q2 += dt * v2
    return path, accel


advance = _compiled(_advance)


def propagated(omega_radps: Array, zeta: Array, dt: float) -> tuple[Array, ...]:
    """Six entries (n,) of the exact step of q'' + 2 zeta omega q' + omega^2 q = f, f constant over the step."""
    decay, ringing = zeta * omega_radps, omega_radps * np.sqrt(1.0 - zeta**2)
    shrink, cosine, sine = np.exp(-decay * dt), np.cos(ringing * dt), np.sin(ringing * dt)
    q_of_q = shrink * (cosine + decay / ringing * sine)
    q_of_v = shrink * sine / ringing
    v_of_q = -(omega_radps**2) * q_of_v
    v_of_v = shrink * (cosine - decay / ringing * sine)
    return q_of_q, q_of_v, v_of_q, v_of_v, (1.0 - q_of_q) / omega_radps**2, q_of_v

"""Deflection of an oscillator under a force, by Runge and Kutta: a truth that shares nothing with the diagnosis."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from companion.records import Floats


@njit(cache=True)
def deflection(
    fine: Floats,
    step_s: float,
    substeps: int,
    rest_hz: float,
    zeta: float,
    cubic: float,
    drag: float = 0.0,
    friction: float = 0.0,
    gap: float = 0.0,
) -> Floats:
    """Deflection from rest at every ``substeps``-th step by a spring of unit stiffness behind a gap, and further laws.

    ``fine`` (2 m,) is the force at every half step.
    """
    omega, h, steps = 2.0 * np.pi * rest_hz, step_s, len(fine) // 2

    def acceleration(q: float, v: float, u: float) -> float:
        rubs = friction * math.tanh(v / (1e-4 * omega))  # a sign that an integrator can follow
        spring = q - min(max(q, -gap), gap)
        return (u - spring - cubic * q**3 - drag * abs(v) * v - rubs) * omega**2 - 2.0 * zeta * omega * v

    q = v = 0.0
    shown = np.empty(steps // substeps)
    for i in range(steps):
        if i % substeps == 0:
            shown[i // substeps] = q
        u, middle, after = fine[2 * i], fine[2 * i + 1], fine[(2 * i + 2) % len(fine)]
        a1 = acceleration(q, v, u)
        a2 = acceleration(q + 0.5 * h * v, v + 0.5 * h * a1, middle)
        a3 = acceleration(q + 0.5 * h * v + 0.25 * h * h * a1, v + 0.5 * h * a2, middle)
        a4 = acceleration(q + h * v + 0.5 * h * h * a2, v + h * a3, after)
        q, v = q + h * v + h * h / 6.0 * (a1 + a2 + a3), v + h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return shown

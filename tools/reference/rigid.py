"""Rigid motion as closed forms: root specific force, body rates and their derivative, as sums of sines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
GRAVITY_MPS2 = 9.80665

# (axis, amplitude, frequency in Hz): p, q, r in rad/s, then specific force x, y, z in m/s^2 beside level flight.
# Rolls, pull-ups of a third of a g, heave up to the frequency of the wing.
_FLIGHT = (
    (0, 0.6, 0.12), (0, 0.15, 0.45), (0, 0.03, 1.7), (0, 0.01, 4.1),
    (1, 0.08, 0.10), (1, 0.02, 0.9),
    (2, 0.15, 0.08), (2, 0.03, 0.6),
    (3, 1.0, 0.15), (3, 0.2, 0.9),
    (4, 0.5, 0.21), (4, 0.1, 0.8),
    (5, 2.5, 0.10), (5, 1.0, 0.37), (5, 0.4, 1.1), (5, 0.2, 2.7), (5, 0.1, 5.3),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class RigidMotion:
    """Sums of sines: ``terms`` are (axis, amplitude, frequency_hz, phase_rad) on top of level flight at 1 g."""

    name: str
    terms: tuple[tuple[int, float, float, float], ...] = ()

    def at(self, t_s: Floats) -> tuple[Floats, Floats, Floats]:
        """Give specific force (n, 3) m/s^2, body rate (n, 3) rad/s and its derivative (n, 3) rad/s^2, body FRD."""
        motion = np.zeros((len(t_s), 6))
        derivative = np.zeros((len(t_s), 6))
        motion[:, 5] = -GRAVITY_MPS2
        for axis, amplitude, frequency, phase in self.terms:
            angle = 2 * np.pi * frequency * t_s + phase
            motion[:, axis] += amplitude * np.sin(angle)
            derivative[:, axis] += 2 * np.pi * frequency * amplitude * np.cos(angle)
        return motion[:, 3:], motion[:, :3], derivative[:, :3]


LEVEL = RigidMotion("level")


def flight(seed: int) -> RigidMotion:
    """Give rolls, pull-ups and heave with phases drawn from ``seed``."""
    phases = np.random.default_rng([seed, 77]).uniform(0, 2 * np.pi, len(_FLIGHT))
    terms = tuple((a, b, c, float(phase)) for (a, b, c), phase in zip(_FLIGHT, phases, strict=True))
    return RigidMotion("flight", terms)

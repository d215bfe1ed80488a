"""Laws that nobody has named: forces over deflection, speed and time, sensors over acceleration and time.

They are tested like named effects, and only ever described, never given as a cause.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, on_halves, parameter
from companion.records import Floats, Station

_Law = Callable[[Floats, Floats], Floats]

LAWS: dict[str, _Law] = {
    "deflection squared": lambda w, v: w**2 + 0.0 * v,
    "deflection cubed": lambda w, v: w**3 + 0.0 * v,
    "fifth power of deflection": lambda w, v: w**5 + 0.0 * v,
    "sign of deflection": lambda w, v: np.tanh(4.0 * w) + 0.0 * v,
    "speed times its amount": lambda w, v: np.abs(v) * v + 0.0 * w,
    "speed cubed": lambda w, v: v**3 + 0.0 * w,
    "sign of speed": lambda w, v: np.tanh(4.0 * v) + 0.0 * w,
    "speed squared": lambda w, v: v**2 + 0.0 * w,
    "deflection squared times speed": lambda w, v: w**2 * v,
    "amount of deflection times sign of speed": lambda w, v: np.abs(w) * np.tanh(4.0 * v),
}
"""Over deflection and speed in units of their rms."""

TIMES: dict[str, Callable[[Floats], Floats]] = {
    "deflection, drifting in time": lambda x: x,
    "deflection, bowed in time": lambda x: 1.5 * x**2 - 0.5,
    "deflection, swaying once": lambda x: np.sin(np.pi * x),
    "deflection, swaying twice": lambda x: np.cos(2.0 * np.pi * x),
    "deflection, swaying three times": lambda x: np.sin(3.0 * np.pi * x),
}
"""Over time from -1 to 1 across the recording."""


@dataclass(frozen=True, slots=True)
class LatentForce(Effect):
    """One law of the basis, in units of the rms spring force."""

    name: ClassVar[str] = "latent-force"
    group: ClassVar[Group] = Group.STRUCTURE

    strength: float = parameter("", 0.1, "share of the rms spring force")
    law: float = parameter("", 1e-9, "index of the law")

    def force(self, motion: ModalMotion) -> Floats:
        """Apply the law."""
        unit_m, unit_mps = float(np.std(motion.q_m[0])), float(np.std(motion.qdot_mps[0]))
        spring = float(motion.structure.stiffness_radps2[0, 0]) * unit_m
        index = round(self.law)
        if index < len(LAWS):
            law = list(LAWS.values())[index]
            return on_halves(motion, lambda w, v: -self.strength * spring * law(w / unit_m, v / unit_mps))
        t_s = np.asarray(motion.t_s)
        x = 2.0 * (t_s - t_s[0]) / (t_s[-1] - t_s[0]) - 1.0
        sway = list(TIMES.values())[index - len(LAWS)](x)
        pull: Floats = motion.structure.stiffness_radps2 @ motion.offset_m
        return -self.strength * sway * pull


SENSED: dict[str, Callable[[Floats, Floats], Floats]] = {
    "acceleration squared": lambda a, x: a**2 + 0.0 * x,
    "acceleration cubed": lambda a, x: a**3 + 0.0 * x,
    "amount of acceleration times acceleration": lambda a, x: np.abs(a) * a + 0.0 * x,
    "acceleration, drifting in time": lambda a, x: a * x,
    "acceleration, bowed in time": lambda a, x: a * (1.5 * x**2 - 0.5),
}
"""Over upward acceleration in units of its rms, and time from -1 to 1."""


@dataclass(frozen=True, slots=True)
class LatentSense(Effect):
    """One law of the sensors' basis, on both sides alike or against each other, in units of the rms acceleration."""

    name: ClassVar[str] = "latent-sense"
    group: ClassVar[Group] = Group.SENSING

    strength: float = parameter("", 0.05, "share of the rms acceleration")
    law: float = parameter("", 1e-9, "index of the law; odd: left against right")

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Apply the law to the upward axis."""
        if station is Station.ROOT:
            return values
        index, against = divmod(round(self.law), 2)
        up = values[:, 2] - np.mean(values[:, 2])
        unit = max(float(np.std(up)), 1e-12)
        x = 2.0 * (t_s - t_s[0]) / (t_s[-1] - t_s[0]) - 1.0
        sign = -1.0 if against and station is Station.LEFT else 1.0
        bent = values.copy()
        bent[:, 2] += sign * self.strength * unit * list(SENSED.values())[index](up / unit, x)
        return bent


def laws() -> list[tuple[str, Effect]]:
    """Every law at nothing, with what it says."""
    forces = [(f"force with {name}", LatentForce(0.0, float(i))) for i, name in enumerate([*LAWS, *TIMES])]
    senses = [
        (f"sensors with {name}{', left against right' if against else ''}", LatentSense(0.0, float(2 * i + against)))
        for i, name in enumerate(SENSED)
        for against in range(2)
    ]
    return [*forces, *senses]

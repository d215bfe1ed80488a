"""Forces that nobody has named: a basis of laws over deflection, speed and time, to see whether something is left.

They are tested like named effects, and only ever described, never given as a cause.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, on_halves, parameter
from companion.records import Floats

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


def law_names() -> list[str]:
    """What each law says, by index."""
    return [*LAWS, *TIMES]

"""Dry friction in a joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, on_halves, parameter
from companion.records import Floats

_ROUNDED_MPS = 0.005  # chosen: small beside a ringing tip's speed, wide enough for the steps of the integrators


@dataclass(frozen=True, slots=True)
class CoulombFriction(Effect):
    """Each wing half is slowed by -c tanh(v / 5 mm/s): dry friction, rounded where it turns."""

    name: ClassVar[str] = "coulomb-friction"
    group: ClassVar[Group] = Group.STRUCTURE
    own_law: ClassVar[str] = "force with sign of speed"
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "record free decays down to rest: the envelope falls on a straight line"

    friction_mps2: float = parameter("m/s^2", 0.3, "modal acceleration of the friction")

    def force(self, motion: ModalMotion) -> Floats:
        """The added force, half by half."""
        return on_halves(motion, lambda _w, v: -self.friction_mps2 * np.tanh(v / _ROUNDED_MPS))

"""The gust loads one wing half more than the other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.records import Complexes, Floats


@dataclass(frozen=True, slots=True)
class LeftRightForcing(Effect):
    """Left load (1 - ratio), right load (1 + ratio): symmetric and antisymmetric loads mix by ratio."""

    name: ClassVar[str] = "left-right-forcing"
    group: ClassVar[Group] = Group.STRUCTURE

    ratio: float = parameter("", 0.2, "half of the relative difference, right minus left", above=-1.0)

    def load_gain(self, f_hz: Floats, count: int) -> Complexes:
        """Mix the first pair."""
        del f_hz
        gain = np.zeros((1, count, count), dtype=np.complex128)
        gain[0] = np.eye(count)
        if count > 1:
            gain[0, 0, 1] = gain[0, 1, 0] = self.ratio
        return gain

    def forcing(self, t_s: Floats, load_mps2: Floats, generator: np.random.Generator) -> Floats:
        """Mix the first pair."""
        del t_s, generator
        mixed = load_mps2.copy()
        if load_mps2.shape[1] > 1:
            mixed[:, :2] += self.ratio * load_mps2[:, 1::-1]
        return mixed

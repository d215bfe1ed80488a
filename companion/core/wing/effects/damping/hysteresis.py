"""A spring that slips: part of the stiffness holds up to a yield deflection and then follows at constant force."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, from_halves, halves, parameter
from companion.native.library import ARRAY, REAL, kernel
from companion.records import Floats

_slip = kernel("slipping_spring", ARRAY, REAL, ARRAY)


@dataclass(frozen=True, slots=True)
class Hysteresis(Effect):
    """Each half's spring is omega^2 (w - share (w - z)): z follows w, but never beyond +-yield (Jenkins element).

    Below the yield nothing slips; above, the wing is softer, and a loop damps it the more the further it swings.
    """

    name: ClassVar[str] = "hysteresis"
    group: ClassVar[Group] = Group.STRUCTURE
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "load and unload the tip slowly by hand: force against deflection makes a loop"
    scan: ClassVar = MappingProxyType({"yield_m": (0.001, 0.0025, 0.006)})
    multimodal: ClassVar[bool] = True
    own_law: ClassVar[str] = "springs that slip"

    share: float = parameter("", 0.1, "share of the stiffness that slips")
    yield_m: float = parameter("m", 0.003, "deflection at which it slips", default=0.0025)

    def force(self, motion: ModalMotion) -> Floats:
        """Spring force that slipping takes away, half by half."""
        return from_halves(
            motion, self.share * motion.half_stiffness_radps2 * (halves(motion.offset_m) - self._held(motion))
        )

    def remember(self, motion: ModalMotion) -> Floats:
        """How far each half's spring is stretched, and where that half is, (4, ...) m."""
        w = halves(motion.offset_m)
        return np.concatenate([self._held(motion), w])

    def _held(self, motion: ModalMotion) -> Floats:
        w, reach = np.ascontiguousarray(halves(motion.offset_m)), abs(self.yield_m)
        if motion.memory is not None:
            held, before = np.split(motion.memory, 2)
            return np.clip(held + w - before, -reach, reach)
        if w.ndim == 1:
            return np.clip(w, -reach, reach)
        return stretch_along(w, reach)


def stretch_along(deflection_m: Floats, reach_m: float) -> Floats:
    """Stretch of a spring that slips beyond ``reach_m``, along whole paths (h, m) from rest."""
    stretch_m = np.empty_like(deflection_m)
    _slip(deflection_m, reach_m, stretch_m)
    return stretch_m

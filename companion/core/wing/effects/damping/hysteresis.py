"""Springs that slip: part of the stiffness holds up to a yield deflection and then follows at constant force."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, from_halves, halves, parameter
from companion.native.library import ARRAY, REAL, kernel
from companion.records import Floats

_slip = kernel("slipping_spring", ARRAY, REAL, ARRAY)
_derive = kernel("slipping_spring_derivatives", ARRAY, REAL, ARRAY, ARRAY)


_YIELDS = np.array([0.2, 0.6, 1.0, 1.4, 1.8])
"""Of ``yield_m``: springs of equal stiffness whose yields are spread evenly from 0 to twice the mean (Iwan 1966)."""


@dataclass(frozen=True, slots=True)
class Hysteresis(Effect):
    """Each half's spring is omega^2 (w - share (w - z)), and z the mean stretch of springs that slip one by one.

    Each stretch follows w, but never beyond its yield either way (Jenkins elements in parallel: Iwan's model). With
    amplitude the wing becomes softer, and a loop damps it the more the further it swings.
    """

    name: ClassVar[str] = "hysteresis"
    group: ClassVar[Group] = Group.STRUCTURE
    one_way: ClassVar[bool] = True
    advice: ClassVar[str] = "load and unload the tip slowly by hand: force against deflection makes a loop"
    scan: ClassVar = MappingProxyType({"yield_m": (0.001, 0.003, 0.006)})
    multimodal: ClassVar[bool] = True
    own_law: ClassVar[str] = "springs that slip"

    share: float = parameter("", 0.1, "share of the stiffness that slips")
    yield_m: float = parameter("m", 0.003, "mean deflection at which it slips", default=0.0025)

    def force(self, motion: ModalMotion) -> Floats:
        """Spring force that slipping takes away, half by half."""
        stretch_m = self._stretches(motion).mean(0)
        return from_halves(motion, self.share * motion.half_stiffness_radps2 * (halves(motion.offset_m) - stretch_m))

    def remember(self, motion: ModalMotion) -> Floats:
        """How far each half's springs are stretched, and where that half is, (springs + 1, 2) m."""
        return np.concatenate([self._stretches(motion), halves(motion.offset_m)[None]])

    def mean_derivative(self, motion: ModalMotion, weight: Floats) -> Floats:
        """Share of the stiffness less what the springs follow at each lag before, half by half, (h, m)."""
        followed = derivatives_along(halves(motion.offset_m), np.abs(self.yield_m) * _YIELDS, weight)
        return softened(self.share * motion.half_stiffness_radps2, followed)

    def _stretches(self, motion: ModalMotion) -> Floats:
        """Stretch of each spring, (springs, 2, ...) m."""
        w_m, reach_m = halves(motion.offset_m), np.abs(self.yield_m) * _YIELDS
        if motion.memory is not None:
            *stretches_m, before_m = motion.memory
            return np.asarray(np.clip(stretches_m + (w_m - before_m), -reach_m[:, None], reach_m[:, None]))
        if w_m.ndim == 1:
            return np.asarray(np.clip(w_m, -reach_m[:, None], reach_m[:, None]))
        return stretches_along(w_m, reach_m)


def stretch_along(deflection_m: Floats, reach_m: float) -> Floats:
    """Stretch of a spring that slips beyond ``reach_m``, along whole paths (h, m) from rest."""
    stretch_m = np.empty_like(deflection_m)
    _slip(deflection_m, reach_m, stretch_m)
    return stretch_m


def stretches_along(deflection_m: Floats, reaches_m: Floats) -> Floats:
    """Stretches of springs in parallel, one of each reach (k,), along whole paths (h, m) from rest, (k, h, m)."""
    paths_m = np.ascontiguousarray(deflection_m)
    return np.array([stretch_along(paths_m, float(reach_m)) for reach_m in reaches_m])


def derivatives_along(deflection_m: Floats, reaches_m: Floats, weight: Floats) -> Floats:
    """Mean derivative of the springs' mean stretch by the deflection at each lag before, (h, m).

    ``weight`` (m,) is that of each sample in the mean. A spring that holds is stretched by what the deflection has
    moved since it last slipped: its derivative is 1 at once and -1 at that lag. It is causal and has no part
    by speed.
    """
    paths_m, lags = np.ascontiguousarray(deflection_m), np.zeros(deflection_m.shape)
    for reach_m in reaches_m:
        _derive(paths_m, float(reach_m), weight, lags)
    return lags / (np.sum(weight) * len(reaches_m))


def softened(slipping_radps2: float, followed: Floats) -> Floats:
    """Derivative (h, m) of the force that slipping takes away, of springs whose stretch has the derivative given."""
    taken = -slipping_radps2 * followed
    taken[:, 0] += slipping_radps2
    return taken

"""The wing in state space: one super-model for the simulator's truth and the estimator's belief.

q'' + C q' + K (q - q_static) = g + effects, in metres at the tip, tips-up positive, order of
:data:`companion.core.wing.structure.SLOT_NAMES`. Truth and belief are two objects of this class.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from companion.core.wing.effect import Effect, ModalMotion
from companion.core.wing.effects import make_effects
from companion.core.wing.structure import Structure, structure_of
from companion.params.airframe import Airframe, Wing
from companion.records import Floats

Memories = tuple[Floats | None, ...]


@dataclass(frozen=True, slots=True)
class StateSpace:
    """x' = a x + b_load g + offset(load factor), x = [q, q'].

    Attributes
    ----------
    a : (2n, 2n)
    b_load : (2n, n)
        Modal load in m/s^2.
    offset_trim, offset_per_g : (2n,)
        Constant in 1 g flight, and per further g.
    """

    a: Floats
    b_load: Floats
    offset_trim: Floats
    offset_per_g: Floats


class WingModel:
    """Modes, static bend, and the named effects in force."""

    def __init__(self, params: Wing, effects: tuple[Effect, ...] = ()) -> None:
        self.params = params
        self.effects = effects
        structure = structure_of(params)
        for effect in effects:
            structure = effect.structure(structure)
        self.structure: Structure = structure
        self._forcing = tuple(effect for effect in effects if effect.forces_modes())
        self._nothing: Memories = (None,) * len(self._forcing)

    @classmethod
    def from_airframe(cls, airframe: Airframe) -> WingModel:
        """The wing with the effects that its file lists."""
        return cls(airframe.wing, make_effects(airframe.effects))

    @property
    def count(self) -> int:
        """Number n of modal coordinates."""
        return self.structure.count

    @property
    def omega_radps(self) -> Floats:
        """Natural frequencies of the coordinates taken alone, (n,)."""
        return np.asarray(np.sqrt(np.diag(self.structure.stiffness_radps2)))

    @property
    def zeta(self) -> Floats:
        """Damping ratios of the coordinates taken alone, (n,)."""
        return np.asarray(np.diag(self.structure.damping_radps) / (2.0 * self.omega_radps))

    def q_static(self, load_factor: float) -> Floats:
        """Equilibrium under a steady load factor, (n,) metres; trim bend at 1 g."""
        return self.structure.static_trim_m + self.structure.static_per_g_m * (load_factor - 1.0)

    def acceleration(
        self,
        t_s: float,
        q_m: Floats,
        qdot_mps: Floats,
        load_mps2: Floats,
        load_factor: float,
        memories: Memories | None = None,
    ) -> Floats:
        """Full right-hand side q'' (n,), effects included, for an integrator of the caller's.

        ``memories`` are what :meth:`remembered` gave at the end of the last step, for forces that depend on history.
        """
        structure = self.structure
        static = self.q_static(load_factor)
        spring = structure.stiffness_radps2 @ (q_m - static)
        total = load_mps2 - structure.damping_radps @ qdot_mps - spring
        if self._forcing:
            motion = ModalMotion(t_s, q_m, qdot_mps, static, load_factor, structure)
            for effect, memory in zip(self._forcing, memories or self._nothing, strict=True):
                added = effect.force(motion if memory is None else dataclasses.replace(motion, memory=memory))
                total = total if added is None else total + added
        return np.asarray(total)

    def remembered(
        self, t_s: float, q_m: Floats, qdot_mps: Floats, load_factor: float, before: Memories | None
    ) -> Memories:
        """Memories of history-dependent forces at an instant, for the next step; ``before`` are those of the last.

        ``q_m`` and ``qdot_mps`` (n,) are the modal coordinates and their rates.
        """
        static = self.q_static(load_factor)
        motion = ModalMotion(t_s, q_m, qdot_mps, static, load_factor, self.structure)
        pairs = zip(self._forcing, before or self._nothing, strict=True)
        return tuple(effect.remember(dataclasses.replace(motion, memory=memory)) for effect, memory in pairs)

    def state_space(self) -> StateSpace:
        """The linear part; forces of effects are not in it."""
        n = self.count
        stiffness, damping = self.structure.stiffness_radps2, self.structure.damping_radps
        zero = np.zeros(n)
        return StateSpace(
            np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]]),
            np.vstack([np.zeros((n, n)), np.eye(n)]),
            np.concatenate([zero, stiffness @ self.structure.static_trim_m]),
            np.concatenate([zero, stiffness @ self.structure.static_per_g_m]),
        )

    def tip_slope_rad(self, q_m: Floats) -> Floats:
        """Up-bend slope of left and right tip station, (..., 2) from (..., n); rates go the same way."""
        return np.asarray(q_m @ self.structure.slope_radpm.T)

    def all_slots(self, q_m: Floats) -> Floats:
        """Spread (..., n) present coordinates over the s slots, at least four: (..., s), zero in empty ones."""
        spread = np.zeros((*q_m.shape[:-1], self.structure.slot_count))
        spread[..., list(self.structure.slots)] = q_m
        return spread

    def present(self, q_all_m: Floats) -> Floats:
        """Pick the coordinates that this wing has, (..., n) from (..., s)."""
        return np.asarray(q_all_m[..., list(self.structure.slots)])

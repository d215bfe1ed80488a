"""A stiffness that swings periodically by itself (a pulsing load path, a rotor, slosh)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import Effect, Group, ModalMotion, ResidualPeak, harmonic, parameter
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class ParametricStiffness(Effect):
    """K(t) = K (1 + cosine cos 2 pi f t + sine sin 2 pi f t), t from the start: Mathieu's equation."""

    name: ClassVar[str] = "parametric-stiffness"
    group: ClassVar[Group] = Group.STRUCTURE
    starts_at: ClassVar = ResidualPeak.STIFFNESS_LINE
    advice: ClassVar[str] = "record what turns or pulses at that frequency (rpm, tank, control surface)"

    cosine: float = parameter("", 0.1, "relative swing of the stiffness, part in phase with the start")
    sine: float = parameter("", 0.1, "relative swing of the stiffness, a quarter period later")
    frequency_hz: float = parameter("Hz", 2.0, "frequency of the swing", default=1.0)

    def force(self, motion: ModalMotion) -> Floats:
        """The part of the spring force that swings."""
        return -harmonic(self.cosine, self.sine, self.frequency_hz, motion.t_s) * motion.spring_mps2

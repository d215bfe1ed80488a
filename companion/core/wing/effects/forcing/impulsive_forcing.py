"""Kicks: single short loads that no gust spectrum makes (hail, a hard gust edge, a released store)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, ResidualPeak, parameter
from companion.records import Complexes, Floats

WIDTH_S = 0.005  # chosen: a tenth of the period at 20 Hz, so that the pulse's shape matters little to a wing
_NARROWEST_S = 5e-4  # shorter pulses are alike for a wing (choice)


@dataclass(frozen=True, slots=True)
class ImpulsiveForcing(Effect):
    """Up to three kicks; each changes the modal speeds at once, by a bell-shaped pulse of some milliseconds."""

    name: ClassVar[str] = "impulsive-forcing"
    group: ClassVar[Group] = Group.FORCING
    starts_at: ClassVar = ResidualPeak.IMPULSES
    transient: ClassVar[bool] = True
    instants: ClassVar = ("at1_s", "at2_s", "at3_s")
    advice: ClassVar[str] = "look at the video of these instants"

    symmetric1_mps: float = parameter("m/s", 0.1, "speed that the first kick gives the symmetric mode")
    antisymmetric1_mps: float = parameter("m/s", 0.1, "speed that it gives the antisymmetric mode")
    at1_s: float = parameter("s", 20.0, "its instant")
    symmetric2_mps: float = parameter("m/s", 0.1, "second kick, symmetric")
    antisymmetric2_mps: float = parameter("m/s", 0.1, "second kick, antisymmetric")
    at2_s: float = parameter("s", 20.0, "its instant")
    symmetric3_mps: float = parameter("m/s", 0.1, "third kick, symmetric")
    antisymmetric3_mps: float = parameter("m/s", 0.1, "third kick, antisymmetric")
    at3_s: float = parameter("s", 20.0, "its instant")
    width_s: float = parameter("s", 0.002, "standard deviation of each pulse in time", default=WIDTH_S)

    def force(self, motion: ModalMotion) -> Floats:
        """The pulses."""
        added, width_s = np.zeros_like(motion.q_m), max(abs(self.width_s), _NARROWEST_S)
        for symmetric, antisymmetric, at_s in self._kicks():
            away = (np.asarray(motion.t_s) - at_s) / width_s
            pulse = np.exp(-0.5 * away**2) / (np.sqrt(2.0 * np.pi) * width_s)
            added[0] += symmetric * pulse
            if len(added) > 1:
                added[1] += antisymmetric * pulse
        return added

    def kick_spectrum(self, omega_radps: Floats, count: int, start_s: float, stop_s: float) -> Complexes:
        """Bells at the instants that lie between the two times."""
        bell = np.exp(-0.5 * (omega_radps * max(abs(self.width_s), _NARROWEST_S)) ** 2)
        spectrum = np.zeros((max(count, 2), len(bell)), dtype=np.complex128)
        for symmetric, antisymmetric, at_s in self._kicks():
            if start_s <= at_s < stop_s:
                spectrum[:2] += np.outer(
                    [symmetric, antisymmetric], bell * np.exp(-1j * omega_radps * (at_s - start_s))
                )
        return spectrum[:count]

    def _kicks(self) -> tuple[tuple[float, float, float], ...]:
        return (
            (self.symmetric1_mps, self.antisymmetric1_mps, self.at1_s),
            (self.symmetric2_mps, self.antisymmetric2_mps, self.at2_s),
            (self.symmetric3_mps, self.antisymmetric3_mps, self.at3_s),
        )

    @classmethod
    def at_peaks(cls, peaks: tuple[float, ...]) -> Effect:
        """The impulses at the instants that stand out."""
        return cls.from_values({f"at{k + 1}_s": at_s for k, at_s in enumerate(peaks)})

"""The linear part of the wing in matrices: what the super-model's effects may reshape."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.params.airframe import FAMILIES, Mode, Wing
from companion.records import Floats

SLOT_NAMES = ("symmetric", "antisymmetric", "second_symmetric", "second_antisymmetric")
"""The modal coordinates in their order; a wing without a second mode leaves its slot out. Further ones follow."""


@dataclass(frozen=True, slots=True)
class Structure:
    """q'' = g - damping q' - stiffness (q - static), for n modes in the order of :data:`SLOT_NAMES`.

    Attributes
    ----------
    slots : tuple of int
        Which mode each coordinate is: even numbers are symmetric, odd ones antisymmetric, each family's lowest first.
    stiffness_radps2 : (n, n)
        Per (rad/s)^2; diagonal omega^2 where left and right wing are equal.
    damping_radps : (n, n)
        Diagonal 2 zeta omega.
    lift : (2, n)
        Upward displacement of the left and right tip station per modal coordinate.
    slope_radpm, twist_radpm : (2, n)
        Up-bend slope and nose-up twist there, per metre.
    static_trim_m, static_per_g_m : (n,)
        Equilibrium in 1 g flight, and what each further g adds.
    """

    slots: tuple[int, ...]
    stiffness_radps2: Floats
    damping_radps: Floats
    lift: Floats
    slope_radpm: Floats
    twist_radpm: Floats
    static_trim_m: Floats
    static_per_g_m: Floats

    @property
    def count(self) -> int:
        """Number of modal coordinates."""
        return len(self.slots)

    @property
    def slot_count(self) -> int:
        """Number of slots, empty ones included: at least the named ones."""
        return max(len(SLOT_NAMES), *(slot + 1 for slot in self.slots))

    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Indices of each symmetric coordinate with its antisymmetric partner, where both exist."""
        index = {slot: i for i, slot in enumerate(self.slots)}
        return tuple((index[s], index[s + 1]) for s in index if s % 2 == 0 and s + 1 in index)


def structure_of(wing: Wing) -> Structure:
    """Write an airframe's wing as matrices.

    Raises
    ------
    ValueError
        If a frequency is not positive or a damping ratio is negative.
    """
    families = [wing.family(parity).values() for parity in range(len(FAMILIES))]
    present = sorted(
        (2 * rank + parity, mode) for parity, family in enumerate(families) for rank, mode in enumerate(family)
    )
    omega = np.array([_omega(slot, mode) for slot, mode in present])
    zeta = np.array([mode.damping.value for _, mode in present])
    if np.any(zeta < 0.0):
        raise ValueError("a damping ratio is negative")
    slots = tuple(slot for slot, _ in present)
    lift = np.array([[1.0 if slot % 2 == 0 else sign for slot in slots] for sign in (-1.0, 1.0)])
    first = np.array([1.0 if slot == 0 else 0.0 for slot in slots])
    return Structure(
        slots,
        np.diag(omega**2),
        np.diag(2.0 * zeta * omega),
        lift,
        lift * np.array([mode.slope_factor_radpm.value for _, mode in present]),
        lift * np.array([mode.twist_factor_radpm.value for _, mode in present]),
        first * wing.trim_bend_m.value,
        first * wing.bend_per_g_m.value,
    )


def with_symmetric_mode(
    structure: Structure, frequency_hz: float, zeta: float, participation: float, slope_radpm: float
) -> Structure:
    """Append a symmetric mode whose tip acceleration has ``participation`` times the power of one with 1.

    It takes the first free slot above the first mode's. A mode without participation is left out.
    """
    if participation <= 0.0:
        return structure
    slot = 2
    while slot in structure.slots:
        slot += 2
    omega = 2.0 * math.pi * frequency_hz
    lift = np.full((2, 1), math.sqrt(participation))
    n = structure.count

    def grown(matrix: Floats, corner: float) -> Floats:
        large = np.zeros((n + 1, n + 1))
        large[:n, :n] = matrix
        large[n, n] = corner
        return large

    return Structure(
        (*structure.slots, slot),
        grown(structure.stiffness_radps2, omega**2),
        grown(structure.damping_radps, 2.0 * zeta * omega),
        np.hstack([structure.lift, lift]),
        np.hstack([structure.slope_radpm, slope_radpm * lift]),
        np.hstack([structure.twist_radpm, np.zeros((2, 1))]),
        np.append(structure.static_trim_m, 0.0),
        np.append(structure.static_per_g_m, 0.0),
    )


def slot_name(slot: int) -> str:
    """Name of a modal coordinate as the airframe file has it."""
    named = len(SLOT_NAMES)
    return SLOT_NAMES[slot] if slot < named else f"further_{FAMILIES[slot % 2]}.{(slot - named) // 2}"


def _omega(slot: int, mode: Mode) -> float:
    frequency_hz = mode.frequency_hz.value
    if not (math.isfinite(frequency_hz) and frequency_hz > 0.0):
        raise ValueError(f"{slot_name(slot)} frequency must be finite and > 0, not {frequency_hz}")
    return 2.0 * math.pi * frequency_hz

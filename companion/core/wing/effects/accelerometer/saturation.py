"""A wing accelerometer whose range is too small."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter, with_vertical
from companion.core.wing.samples import SampleDefect, lattice_step
from companion.params.airframe import Sensor
from companion.records import Floats, Station

_FEWEST = 8  # chosen: samples at the limit: a few may be chance peaks
_PILE = 4.0  # chosen: times what a smooth tail has there: far beyond its scatter


@dataclass(frozen=True, slots=True)
class Saturation(Effect):
    """Specific force is cut at +-1/inverse; 0 is an endless range. Seen in the samples: they pile up there."""

    name: ClassVar[str] = "saturation"
    group: ClassVar[Group] = Group.SENSING
    in_samples: ClassVar[bool] = True
    advice: ClassVar[str] = (
        "choose a larger range of the accelerometer; cut samples were drawn anew as the others make them likely"
    )

    inverse_s2pm: float = parameter("s^2/m", 0.02, "one over the range", above=0.0)

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Cut."""
        del t_s
        if station is Station.ROOT or self.inverse_s2pm <= 0.0:
            return values
        return with_vertical(values, np.clip(values[:, 2], -1.0 / self.inverse_s2pm, 1.0 / self.inverse_s2pm))

    @classmethod
    def sample_defect(cls, t_s: Floats, force_z_mps2: Floats, sensor: Sensor) -> SampleDefect | None:
        """Samples that pile up at the largest or smallest value, more than the values next to it."""
        del t_s, sensor
        piles = [(sign, pile) for sign in (1.0, -1.0) if (pile := _pile(sign * force_z_mps2)) is not None]
        if not piles:
            return None
        sign, (top, piled, expected, width) = max(piles, key=lambda entry: abs(entry[1][0]))
        factor = piled * math.log(piled / expected) - (piled - expected)
        text = f"{piled} samples of {len(force_z_mps2)} at exactly {sign * top:.3f} m/s^2"
        inverse = {"inverse_s2pm": 1.0 / abs(top)}
        return SampleDefect(cls.name, inverse, {"inverse_s2pm": width / top**2}, text, factor)

    @classmethod
    def clipped(cls, force_z_mps2: Floats) -> Floats:
        """A range may cut on one side only, and need not lie evenly about 0."""
        sides = np.zeros(len(force_z_mps2))
        for sign in (-1.0, 1.0):
            values = sign * force_z_mps2
            if _pile(values):
                sides[values > values.max() - 1e-6 * abs(values.max())] = sign
        return sides


def _pile(values: Floats) -> tuple[float, int, float, float] | None:
    """The largest value, how many samples are at it, how many a smooth tail would have there, and within what width."""
    top, spread = float(values.max()), 0.02 * float(values.std())
    if spread <= 0.0 or top == 0.0:  # a dead channel, or drop-outs to 0: no range ends there
        return None
    width = max(lattice_step(values), 1e-6 * max(abs(top), 1.0))
    piled = int(np.sum(values > top - 0.5 * width))
    beside = int(np.sum((values > top - 1.5 * width) & (values <= top - 0.5 * width)))
    # a finer look needs more neighbours
    near = float(np.sum(values > top - spread)) - piled
    expected = max(beside, near * min(width / max(spread, 1e-300), 1.0), 1.0)
    return (top, piled, expected, width) if piled >= max(_FEWEST, _PILE * expected) else None

"""Air that moves: a turbulence of Dryden spectra (MIL-F-8785C, low altitude) as the aeroplane flies through it.

Components are taken along the body axes, as the standard gives them for a level aeroplane: from ahead, from the side,
from above, and the roll that a vertical gust's change across the span gives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.records import Floats
from companion.sim.flight.gust import DrydenScales, dryden_longitudinal, dryden_roll, dryden_vertical


@dataclass(frozen=True, slots=True)
class AirMotion:
    """Velocity of the air in body axes, and its roll rate."""

    u_mps: float = 0.0
    v_mps: float = 0.0
    w_mps: float = 0.0
    p_radps: float = 0.0

    def between(self, other: AirMotion) -> AirMotion:
        """The gust half-way to another."""
        return AirMotion(
            0.5 * (self.u_mps + other.u_mps),
            0.5 * (self.v_mps + other.v_mps),
            0.5 * (self.w_mps + other.w_mps),
            0.5 * (self.p_radps + other.p_radps),
        )


STILL_AIR = AirMotion()


class Turbulence:
    """Gusts of one flight at every step, drawn beforehand; still air beyond its end."""

    def __init__(self, gusts: Floats) -> None:
        self._gusts = gusts

    @classmethod
    def calm(cls) -> Turbulence:
        """Air that stands still."""
        return cls(np.zeros((0, 4)))

    @classmethod
    def dryden(
        cls,
        rng: np.random.Generator,
        steps: int,
        step_s: float,
        *,
        wind_mps: float,
        height_m: float,
        airspeed_mps: float,
        span_m: float,
    ) -> Turbulence:
        """Draw a flight's gusts for the wind at 20 ft; scales and intensities are those of one height and airspeed.

        The side gust has the vertical one's form with the longitudinal scale and intensity, as the standard asks.
        """
        scales = DrydenScales.low_altitude(height_m, wind_mps)
        side = DrydenScales(scales.length_u_m, scales.length_u_m, scales.sigma_u_mps, scales.sigma_u_mps)
        spectra = (
            dryden_longitudinal(scales, airspeed_mps),
            dryden_vertical(side, airspeed_mps),
            dryden_vertical(scales, airspeed_mps),
            dryden_roll(scales, airspeed_mps, span_m),
        )
        return cls(np.stack([spectrum.draw(rng, steps, step_s) for spectrum in spectra], axis=1))

    def at(self, step: int) -> AirMotion:
        """The gust at the start of a step."""
        if not 0 <= step < len(self._gusts):
            return STILL_AIR
        u, v, w, p = self._gusts[step].tolist()
        return AirMotion(u, v, w, p)

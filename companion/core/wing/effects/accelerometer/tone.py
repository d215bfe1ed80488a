"""A tone in the sensors that the wing does not make (propeller, switching supply)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import Effect, Group, ResidualPeak, harmonic, parameter, with_vertical
from companion.records import Floats, Station


@dataclass(frozen=True, slots=True)
class Tone(Effect):
    """Each wing accelerometer adds cosine cos 2 pi f t + sine sin 2 pi f t to the upward axis, t from the start."""

    name: ClassVar[str] = "tone"
    group: ClassVar[Group] = Group.SENSING
    starts_at: ClassVar = ResidualPeak.LINE
    additive: ClassVar[bool] = True
    advice: ClassVar[str] = "stop the propeller, or run it on the ground; a supply's tone stays when nothing turns"

    left_cosine_mps2: float = parameter("m/s^2", 0.5, "left, in phase with the start")
    left_sine_mps2: float = parameter("m/s^2", 0.5, "left, a quarter period later")
    right_cosine_mps2: float = parameter("m/s^2", 0.5, "right, in phase with the start")
    right_sine_mps2: float = parameter("m/s^2", 0.5, "right, a quarter period later")
    frequency_hz: float = parameter("Hz", 10.0, "frequency", default=17.0)

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Add the tone; up is -z."""
        if station is Station.ROOT:
            return values
        cosine, sine = {
            Station.LEFT: (self.left_cosine_mps2, self.left_sine_mps2),
            Station.RIGHT: (self.right_cosine_mps2, self.right_sine_mps2),
        }[station]
        return with_vertical(values, values[:, 2] - harmonic(cosine, sine, self.frequency_hz, t_s))

"""A wing accelerometer with coarse steps."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter, with_vertical
from companion.core.wing.samples import CERTAIN, SampleDefect, lattice_step
from companion.params.airframe import Sensor
from companion.records import Floats, Station

_COARSE = 0.25  # of the believed noise's variance: 1 dB (choice)


@dataclass(frozen=True, slots=True)
class Quantisation(Effect):
    """Readings are whole multiples of a step, which adds noise of step^2/12. Seen in the samples themselves."""

    name: ClassVar[str] = "quantisation"
    group: ClassVar[Group] = Group.SENSING
    in_samples: ClassVar[bool] = True
    discretises: ClassVar[bool] = True
    advice: ClassVar[str] = "choose a smaller range or a message with finer steps (HIGHRES_IMU instead of RAW_IMU)"

    step_mps2: float = parameter("m/s^2", 0.1, "one step", above=0.0)

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Round."""
        del t_s
        if station is Station.ROOT or self.step_mps2 <= 0.0:
            return values
        return with_vertical(values, np.round(values[:, 2] / self.step_mps2) * self.step_mps2)

    @classmethod
    def sample_defect(cls, t_s: Floats, force_z_mps2: Floats, sensor: Sensor) -> SampleDefect | None:
        """Values on a lattice whose step adds noise that counts beside what the sensor is believed to have."""
        step = lattice_step(force_z_mps2)
        seconds = float(np.ptp(t_s))
        if step <= 0.0 or seconds <= 0.0:
            return None
        noise = sensor.accel_noise_mps2_rthz**2 * 0.5 * (len(t_s) - 1) / seconds
        if step**2 / 12.0 < _COARSE * noise:
            return None
        text = f"all values are multiples of {step:.4g} m/s^2: noise of {step / math.sqrt(12.0):.3g} m/s^2"
        return SampleDefect(cls.name, {"step_mps2": step}, {"step_mps2": 1e-3 * step}, text, CERTAIN)

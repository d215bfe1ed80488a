"""Slow tilt of the tips against each other, and the covariance of its error.

Made by :mod:`.tilt_measurement` of gyros and lateral accelerometers; what biases, noise, scales and turned axes make of
either is normal and of known shape.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from companion.core.wing.model import WingModel
from companion.params.airframe import Sensor
from companion.records import Bools, Floats
from companion.units import GRAVITY_MPS2

SLOW = 0.2
"""Width of the Gaussian low-pass in first modes: 1 Hz of 5, and what accelerations leave untold is below (choice)."""
_ANY_RAD = 0.1  # where an angle begins: more than any wing sags (choice)
_RESTING_S = 0.25  # step on which biases that drift are integrated (numerical)


@dataclass(frozen=True, slots=True)
class TipTilt:
    """Slope of the left tip plus that of the right, below a fifth of the first mode, at k instants.

    Attributes
    ----------
    t_s : (k,)
    lateral_rad, rates_rad : (k,)
        By the lateral forces and by the rates alone, each about a level that nothing tells.
    lateral_shapes, rate_shapes : (s, k)
        What one standard deviation of an axis or a scale makes of either.
    gain : (k,)
        g over the slow vertical force: what a lateral bias counts.
    tells : (k,)
        Whether there is weight enough for a lateral force to tell a turn.
    sensors : tuple of Sensor
        Whose noise and biases these are, left and right.
    width_hz : float
        Of the low-pass.
    load_shapes : (s, k)
        Powers of the slow load factor, of unit rms: along them the tilt tells nothing.
    rough_rad : float
        How far the two part, rms, faster than drifts do.
    least_rad : float
        Noise of each instant at least: what the motion of a model and these two leave out.
    """

    t_s: Floats
    lateral_rad: Floats
    rates_rad: Floats
    lateral_shapes: Floats
    rate_shapes: Floats
    gain: Floats
    tells: Bools
    sensors: tuple[Sensor, Sensor]
    width_hz: float
    load_shapes: Floats
    rough_rad: float
    least_rad: float

    def taken(self, inside: Bools) -> TipTilt:
        """Some of the instants (k,)."""
        names = ("t_s", "lateral_rad", "rates_rad", "lateral_shapes", "rate_shapes", "load_shapes", "gain", "tells")
        return dataclasses.replace(self, **{name: getattr(self, name)[..., inside] for name in names})

    def together(self) -> tuple[Floats, Floats]:
        """Slope by both, (k,), and the covariance of its error, (k, k)."""
        precisions = np.linalg.inv(self._lateral_error()), np.linalg.inv(self._rate_error())
        covariance = np.linalg.inv(precisions[0] + precisions[1])
        slope_rad = covariance @ (precisions[0] @ self.lateral_rad + precisions[1] @ self.rates_rad)
        # a bend that follows the load moves tilt and toe alike: the toe has to show it, for the tilt is not judged
        covariance = covariance + _ANY_RAD**2 * self.load_shapes.T @ self.load_shapes
        return np.asarray(slope_rad), np.asarray(0.5 * (covariance + covariance.T))

    def _lateral_error(self) -> Floats:
        """Biases that drift, noise behind the low-pass, shapes; (k, k)."""
        lag_s = np.abs(np.subtract.outer(self.t_s, self.t_s))
        apart = (math.pi * self.width_hz * lag_s) ** 2
        density = sum(0.5 * sensor.accel_noise_mps2_rthz**2 for sensor in self.sensors) / GRAVITY_MPS2**2
        noise = density * self.width_hz * math.sqrt(math.pi) * np.exp(-apart)
        # what a wing's shortening leaves is a second derivative; of density f^2 it is more than that at its slow end
        noise += self.rough_rad**2 * (1.0 - 2.0 * apart) * np.exp(-apart)
        for sensor in self.sensors:
            noise += (sensor.accel_bias_sigma_mps2 / GRAVITY_MPS2) ** 2 * np.exp(-lag_s / sensor.bias_time_s)
        error = noise * np.outer(self.gain, self.gain) + self.lateral_shapes.T @ self.lateral_shapes
        return np.asarray(error + np.diag(self.least_rad**2 + _ANY_RAD**2 * ~self.tells) + _ANY_RAD**2)

    def _rate_error(self) -> Floats:
        """Noise and drifting biases of two gyros, integrated, and shapes; (k, k)."""
        since_s = self.t_s - self.t_s.min()
        error = self.rate_shapes.T @ self.rate_shapes
        for sensor in self.sensors:
            error += 0.5 * sensor.gyro_noise_radps_rthz**2 * np.minimum.outer(since_s, since_s)
            error += _of_drifting_bias(sensor, since_s)
        return np.asarray(error + self.least_rad**2 * np.eye(len(since_s)) + _ANY_RAD**2)


def slow_response(f_hz: Floats, first_hz: float) -> Floats:
    """Gain (f,) of the low-pass under which the tips' tilt is told."""
    return np.asarray(np.exp(-0.5 * (f_hz / (SLOW * first_hz)) ** 2))


def slope_rows(wing: WingModel) -> Floats:
    """Sum of both tips' slopes per modal deflection, (n,)."""
    return np.asarray(wing.structure.slope_radpm.sum(0))


def _of_drifting_bias(sensor: Sensor, since_s: Floats) -> Floats:
    """Covariance (k, k) of the integral of a bias of first order, by sums on a coarse grid."""
    grid_s = np.linspace(0.0, max(float(since_s.max()), _RESTING_S), int(since_s.max() / _RESTING_S) + 2)
    step_s = grid_s[1]
    bias = sensor.gyro_bias_sigma_radps**2 * np.exp(-np.abs(np.subtract.outer(grid_s, grid_s)) / sensor.bias_time_s)
    inner = step_s * (np.cumsum(bias, axis=1) - 0.5 * (bias + bias[:, :1]))
    twice = step_s * (np.cumsum(inner, axis=0) - 0.5 * (inner + inner[:1]))
    columns = np.stack([np.interp(since_s, grid_s, row) for row in twice])
    return np.stack([np.interp(since_s, grid_s, column) for column in columns.T], 1)

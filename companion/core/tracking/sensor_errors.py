"""Errors of a sensor that are constant in a flight: names, prior sigmas, and how the operator reads of them.

Each station has them as bias parameters (``left.kz``) of the filter (CONSTANTS.md). Their Jacobian is in
``native/epochs.c``, whose enum has them in this order, :data:`SENSOR_ERRORS` before :data:`ROOT_ERRORS`, and again in
plain numpy in ``sitl_tests/reference/kernels/error_jacobians.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from companion.params.airframe import Sensor


@dataclass(frozen=True, slots=True)
class SensorError:
    """One error.

    Attributes
    ----------
    sigma : callable
        Prior sigma of a sensor's error, SI; 0 where the sensor has none, because it does not send the axis.
    words : str
        Name in a sentence.
    factor, unit : float, str
        From SI to the unit of that sentence.
    """

    sigma: Callable[[Sensor], float]
    words: str
    factor: float
    unit: str


def _where_sent(axis: str, sigma: Callable[[Sensor], float]) -> Callable[[Sensor], float]:
    return lambda sensor: sigma(sensor) if axis in sensor.sends else 0.0


def _accel_scale(sensor: Sensor) -> float:
    return sensor.accel_scale_sigma


def _gyro_scale(sensor: Sensor) -> float:
    return sensor.gyro_scale_sigma


def _gyro_bias(sensor: Sensor) -> float:
    return sensor.gyro_bias_sigma_radps


def _misalignment(sensor: Sensor) -> float:
    return sensor.misalignment_sigma_rad


def _time_offset(sensor: Sensor) -> float:
    return sensor.time_offset_sigma_s


def _height(sensor: Sensor) -> float:
    return sensor.height_sigma_m


SENSOR_ERRORS: Mapping[str, SensorError] = MappingProxyType(
    {
        "kz": SensorError(_where_sent("z", _accel_scale), "vertical scale", 100.0, "%"),
        "ky": SensorError(_where_sent("y", _accel_scale), "lateral scale", 100.0, "%"),
        "kp": SensorError(_where_sent("p", _gyro_scale), "roll rate's scale", 100.0, "%"),
        "mx": SensorError(_misalignment, "mounting about x", 1e3, "mrad"),
        "my": SensorError(_misalignment, "mounting about y", 1e3, "mrad"),
        "mz": SensorError(_misalignment, "mounting about z", 1e3, "mrad"),
        "tau": SensorError(_time_offset, "stamp offset", 1e3, "ms"),
        "height": SensorError(_where_sent("y", _height), "height", 1e3, "mm"),
    }
)
"""Errors of every station."""
ROOT_ERRORS: Mapping[str, SensorError] = MappingProxyType(
    {
        "bp": SensorError(_where_sent("p", _gyro_bias), "roll rate's bias", 1e3, "mrad/s"),
        "br": SensorError(_where_sent("r", _gyro_bias), "yaw rate's bias", 1e3, "mrad/s"),
    }
)
"""Errors of the root alone: biases of its rates, which the tips' centripetal force is computed from."""

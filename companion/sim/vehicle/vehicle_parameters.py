"""The simulated autopilot's parameter server, as ArduPilot 4.7 behaves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.params.airframe import Airframe
from companion.sim.vehicle.wire import AUTOPILOT_ID, SYSTEM_ID

_INTEGERS = ("SCHED_LOOP_RATE", "RNGFND1_TYPE", "RNGFND1_ORIENT", "PRX1_TYPE", "MAV_SYSID", "MAV_GCS_SYSID", "FS_LONG")


def default_parameters(airframe: Airframe) -> dict[str, float]:
    """A vehicle that is set up for Spanwise; tests override what they want wrong."""
    return {
        "SCHED_LOOP_RATE": 400.0,
        "MAV_SYSID": float(SYSTEM_ID),
        "MAV_GCS_SYSID": 255.0,
        "MAV_OPTIONS": 0.0,
        "INS_ACCEL_FILTER": airframe.root.lowpass_accel_hz,
        "INS_GYRO_FILTER": airframe.root.lowpass_gyro_hz,
        "INS_HNTCH_ENABLE": 0.0,
        "RNGFND1_TYPE": 10.0,
        "RNGFND1_MIN": 0.2,
        "RNGFND1_MAX": 250.0,
        "RNGFND1_ORIENT": float(airframe.orientation),
        "PRX1_TYPE": 0.0,
        "CAM1_TYPE": 1.0,
        "CAM2_TYPE": 1.0,
        "CAM1_DURATION": 0.1,
    }


class VehicleParameters:
    """Values in force, and the answers to the PARAM_* messages. The list is paced: a few values a tick."""

    reboot_required: frozenset[str] = frozenset({"SCHED_LOOP_RATE", "MAV_SYSID", "RNGFND1_TYPE"})

    def __init__(self, values: Mapping[str, float]) -> None:
        self._values = dict(values)
        self._boot_values = dict(values)
        self._pending: list[int] = []
        self.changed: set[str] = set()

    def get(self, name: str) -> float:
        """The value that acts now; some parameters act from the next boot only."""
        return (self._boot_values if name in self.reboot_required else self._values)[name]

    def reboot(self) -> None:
        """Put stored values into force."""
        self._boot_values = dict(self._values)
        self._pending = []

    def receive(self, message: Any) -> list[Any]:
        """Answer PARAM_REQUEST_READ, PARAM_REQUEST_LIST or PARAM_SET with messages to send."""
        kind = message.get_type()
        names = sorted(self._values)
        if kind == "PARAM_REQUEST_LIST":
            self._pending = list(range(len(names)))
        elif kind == "PARAM_REQUEST_READ":
            name = message.param_id if message.param_index < 0 else ""
            index = message.param_index if message.param_index >= 0 else (names.index(name) if name in names else -1)
            return [self._value(index)] if 0 <= index < len(names) else []
        elif kind == "PARAM_SET" and message.param_id in self._values:
            return [self._value(names.index(message.param_id))] if self._set(message) else []
        return []

    def change(self, name: str, value: float) -> None:
        """Put a value in force, or in store until the next boot."""
        self._values[name] = value
        self.changed.add(name)

    def listed(self) -> list[Any]:
        """The next values of a list that was asked for."""
        batch, self._pending = self._pending[:2], self._pending[2:]
        return [self._value(index) for index in batch]

    def _set(self, message: Any) -> bool:
        """Take a PARAM_SET; ArduPilot takes the number whatever type is named."""
        self.change(message.param_id, float(message.param_value))
        return True

    def _encoded(self, name: str, value: float) -> tuple[float, int]:
        """The value as it is written on the wire, and its type: ArduPilot writes every number as a float."""
        return value, mavlink.MAV_PARAM_TYPE_INT16 if name in _INTEGERS else mavlink.MAV_PARAM_TYPE_REAL32

    def _value(self, index: int) -> Any:
        names = sorted(self._values)
        value, kind = self._encoded(names[index], self._values[names[index]])
        return mavlink.MAVLink_param_value_message(names[index].encode(), value, kind, len(names), index)


def addressed_to_autopilot(message: Any, components: tuple[int, ...]) -> bool:
    """Tell whether the autopilot answers: for itself, for all, and for components that it has never heard of."""
    system = getattr(message, "target_system", 0)
    component = getattr(message, "target_component", 0)
    return system in (0, SYSTEM_ID) and (component in (0, AUTOPILOT_ID) or component not in components)

"""MAVLink 2 frames of the simulated vehicle: fast framing for the inertial streams, pymavlink for the rest."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import ConfigError
from companion.params.airframe import Source
from companion.records import Floats
from companion.sim.flight.sensors import MILLI_G_MPS2, MILLI_RADPS

SYSTEM_ID = 1  # convention: ArduPilot's default
AUTOPILOT_ID = 1  # convention: MAV_COMP_ID_AUTOPILOT1 (MAVLink common.xml)
_HEADER = struct.Struct("<BBBBBBBHB")
_ALL_FIELDS = 0b111111  # HIGHRES_IMU.fields_updated: accelerometers and gyros (derived)
_AXES = "xyz"


def message_name(number: int) -> str:
    """Name of a message by its id, empty for an unknown one."""
    kind = mavlink.mavlink_map.get(number)
    return str(kind.msgname) if kind else ""


class FrameSender:
    """One component's frames: its ids and its sequence numbers."""

    def __init__(self, component: int) -> None:
        self.component = component
        self.sent: dict[str, int] = {}
        self._sequence = 0
        self._packer = mavlink.MAVLink(None, srcSystem=SYSTEM_ID, srcComponent=component)

    def raw(self, kind: Any, payload: bytes) -> bytes:
        """Frame a payload that is packed already; ``kind`` is pymavlink's message class."""
        body = payload.rstrip(b"\0") or b"\0"
        number = kind.id
        head = _HEADER.pack(
            0xFD, len(body), 0, 0, self._sequence, SYSTEM_ID, self.component, number & 0xFFFF, number >> 16
        )
        self._count(kind.msgname)
        checksum = mavlink.x25crc(head[1:] + body + bytes((kind.crc_extra,))).crc
        return bytes(head + body + checksum.to_bytes(2, "little"))

    def message(self, message: Any) -> bytes:
        """Frame a pymavlink message."""
        self._packer.seq = self._sequence
        self._count(message.get_type())
        return bytes(message.pack(self._packer))

    def _count(self, name: str) -> None:
        self.sent[name] = self.sent.get(name, 0) + 1
        self._sequence = (self._sequence + 1) & 0xFF


@dataclass(frozen=True, slots=True)
class InertialFormat:
    """How one inertial message carries stamp and values.

    ``stamp`` packs the leading stamp; ``pack`` gives the rest of the payload, (n,) byte strings for (n, 6) values in
    sensor axes.
    """

    kind: Any
    unit_ns: int
    stamp: struct.Struct
    pack: Callable[[Floats, int], list[bytes]]


def inertial_format(message: str) -> InertialFormat:
    """Look a message up; raise :class:`ConfigError` for one that the simulator cannot send."""
    if message == "HIGHRES_IMU":
        return InertialFormat(mavlink.MAVLink_highres_imu_message, 1000, struct.Struct("<Q"), _pack_highres)
    if message == "RAW_IMU":
        return InertialFormat(mavlink.MAVLink_raw_imu_message, 1000, struct.Struct("<Q"), _pack_raw)
    scaled = {
        "SCALED_IMU": mavlink.MAVLink_scaled_imu_message,
        "SCALED_IMU2": mavlink.MAVLink_scaled_imu2_message,
        "SCALED_IMU3": mavlink.MAVLink_scaled_imu3_message,
    }
    if message in scaled:
        return InertialFormat(scaled[message], 1_000_000, struct.Struct("<I"), _pack_scaled)
    raise ConfigError(f"the simulator sends HIGHRES_IMU, RAW_IMU and SCALED_IMU*, not '{message}'")


def sensor_axes(values: Floats, source: Source) -> Floats:
    """Turn body axes (n, 6) into the sensor's own, the inverse of the mapping ``source.axes``."""
    out = np.zeros_like(values)
    for body, entry in enumerate(source.axes):
        sign = -1.0 if entry.startswith("-") else 1.0
        axis = _AXES.index(entry[-1])
        out[:, axis] = sign * values[:, body]
        out[:, 3 + axis] = sign * values[:, 3 + body]
    return out


def payloads(values_body: Floats, source: Source) -> list[bytes]:
    """Pack body-axis values (n, 6) as payloads without their stamps."""
    instance = int(source.instance) if source.instance.isdigit() else 0
    return inertial_format(source.message).pack(sensor_axes(values_body, source), instance)


def stamped(form: InertialFormat, stamp_ns: int, rest: bytes) -> bytes:
    """Join a stamp and the rest of a payload."""
    return form.stamp.pack(stamp_ns // form.unit_ns) + rest


def _split(block: bytes, count: int) -> list[bytes]:
    size = len(block) // count if count else 0
    return [block[i * size : (i + 1) * size] for i in range(count)]


def _pack_highres(values: Floats, instance: int) -> list[bytes]:
    rows = np.zeros(len(values), dtype=[("v", "<f4", 13), ("fields", "<u2"), ("id", "u1")])
    rows["v"][:, :6] = values
    rows["fields"], rows["id"] = _ALL_FIELDS, instance
    return _split(rows.tobytes(), len(values))


def _pack_raw(values: Floats, instance: int) -> list[bytes]:
    rows = np.zeros(len(values), dtype=[("v", "<i2", 9), ("id", "u1"), ("temperature", "<i2")])
    rows["v"][:, :6] = _int16_counts(values)
    rows["id"] = instance
    return _split(rows.tobytes(), len(values))


def _pack_scaled(values: Floats, instance: int) -> list[bytes]:
    del instance
    rows = np.zeros(len(values), dtype=[("v", "<i2", 10)])
    rows["v"][:, :6] = _int16_counts(values)
    return _split(rows.tobytes(), len(values))


def _int16_counts(values: Floats) -> Floats:
    """Milli-g and mrad/s as an int16 holds them."""
    units = np.repeat([MILLI_G_MPS2, MILLI_RADPS], 3)
    return np.asarray(np.clip(np.round(values / units), -32768, 32767))

"""Hands on the inertial samples that a vehicle sends: one that lies, 20 ms of noise, 20 ms of a blow that never was."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

ROOT, LEFT, RIGHT = 1, 200, 201
_BURST_US = 20_000
_FIELDS = ("xacc", "yacc", "zacc", "xgyro", "ygyro", "zgyro")
_VERSION_2, _COMPONENT, _SEQUENCE, _IDENTITY = 0xFD, 6, 4, slice(7, 10)


@dataclass
class Hand:
    """Alters the fields of one component's HIGHRES_IMU by ``change(value, seconds since the first, rng)``.

    It strikes for ``length_us`` of the sender's own time; 0 is a single sample.
    """

    component: int
    fields: tuple[str, ...]
    change: Callable[[float, float, np.random.Generator], float]
    length_us: int = 0
    _since_us: list[int] = field(default_factory=list)

    def __call__(self, frames: list[bytes], rng: np.random.Generator) -> list[bytes]:
        return [self._altered(frame, rng) if self._concerns(frame) else frame for frame in frames]

    def _concerns(self, frame: bytes) -> bool:
        identity = int.from_bytes(frame[_IDENTITY], "little")
        from_component = frame[0] == _VERSION_2 and frame[_COMPONENT] == self.component
        return from_component and identity == mavlink.MAVLINK_MSG_ID_HIGHRES_IMU

    def _altered(self, frame: bytes, rng: np.random.Generator) -> bytes:
        message = mavlink.MAVLink(None).decode(bytearray(frame))
        if not self._since_us:
            self._since_us.append(message.time_usec)
        elapsed_us = message.time_usec - self._since_us[0]
        if elapsed_us > self.length_us:
            return frame
        for name in self.fields:
            setattr(message, name, self.change(getattr(message, name), 1e-6 * elapsed_us, rng))
        packer = mavlink.MAVLink(None, message.get_srcSystem(), self.component)
        packer.seq = frame[_SEQUENCE]
        return bytes(message.pack(packer))


def lie(component: int, name: str, by: float) -> Callable[[], Hand]:
    """One sample off by so much."""
    return lambda: Hand(component, (name,), lambda value, _, rng: value + by)


def says(component: int, name: str, value: float) -> Callable[[], Hand]:
    """One sample of that value."""
    return lambda: Hand(component, (name,), lambda _, t_s, rng: value)


def noise(component: int, fields: tuple[str, ...], amplitude: float) -> Callable[[], Hand]:
    """20 ms of noise, evenly spread to the amplitude on either side."""
    return lambda: Hand(component, fields, lambda value, _, rng: value + rng.uniform(-amplitude, amplitude), _BURST_US)


def half_sine(component: int, name: str, peak: float) -> Callable[[], Hand]:
    """20 ms of a blow that only this sensor tells."""

    def change(value: float, t_s: float, rng: np.random.Generator) -> float:
        return value - peak * float(np.sin(np.pi * t_s * 1e6 / _BURST_US))

    return lambda: Hand(component, (name,), change, _BURST_US)


HANDS: dict[str, Callable[[], Hand]] = {
    **{f"root z {by:+g} m/s2, one sample": lie(ROOT, "zacc", by) for by in (-4.0, 2.0, 8.0)},
    "left z -4 m/s2, one sample": lie(LEFT, "zacc", -4.0),
    "root p +0.5 rad/s, one sample": lie(ROOT, "xgyro", 0.5),
    "right p +0.5 rad/s, one sample": lie(RIGHT, "xgyro", 0.5),
    **{f"root z {value:g} m/s2, one sample": says(ROOT, "zacc", value) for value in (100.0, 1e6, 1e20, 1e30)},
    "left z 1e+30 m/s2, one sample": says(LEFT, "zacc", 1e30),
    "root p 10 rad/s, one sample": says(ROOT, "xgyro", 10.0),
    "left p 10 rad/s, one sample": says(LEFT, "xgyro", 10.0),
    "root z +-5 m/s2, 20 ms": noise(ROOT, ("zacc",), 5.0),
    "left z +-5 m/s2, 20 ms": noise(LEFT, ("zacc",), 5.0),
    "right, all axes +-5, 20 ms": noise(RIGHT, _FIELDS, 5.0),
    "root's rates +-0.5 rad/s, 20 ms": noise(ROOT, _FIELDS[3:], 0.5),
    **{f"root z tells a blow of {peak:g} m/s2": half_sine(ROOT, "zacc", peak) for peak in (1.0, 10.0)},
}
BLOWS_MPS2 = (1.0, 3.0, 10.0)

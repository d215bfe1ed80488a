"""Obstacles as ArduCopter's MAVLink proximity driver takes them (AP_Proximity_MAV.cpp, 4.7); ArduPlane has none."""

from __future__ import annotations

import math
from typing import Any

_TIMEOUT_NS = 500_000_000  # ArduPilot's PROXIMITY_MAV_TIMEOUT_MS
_UNKNOWN = 65535  # OBSTACLE_DISTANCE: nothing known (by definition)
_BODY_FRD = 12  # MAV_FRAME_BODY_FRD


class Proximity:
    """Nearest distances by bearing, degrees clockwise from forward; forgotten after half a second of silence.

    OBSTACLE_DISTANCE acts at once. Points of OBSTACLE_DISTANCE_3D act together, when the next stamp arrives.
    """

    def __init__(self) -> None:
        self.looks = 0
        self._nearest_m: dict[int, float] = {}
        self._heard_ns: int | None = None
        self._stamp_ms: int | None = None
        self._gathering: dict[int, float] = {}

    def alive(self, boot_ns: int) -> bool:
        """Whether something was heard lately, which is what the arming check asks."""
        return self._heard_ns is not None and boot_ns - self._heard_ns <= _TIMEOUT_NS

    def nearest_m(self, boot_ns: int) -> dict[int, float]:
        """Obstacles that are believed now: bearing in degrees to distance."""
        return dict(self._nearest_m) if self.alive(boot_ns) else {}

    def circle(self, message: Any, boot_ns: int) -> None:
        """Take OBSTACLE_DISTANCE: 0, 65535 and what lies beyond the largest distance are no data; frame is ignored."""
        step = message.increment_f or message.increment
        if not step or not math.isfinite(step):
            return
        self._hear(boot_ns)
        self._nearest_m = {
            round(index * step + message.angle_offset) % 360: entry * 0.01
            for index, entry in enumerate(message.distances)
            if entry not in (0, _UNKNOWN) and message.min_distance <= entry <= message.max_distance
        }
        self.looks += 1

    def point(self, message: Any, boot_ns: int) -> None:
        """Take OBSTACLE_DISTANCE_3D: body FRD alone, within its limits; a new stamp publishes what was gathered."""
        if message.frame != _BODY_FRD:
            return
        self._hear(boot_ns)
        if self._stamp_ms is not None and message.time_boot_ms != self._stamp_ms:
            self._nearest_m, self._gathering = self._gathering, {}
            self.looks += 1
        self._stamp_ms = message.time_boot_ms
        distance = math.sqrt(message.x**2 + message.y**2 + message.z**2)
        if distance > 0 and message.min_distance <= distance <= message.max_distance:
            bearing = round(math.degrees(math.atan2(message.y, message.x))) % 360
            self._gathering[bearing] = min(distance, self._gathering.get(bearing, math.inf))

    def _hear(self, boot_ns: int) -> None:
        if not self.alive(boot_ns):
            self._nearest_m, self._gathering = {}, {}
        self._heard_ns = boot_ns

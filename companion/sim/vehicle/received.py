"""Companion's messages as the simulated flight controller takes them: used, refused, counted, stored for scoring."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from companion.sim.vehicle.proximity import Proximity
from companion.sim.vehicle.wire import AUTOPILOT_ID, SYSTEM_ID

_TIMEOUT_NS = 500_000_000  # ArduPilot's AP_RANGEFINDER_MAVLINK_TIMEOUT_MS
_CENTIMETRE_M = 0.01  # by definition
_SECTORS = 72  # OBSTACLE_DISTANCE.distances (by definition)
_UNKNOWN = 65535  # OBSTACLE_DISTANCE: nothing known (by definition)
_BODY_FRD = 12  # MAV_FRAME_BODY_FRD
_MOST_PROBLEMS = 50  # bound of memory: problems that are kept for the report


@dataclass(frozen=True, slots=True)
class ReceivedRange:
    """One DISTANCE_SENSOR as it arrived."""

    arrival_boot_ns: int
    arrival_host_ns: int
    time_boot_ms: int
    distance_m: float
    covariance: int
    quality: int
    orientation: int
    component: int
    used: bool


@dataclass(slots=True)
class Received:
    """Counts and lists of one flight.

    ``orientation``, ``min_m`` and ``max_m`` are RNGFND1_ORIENT, _MIN and _MAX; ``proximity`` is there with PRX1_TYPE 2.
    """

    orientation: int
    min_m: float
    max_m: float
    counts: Counter[str] = field(default_factory=Counter)
    ranges: list[ReceivedRange] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    named: dict[str, float] = field(default_factory=dict)
    states: list[tuple[int, int]] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    timeouts: int = 0
    proximity: Proximity | None = None
    _last_range_ns: int | None = None
    _sector_stamp: int = -1

    def take(self, message: Any, boot_ns: int, host_ns: int) -> None:
        """Check and keep one message."""
        name = message.get_type()
        self.counts[name] += 1
        if (message.get_srcSystem(), message.get_srcComponent()) == (SYSTEM_ID, AUTOPILOT_ID):
            # ArduPilot drops what claims to be from itself, silently
            self._problem(f"{name} claims to come from the autopilot itself")
            return
        handler = getattr(self, f"_take_{name.lower()}", None)
        if handler is not None:
            handler(message, boot_ns, host_ns)

    def expire(self, boot_ns: int) -> None:
        """Clear the rangefinder after half a second of silence."""
        if self._last_range_ns is not None and boot_ns - self._last_range_ns > _TIMEOUT_NS:
            self.timeouts += 1
            self._last_range_ns = None

    @property
    def has_range_data(self) -> bool:
        """Whether the rangefinder is alive, which is what the arming check asks."""
        return self._last_range_ns is not None

    @property
    def rangefinder(self) -> ReceivedRange | None:
        """Current range of the rangefinder: the last of its orientation, while it is alive."""
        if self._last_range_ns is None:
            return None
        return next((entry for entry in reversed(self.ranges) if entry.orientation == self.orientation), None)

    def _take_distance_sensor(self, message: Any, boot_ns: int, host_ns: int) -> None:
        distance = message.current_distance * _CENTIMETRE_M
        fits = message.orientation == self.orientation
        used = fits and message.signal_quality != 1 and self.min_m <= distance <= self.max_m
        if fits:
            self._last_range_ns = boot_ns
        if message.min_distance > message.max_distance:
            self._problem("DISTANCE_SENSOR: min_distance > max_distance")
        if message.signal_quality > 100:
            self._problem(f"DISTANCE_SENSOR: signal_quality {message.signal_quality}")
        self.ranges.append(
            ReceivedRange(
                boot_ns,
                host_ns,
                message.time_boot_ms,
                distance,
                message.covariance,
                message.signal_quality,
                message.orientation,
                message.get_srcComponent(),
                used,
            )
        )

    def _take_obstacle_distance(self, message: Any, boot_ns: int, host_ns: int) -> None:
        del host_ns
        if self.proximity is not None:
            self.proximity.circle(message, boot_ns)
        step = message.increment_f or message.increment
        if message.frame != _BODY_FRD:
            self._problem(f"OBSTACLE_DISTANCE: frame {message.frame}, not body FRD")
        if not math.isfinite(step) or not step * len(message.distances) <= 360.01 or step <= 0:
            self._problem(f"OBSTACLE_DISTANCE: increment {step}")
        if len(message.distances) != _SECTORS:
            self._problem(f"OBSTACLE_DISTANCE: {len(message.distances)} sectors")
        limit = message.max_distance + 1
        if any(entry > limit and entry != _UNKNOWN for entry in message.distances):
            self._problem("OBSTACLE_DISTANCE: a distance beyond max + 1 that is not 65535")

    def _take_obstacle_distance_3d(self, message: Any, boot_ns: int, host_ns: int) -> None:
        del host_ns
        if self.proximity is not None:
            self.proximity.point(message, boot_ns)
        if not all(math.isfinite(value) for value in (message.x, message.y, message.z)):
            # this crashes a real arducopter
            self._problem("OBSTACLE_DISTANCE_3D: coordinate not finite")
        if message.frame != _BODY_FRD:
            self._problem(f"OBSTACLE_DISTANCE_3D: frame {message.frame}, not body FRD")
        if message.time_boot_ms < self._sector_stamp:
            self._problem("OBSTACLE_DISTANCE_3D: stamp went back")
        self._sector_stamp = message.time_boot_ms

    def _take_named_value_float(self, message: Any, boot_ns: int, host_ns: int) -> None:
        del boot_ns, host_ns
        if not math.isfinite(message.value):
            self._problem(f"NAMED_VALUE_FLOAT {message.name}: not finite")
        self.named[message.name] = message.value

    def _take_heartbeat(self, message: Any, boot_ns: int, host_ns: int) -> None:
        del host_ns
        self.states.append((boot_ns, message.system_status))

    def _take_statustext(self, message: Any, boot_ns: int, host_ns: int) -> None:
        del boot_ns, host_ns
        self.texts.append(message.text)

    def _problem(self, text: str) -> None:
        self.counts["problems"] += 1
        if len(self.problems) < _MOST_PROBLEMS:
            self.problems.append(text)

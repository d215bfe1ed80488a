"""Ranges and obstacles as they go out: at most at their rate, never an old number, stamps that advance.

A range is that of an exposure, which the smoother's lag and the matching put half a second and more into the past, and
the autopilots take DISTANCE_SENSOR for the present, whatever its stamp says. A downward range is therefore moved on to
the instant of sending by the climb rate that the autopilot has told since: a descent at 2 m/s would else read 1 m long.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from typing import Any

from companion.adapters.mavlink.component import encode
from companion.params.settings import Settings
from companion.rate_limiter import RateLimiter
from companion.records import CorrectedRange, NoRange, ObstacleSectors, VehicleState
from companion.units import Orientation

_CLIMBS = 32  # some seconds of states at the usual rates (choice)
_CIRCLE, _POINTS = 1, 2  # values of the tunable OUT_OBSTACLES' setting ``obstacles`` (convention)
_RESTARTED_MS = 1000  # a stamp that is a second back is of a clock that begins anew (choice)
_CLIMB_SIGMA_MPS = 0.3  # of a told climb rate, and of level ground under an aircraft in flight (choice)
_OLDEST_NS = 2_000_000_000  # a range older than this is not moved on (choice)
_EARLY = 0.7  # of a period: what comes a little early is not dropped, or every other message would be (choice)


class RangePublisher:
    """Makes the messages of one vehicle.

    A change between "here is a range" and "alive, no range" goes out at once; more of the same waits for its turn.
    """

    def __init__(self, settings: Settings, orientation: int) -> None:
        self._settings = settings
        self._forward = orientation == Orientation.FORWARD
        self._looks_down = orientation == Orientation.DOWN
        self._climbs: deque[tuple[int, float]] = deque(maxlen=_CLIMBS)
        self._limiter = RateLimiter(0.0)
        self._trusted = False
        self._points_ms = 0

    def adopt(self, settings: Settings) -> None:
        """Use changed live settings from now on."""
        self._settings = settings

    def climbs(self, state: VehicleState) -> None:
        """Note the climb rate that the autopilot tells."""
        self._climbs.append((state.received_host_ns, state.climb_mps))

    def messages(
        self, record: CorrectedRange | NoRange | ObstacleSectors, boot_offset_ns: int, now_host_ns: int
    ) -> list[Any]:
        """Messages of a record; ``boot_offset_ns`` is the autopilot's boot time less host time."""
        limits_m = (self._settings.min_range_m, self._settings.max_range_m)
        if isinstance(record, ObstacleSectors):
            return self._obstacles(record, boot_offset_ns, now_host_ns)
        if isinstance(record, CorrectedRange):
            record = self._moved_on(record, now_host_ns)
            at_ns = record.t_host_ns
            message = encode.distance_sensor(record, *limits_m, (at_ns + boot_offset_ns) // 1_000_000)
        else:
            at_ns = record.at_host_ns
            message = encode.no_range(record.orientation, *limits_m, (at_ns + boot_offset_ns) // 1_000_000)
        trusted = message.signal_quality != encode.NO_RANGE_QUALITY
        changed, self._trusted = trusted != self._trusted, trusted
        messages = [message] if self._due("range", now_host_ns) or changed else []
        if isinstance(record, NoRange) and self._forward:
            nothing = encode.unknown_sectors(record.at_host_ns, *limits_m)
            messages += self._obstacles(nothing, boot_offset_ns, now_host_ns)
        return messages

    def _moved_on(self, record: CorrectedRange, now_host_ns: int) -> CorrectedRange:
        """The range at the instant of sending, by the climb rates since its exposure; as it is where none was told."""
        age_ns = now_host_ns - record.t_host_ns
        since = [climb_mps for t_ns, climb_mps in self._climbs if record.t_host_ns <= t_ns <= now_host_ns]
        if not (self._looks_down and since and 0 < age_ns <= _OLDEST_NS):
            return record
        age_s = 1e-9 * age_ns
        range_m = record.range_m + age_s * sum(since) / len(since)
        sigma_m = math.hypot(record.sigma_m, _CLIMB_SIGMA_MPS * age_s)
        return dataclasses.replace(record, t_host_ns=now_host_ns, range_m=range_m, sigma_m=sigma_m)

    def _obstacles(self, record: ObstacleSectors, boot_offset_ns: int, now_host_ns: int) -> list[Any]:
        form, boot_ns = self._settings.obstacles, record.t_host_ns + boot_offset_ns
        if form not in (_CIRCLE, _POINTS) or not self._due("obstacles", now_host_ns):
            return []
        if form == _CIRCLE:
            return [encode.obstacle_distance(record, boot_ns // 1000)]
        stamp_ms = boot_ns // 1_000_000
        if stamp_ms > self._points_ms - _RESTARTED_MS:  # else the autopilot has restarted, and counts from 0 again
            stamp_ms = max(stamp_ms, self._points_ms + 1)
        self._points_ms = stamp_ms
        return encode.obstacle_points(record, stamp_ms)

    def _due(self, what: str, now_host_ns: int) -> bool:
        return self._limiter.take(now_host_ns, what, _EARLY * 1e9 / self._settings.publish_rate_hz)

"""Ranges and obstacles as they go out: at most at their rate, never an old number, stamps that advance.

A range is that of an exposure, which the smoother's lag and the matching put half a second and more into the past, and
the autopilots take DISTANCE_SENSOR and obstacles for the present, whatever their stamps say. They are moved on to the
instant of sending by what the autopilot has told since: a downward range by the climb rate (a descent at 2 m/s
would else read 1 m long), what lies ahead by the speed towards it (at 20 m/s it would read 12 m too far). Where the
autopilot has not told for long how it moves, or so vaguely that the sigma of the way exceeds what is trusted, the
range of then is not the range of now, and none goes out.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from typing import Any

import numpy as np

from companion.adapters.mavlink.component import encode
from companion.params.settings import Settings
from companion.rate_limiter import RateLimiter
from companion.records import CorrectedRange, NoRange, ObstacleSectors, VehicleState
from companion.units import Orientation

_STATES = 32  # some seconds at the usual rates (choice)
_CIRCLE, _POINTS = 1, 2  # values of the tunable OUT_OBSTACLES' setting ``obstacles`` (convention)
_RESTARTED_MS = 1000  # a stamp that is a second back is of a clock that begins anew (choice)
_SPEED_SIGMA_MPS = 0.3  # of a told climb rate or velocity, and of level ground under an aircraft in flight (choice)
_WIND_SIGMA_MPS = 3.0  # of the airspeed as speed over ground (choice, as for the flow: core/stereo/README.md)
_EARLIER_SIGMA_MPS = 3.0  # of a speed that was told before the exposure alone: a push-over of 3 m/s^2 (choice)
_UNTOLD_MPS2 = 3.0  # by so much a speed may change while none is told: the same push-over (choice)
_FLARE_SIGMA_M = 0.3  # is trusted at any range: near the ground RNG_TRUST would leave a flare no range (choice)
_OLDEST_NS = 2_000_000_000  # neither an older range is moved on, nor any by an older speed (choice)
_SECTORS_LAST_NS = 400_000_000  # chosen: as a range does (core/output_scheduler.py)
_EARLY = 0.7  # of a period: what comes a little early is not dropped, or every other message would be (choice)


class RangePublisher:
    """Makes the messages of one vehicle.

    A change between "here is a range" and "alive, no range" goes out at once; more of the same waits for its turn.
    """

    def __init__(self, settings: Settings, orientation: int) -> None:
        self._settings = settings
        self._forward = orientation == Orientation.FORWARD
        self._looks_down = orientation == Orientation.DOWN
        self._states: deque[VehicleState] = deque(maxlen=_STATES)
        self._limiter = RateLimiter(0.0)
        self._trusted = False
        self._points_ms = 0
        self._px4 = False
        self._sectors_until_ns = 0

    def adopt(self, settings: Settings) -> None:
        """Use changed live settings from now on."""
        self._settings = settings

    def note_motion(self, state: VehicleState) -> None:
        """Note how the aircraft moves, as the autopilot tells it."""
        self._states.append(state)

    def messages(
        self,
        record: CorrectedRange | NoRange | ObstacleSectors,
        boot_offset_ns: int,
        now_host_ns: int,
        *,
        px4: bool = False,
    ) -> list[Any]:
        """Messages of a record; ``boot_offset_ns`` is the autopilot's boot time less host time, ``px4`` its kind."""
        self._px4 = px4
        limits_m = (self._settings.min_range_m, self._settings.max_range_m)
        if isinstance(record, ObstacleSectors):
            self._sectors_until_ns = now_host_ns + _SECTORS_LAST_NS
            sectors = self._sectors_moved_on(record, now_host_ns) or encode.unknown_sectors(now_host_ns, *limits_m)
            return self._obstacles(sectors, boot_offset_ns, now_host_ns)
        moved = self._moved_on(record, now_host_ns) if isinstance(record, CorrectedRange) else None
        if moved is not None:
            at_ns = moved.t_host_ns
            message = encode.distance_sensor(moved, *limits_m, (at_ns + boot_offset_ns) // 1_000_000)
        else:
            at_ns = record.at_host_ns if isinstance(record, NoRange) else now_host_ns
            message = encode.no_range(record.orientation, *limits_m, (at_ns + boot_offset_ns) // 1_000_000)
        trusted = message.signal_quality != encode.NO_RANGE_QUALITY
        changed, self._trusted = trusted != self._trusted, trusted
        messages = [message] if self._due("range", now_host_ns) or changed else []
        if isinstance(record, NoRange) and self._forward and now_host_ns >= self._sectors_until_ns:
            nothing = encode.unknown_sectors(record.at_host_ns, *limits_m)
            messages += self._obstacles(nothing, boot_offset_ns, now_host_ns)
        return messages

    def _moved_on(self, record: CorrectedRange, now_host_ns: int) -> CorrectedRange | None:
        """The range at the instant of sending; None where it is not told how the aircraft has moved meanwhile."""
        if not (self._forward or self._looks_down) or record.t_host_ns >= now_host_ns:
            return record
        moved = self._approached(record.t_host_ns, now_host_ns)
        if moved is None:
            return None
        nearer_m, sigma_m = moved
        range_m = record.range_m - nearer_m
        if self._forward and record.range_m >= self._settings.min_range_m:
            range_m = max(range_m, self._settings.min_range_m)  # what is too near to measure by now is still there
        sigma_m = math.hypot(record.sigma_m, sigma_m)
        if not self._is_precise(range_m, sigma_m):
            return None
        return dataclasses.replace(record, t_host_ns=now_host_ns, range_m=range_m, sigma_m=sigma_m)

    def _sectors_moved_on(self, record: ObstacleSectors, now_host_ns: int) -> ObstacleSectors | None:
        """The obstacles at the instant of sending, each by its part of the way that was flown ahead; None: not told."""
        if not self._forward or record.t_host_ns >= now_host_ns:
            return record
        moved = self._approached(record.t_host_ns, now_host_ns)
        if moved is None:
            return None
        ahead = np.cos(2.0 * np.pi * np.arange(len(record.distance_m)) / len(record.distance_m))
        distance_m = np.maximum(record.distance_m - moved[0] * ahead, np.minimum(record.distance_m, record.min_m))
        sigma_m = np.hypot(record.sigma_m, moved[1] * ahead)
        precise = record.known & self._is_precise(distance_m, sigma_m)
        moved_on = {"distance_m": distance_m, "sigma_m": sigma_m, "known": precise}
        return dataclasses.replace(record, t_host_ns=now_host_ns, **moved_on)

    def _is_precise(self, range_m: Any, sigma_m: Any) -> Any:
        """Whether a range, or each of several, is still trusted with the sigma that being moved on has left.

        What lies ahead and is too near to measure by now is told in any case: that it is near needs no sigma.
        """
        trusted = sigma_m <= np.maximum(self._settings.trust_ratio * range_m, _FLARE_SIGMA_M)
        return trusted | (self._forward & (range_m <= self._settings.min_range_m))

    def _approached(self, t_host_ns: int, now_host_ns: int) -> tuple[float, float] | None:
        """How much nearer something that stands still has come since an exposure, and its sigma, m; None: not told."""
        age_ns = now_host_ns - t_host_ns
        known_ns = [(self._speed_host_ns(state), state) for state in self._states]
        recent = [row for row in known_ns if now_host_ns - _OLDEST_NS <= row[0] <= now_host_ns]
        if age_ns > _OLDEST_NS or not recent:
            return None
        since = [row for row in recent if row[0] >= t_host_ns]
        speeds = [
            (-state.climb_mps, _SPEED_SIGMA_MPS) if self._looks_down else _speed_ahead(state)
            for _, state in since or recent[-1:]
        ]
        speed_mps, sigma_mps = np.mean(speeds, axis=0).tolist()
        sigma_mps = sigma_mps if since else math.hypot(sigma_mps, _EARLIER_SIGMA_MPS)
        untold_s = 1e-9 * (now_host_ns - max(host_ns for host_ns, _ in recent))
        sigma_m = math.hypot(1e-9 * age_ns * sigma_mps, 0.5 * _UNTOLD_MPS2 * untold_s**2)
        return 1e-9 * age_ns * speed_mps, sigma_m

    def _speed_host_ns(self, state: VehicleState) -> int:
        """When the speed was received that moves the ranges: climb and airspeed may be older than their attitude."""
        is_of_air = self._looks_down or state.velocity_ned_mps is None
        return state.air_host_ns if is_of_air and state.air_host_ns is not None else state.received_host_ns

    def _obstacles(self, record: ObstacleSectors, boot_offset_ns: int, now_host_ns: int) -> list[Any]:
        form, boot_ns = self._settings.obstacles, record.t_host_ns + boot_offset_ns
        if form not in (_CIRCLE, _POINTS) or not self._due("obstacles", now_host_ns):
            return []
        if form == _CIRCLE:
            return [encode.obstacle_distance(record, boot_ns // 1000, px4=self._px4)]
        stamp_ms = boot_ns // 1_000_000
        if stamp_ms > self._points_ms - _RESTARTED_MS:  # else the autopilot has restarted, and counts from 0 again
            stamp_ms = max(stamp_ms, self._points_ms + 1)
        self._points_ms = stamp_ms
        return encode.obstacle_points(record, stamp_ms)

    def _due(self, what: str, now_host_ns: int) -> bool:
        return self._limiter.take(now_host_ns, what, _EARLY * 1e9 / self._settings.publish_rate_hz)


def _speed_ahead(state: VehicleState) -> tuple[float, float]:
    """Speed over ground along the nose and its sigma, m/s; the airspeed where no velocity is told."""
    if state.velocity_ned_mps is None:
        return state.airspeed_mps, _WIND_SIGMA_MPS
    level = math.cos(state.pitch_rad)
    nose = (level * math.cos(state.yaw_rad), level * math.sin(state.yaw_rad), -math.sin(state.pitch_rad))
    sigma_mps = max(_SPEED_SIGMA_MPS, state.velocity_sigma_mps or 0.0)
    return sum(a * b for a, b in zip(nose, state.velocity_ned_mps, strict=True)), sigma_mps

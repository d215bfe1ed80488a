"""Watches over a flight: whenever something is not as it must be, the mission ends, and the vehicle is made safe."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Event

from mission_scripts.common.outcome import Aborted, Exit, HandsOff, Response
from mission_scripts.common.places import Place
from mission_scripts.common.watch import Watch

_FAILSAFE = 5  # MAV_STATE_CRITICAL, and above
_OFF_TRACK_S = 3.0


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of the flight; heights above home.

    Attributes
    ----------
    link_s
        Silence of the autopilot that counts as a lost link.
    off_track_m
        Distance from the leg being flown, for longer than three seconds.
    """

    floor_m: float = 20.0
    ceiling_m: float = 150.0
    radius_m: float = 1500.0
    battery: float = 0.3
    link_s: float = 4.0
    off_track_m: float = 80.0


@dataclass(slots=True)
class Guard:
    """:meth:`check` raises what ends the mission.

    Attributes
    ----------
    centre
        Of the radius; the place where the mission began.
    mode
        Mode in which the vehicle must be, None while it is being changed.
    changing
        While it is being changed, the modes before and after: any other is someone else's order.
    interrupted
        Set by Ctrl-C.
    off_track
        Gives the distance from the track, None where there is none.
    floor_m
        In force now; a take-off or a landing lowers it.
    more
        What the mission itself watches; raises.
    """

    watch: Watch
    limits: Limits
    interrupted: Event
    centre: Place
    mode: int | None = None
    changing: tuple[int, ...] = ()
    off_track: Callable[[], float | None] | None = None
    floor_m: float = field(init=False)
    more: Callable[[], None] | None = None
    _on_track_s: float = field(default_factory=time.monotonic)

    def __post_init__(self) -> None:
        self.floor_m = self.limits.floor_m

    def expected(self) -> tuple[int, ...]:
        """Modes that this script has ordered or found; none before it orders anything."""
        return self.changing if self.mode is None else (self.mode,)

    def check(self) -> None:
        """Look at everything once."""
        if self.interrupted.is_set():
            raise Aborted("Ctrl-C", code=Exit.INTERRUPTED)
        watch, limits = self.watch, self.limits
        if watch.age_s("HEARTBEAT") > limits.link_s:
            raise Aborted(f"link lost: no heartbeat for {watch.age_s('HEARTBEAT'):.1f} s", Response.RETURN)
        if self.mode is not None and watch.mode != self.mode:
            raise HandsOff(f"the vehicle left mode {self.mode} for {watch.mode}: pilot or failsafe")
        if self.mode is None and self.changing and watch.mode not in self.changing:
            raise HandsOff(f"the vehicle went to mode {watch.mode}, which nobody here ordered: pilot or failsafe")
        if watch.system_status >= _FAILSAFE:
            raise Aborted("the autopilot reports a failsafe (MAV_STATE critical)", Response.RETURN)
        if self.mode is not None and not watch.armed:
            raise HandsOff("the vehicle is disarmed")
        if watch.battery is not None and watch.battery < limits.battery:
            raise Aborted(f"battery at {watch.battery:.0%}, limit {limits.battery:.0%}", Response.RETURN)
        self._where()
        if self.more is not None:
            self.more()

    def _where(self) -> None:
        watch, limits = self.watch, self.limits
        if watch.age_s("GLOBAL_POSITION_INT") > limits.link_s:
            raise Aborted("no position any more", Response.RETURN)
        if watch.height_m < self.floor_m:
            raise Aborted(f"{watch.height_m:.0f} m above home, floor {self.floor_m:g} m", Response.RETURN)
        if watch.height_m > limits.ceiling_m:
            raise Aborted(f"{watch.height_m:.0f} m above home, ceiling {limits.ceiling_m:g} m")
        away = self.centre.distance_m(watch.place)
        if away > limits.radius_m:
            raise Aborted(f"{away:.0f} m from where the mission began, limit {limits.radius_m:g} m", Response.RETURN)
        off = self.off_track() if self.off_track is not None else None
        now_s = time.monotonic()
        if off is None or off <= limits.off_track_m:
            self._on_track_s = now_s
        elif now_s - self._on_track_s > _OFF_TRACK_S:
            raise Aborted(f"{off:.0f} m off the track, limit {limits.off_track_m:g} m")

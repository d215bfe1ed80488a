"""A flight in hand: orders that are watched until they show, waiting under guard, progress lines."""

from __future__ import annotations

import argparse
import contextlib
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from threading import Event
from typing import TextIO

from companion.params.airframe import Airframe
from mission_scripts.common.guard import Guard
from mission_scripts.common.outcome import Aborted, Exit, Refused
from mission_scripts.common.places import LOITER, TAKEOFF, Place, Route
from mission_scripts.common.recording import Tap, tap_is_enough
from mission_scripts.common.vehicle import AUTO, NotAccepted, Vehicle
from mission_scripts.common.vehicle import LOITER as LOITER_MODE
from mission_scripts.common.watch import Watch

_LOOK_S = 0.05
_LINE_S = 5.0
_MODE_S = 5.0
_SERVICE_S = 60.0
_RANGES_S = 5.0
_STREAM_S, _HOME_S = 6.0, 90.0
_ONTO_S = 15.0
_CIRCLE_LIMITS = 3.0  # chosen: circles of up to 240 m are no leaving of the track at the limit's default
_TAKE_OFF_S = 120.0
_ROLLING_MPS = 5.0  # chosen: airspeed from which a take-off is under way
_STANDING_M = 3.0  # chosen: what a barometer is off after the pre-arm checks, and a hand that carries the aircraft
_TURN_M = 70.0  # derived: width of a turn about at 18 m/s and 45 degrees of bank, 2 v^2 / g
_ABOVE_FLOOR = 1.1  # chosen: least height of a take-off over the floor, so that the circle there keeps off it
# message ids (MAVLink common.xml)
_IDS = {"SCALED_IMU": 26, "RAW_IMU": 27, "HIGHRES_IMU": 105, "SCALED_IMU2": 116, "SCALED_IMU3": 129}
# ATTITUDE, GLOBAL_POSITION_INT, VFR_HUD, TERRAIN_REPORT, SYS_STATUS, MISSION_CURRENT, HOME_POSITION, EXTENDED_SYS_STATE
_STREAMS = {30: 0.1, 33: 0.1, 74: 0.2, 136: 0.2, 1: 1.0, 42: 0.5, 242: 1.0, 245: 0.5}
_SLOWER = (1.0, 1.34, 1.67, 3.4, 6.7)  # factors of the interval that are tried after a denial


class Log:
    """Progress lines: on the terminal, and in a file beside the recording."""

    def __init__(self, path: Path) -> None:
        self._file: TextIO = path.open("w", encoding="utf-8")
        self._began_s = time.monotonic()

    def say(self, sentence: str) -> None:
        """One line, with the seconds since the script began; a full disk or a closed terminal ends no flight."""
        line = f"{time.monotonic() - self._began_s:7.1f} s  {sentence}"
        with contextlib.suppress(OSError):
            print(line, flush=True)
        with contextlib.suppress(OSError):
            self._file.write(line + "\n")
            self._file.flush()

    def close(self) -> None:
        """Finish the file."""
        with contextlib.suppress(OSError):
            self._file.close()


class Track:
    """Distance from the leg being flown, once the aircraft has come onto it: a circle is left some way beside it."""

    def __init__(self, route: Route, watch: Watch, limit_m: float) -> None:
        self._route, self._watch, self._limit_m = route, watch, limit_m
        self._item, self._since_s, self._onto = -1, 0.0, False

    def off_m(self) -> float | None:
        """In metres; None while there is no leg, the aircraft is still turning onto it, or circles at its end."""
        item, now_s = self._watch.item, time.monotonic()
        if item != self._item:
            self._item, self._since_s, self._onto = item, now_s, False
        off_m = self._route.off_track_m(item, self._watch.place)
        if off_m is None or self._route.circles(item, self._watch.place, _CIRCLE_LIMITS * self._limit_m):
            return None
        self._onto = self._onto or off_m < self._limit_m or now_s - self._since_s > _ONTO_S
        return off_m if self._onto else None


class Flight:
    """Flight in progress, as a mission script drives it.

    Attributes
    ----------
    options : argparse.Namespace
    airframe : Airframe
    watch, vehicle, guard
        What is heard, what can be ordered, who watches.
    engaged : bool
        Whether the vehicle has been commanded, so that an abort must make it safe.
    armed_here : bool
        Whether this script armed it, and its take-off is not over.
    """

    def __init__(
        self, options: argparse.Namespace, airframe: Airframe, watch: Watch, vehicle: Vehicle, guard: Guard, log: Log
    ) -> None:
        self.options, self.airframe = options, airframe
        self.watch, self.vehicle, self.guard = watch, vehicle, guard
        self.engaged = self.armed_here = False
        self._log = log

    def say(self, sentence: str) -> None:
        """One progress line."""
        self._log.say(sentence)

    def hear(self) -> None:
        """Show what the vehicle has said meanwhile."""
        while self.watch.texts:
            self._log.say(f"  vehicle: {self.watch.texts.popleft()}")

    # ------------------------------------------------------------------------------------------ waiting

    def wait(
        self, what: str, until: Callable[[], bool], timeout_s: float, tell: Callable[[], str] | None = None
    ) -> None:
        """Wait under guard; a line every few seconds.

        Raises
        ------
        Aborted
            It did not come about in time, or the guard says so.
        """
        began_s = time.monotonic()
        reported_s = began_s
        while not until():
            self.hear()
            self.guard.check()
            now_s = time.monotonic()
            if now_s - began_s > timeout_s:
                raise Aborted(f"{what}: not within {timeout_s:g} s")
            if now_s - reported_s >= _LINE_S:
                reported_s = now_s
                self.say(f"{what}: {tell() if tell else self.where()}")
            time.sleep(_LOOK_S)

    def where(self) -> str:
        """Height, airspeed and charge in words."""
        watch = self.watch
        charge = f", battery {watch.battery:.0%}" if watch.battery is not None else ""
        return f"{watch.height_m:.0f} m, {watch.airspeed_mps:.1f} m/s{charge}"

    # ------------------------------------------------------------------------------------------ before

    def prepare(self) -> None:
        """Ask for the streams that are needed, and look whether the vehicle can be flown by us.

        Raises
        ------
        Refused
            Something is missing; nothing has been commanded.
        """
        for number, period_s in _STREAMS.items():
            self.vehicle.ask_rate(number, period_s)
        watch = self.watch
        self._await_heard(("GLOBAL_POSITION_INT", "ATTITUDE", "VFR_HUD"), _STREAM_S)
        if watch.age_s("HOME_POSITION") == math.inf:
            self.say("waiting for the autopilot to know where it is (HOME_POSITION)")
        self._await_heard(("HOME_POSITION",), _HOME_S)
        if watch.battery is not None and watch.battery < self.guard.limits.battery:
            raise Refused(f"battery at {watch.battery:.0%}, limit {self.guard.limits.battery:.0%}")
        self.guard.centre = watch.place
        state = "airborne" if self.airborne else "on the ground"
        self.say(f"vehicle is {state}, {'armed' if watch.armed else 'disarmed'}, mode {watch.mode}, {self.where()}")

    def _await_heard(self, names: Sequence[str], within_s: float) -> None:
        """Refuse to go on without these messages of the autopilot."""
        ends_s = time.monotonic() + within_s
        missing = list(names)
        while missing:
            missing = [name for name in missing if self.watch.age_s(name) > _STREAM_S]
            if missing and time.monotonic() > ends_s:
                raise Refused(f"the autopilot does not send {', '.join(missing)}")
            if self.guard.interrupted.is_set():
                raise Aborted("Ctrl-C", code=Exit.INTERRUPTED)
            time.sleep(_LOOK_S)

    @property
    def stands(self) -> bool:
        """Whether it stands where this script armed it: disarming ends that, a mode does not."""
        return self.armed_here and self.watch.height_m < _STANDING_M and self.watch.airspeed_mps < _ROLLING_MPS

    @property
    def airborne(self) -> bool:
        """Armed, with height and airspeed."""
        return self.watch.armed and self.watch.height_m > 5.0 and self.watch.airspeed_mps > 5.0

    def ask_inertial(self, tap: Tap | None) -> None:
        """Ask the autopilot for the inertial messages that the airframe names, as fast as it will send them."""
        airframe = self.airframe
        airframe_rates_hz = {s.source.message: s.rate_hz for s in (airframe.root, airframe.left, airframe.right)
               if s.source.component == 1 and s.source.message in _IDS}  # fmt: skip
        if tap is None or not airframe_rates_hz:
            return
        for name, rate_hz in airframe_rates_hz.items():
            granted = next((k for k in _SLOWER if self.vehicle.ask_rate(_IDS[name], k / rate_hz)), None)
            outcome = f"{rate_hz / granted:.0f} Hz" if granted else "refused at every rate; what comes by itself"
            self.watch.texts.clear()  # the refusals of the faster rates
            self.say(f"{name}: {outcome}")
        if not tap_is_enough(airframe) and self.options.service is None:
            self.say(
                f"note: airframe '{airframe.name}' has wing nodes on clocks of their own; the tap alone cannot be "
                "estimated from, record with the service (--service LINK, or spanwise run --record)"
            )

    def await_service(self) -> None:
        """Give a service that was started with the mission the time to find its clocks; refuse to fly without it."""
        if self.options.service is None:
            return
        self.guard.floor_m, floor_m = -math.inf, self.guard.floor_m
        try:
            self.wait("the service's clocks", lambda: self.watch.companion_ready, _SERVICE_S, lambda: "not yet")
        except Aborted as error:
            if error.code is Exit.INTERRUPTED:
                raise
            raise Refused(str(error)) from error
        self.guard.floor_m = floor_m

    def need_ranges(self) -> None:
        """Refuse to begin without a companion that sends ranges (trusted or not)."""
        ends_s = time.monotonic() + _RANGES_S
        while time.monotonic() < ends_s:
            newest = self.watch.newest_range()
            if newest is not None and time.monotonic() - newest.at_s < 1.0:
                return
            time.sleep(_LOOK_S)
        who = "its heartbeat is here" if self.watch.companion_age_s() < 3.0 else "not even a heartbeat"
        raise Refused(
            f"no DISTANCE_SENSOR of component {self.options.companion} with orientation {self.airframe.orientation} "
            f"on this link ({who}): is the service running, with cameras?"
        )

    # ------------------------------------------------------------------------------------------ flying

    def be_airborne(self) -> None:
        """Take off if that was asked for; refuse to go on from the ground."""
        if self.airborne:
            return
        height_m = self.options.take_off
        if height_m is None:
            raise Refused("the vehicle is not flying: take off first, or give --take-off HEIGHT")
        limits = self.guard.limits
        if not max(0.0, _ABOVE_FLOOR * limits.floor_m) < height_m < limits.ceiling_m:
            raise Refused(
                f"--take-off {height_m:g} must lie above {_ABOVE_FLOOR:g} times --floor {limits.floor_m:g} "
                f"and below --ceiling {limits.ceiling_m:g}"
            )
        floor_m, self.guard.floor_m = self.guard.floor_m, -10.0
        self.wait("pre-arm checks", lambda: self.watch.may_arm, _HOME_S, lambda: "not passed yet")
        here = self.watch.place
        route = Route()
        route.add(TAKEOFF, here, height_m, 10.0)
        route.add(LOITER, here, height_m)
        self.vehicle.upload(route)
        self.engaged = self.armed_here = True
        self.vehicle.arm()
        self.wait("armed", lambda: self.watch.armed, _MODE_S)
        self._take_off(max(0.9 * height_m, 0.5 * (floor_m + height_m)))
        self.guard.floor_m, self.armed_here = floor_m, False

    def _take_off(self, until_m: float) -> None:
        """Fly the take-off; who interrupts it while it is low gets the abort at its end: RTL there turns at once."""

        def climbed() -> bool:
            return self.watch.height_m > until_m

        try:
            self.begin()
            self.wait("take-off", climbed, _TAKE_OFF_S)
        except Aborted as error:
            low = self.watch.height_m < self.guard.limits.floor_m
            if error.code is not Exit.INTERRUPTED or not low or self.watch.airspeed_mps < _ROLLING_MPS:
                raise
            self.say(f"{error}: low as it is, the vehicle finishes its take-off first; RC takes it sooner")
            caught, self.guard.interrupted = self.guard.interrupted, Event()  # a second signal changes nothing
            try:
                self.wait("take-off, then the abort", climbed, _TAKE_OFF_S)
            finally:
                self.guard.interrupted = caught
            raise

    def need_clear_way(self, start: Place, obstacle: Place, least_m: float) -> None:
        """Refuse a way to the start that leads past an obstacle, with the room of the turn toward the start added."""
        here, needed_m = self.watch.place, least_m + _TURN_M
        off_m = obstacle.off_way_m(here, start)
        if off_m < needed_m:
            raise Refused(
                f"the way to the start passes the obstacle at {off_m:.0f} m, least {needed_m:.0f} m: "
                "fly to its other side first, from where the start is reached without passing it"
            )

    def change_mode(self, number: int, order: Callable[[], None]) -> None:
        """Give an order that changes the mode, and wait until the heartbeat shows it."""
        self.engaged = True
        self.guard.mode, self.guard.changing = None, (self.watch.mode, number)
        order()
        self.wait(f"mode {number}", lambda: self.watch.mode == number, _MODE_S)
        self.guard.mode, self.guard.changing = number, ()

    def begin(self, number: int = 1) -> None:
        """Fly the uploaded mission from an item on."""
        self.watch.reached.clear()
        self.change_mode(AUTO, lambda: self.vehicle.start(number))

    def follow(
        self, route: Route, timeout_s: float, names: dict[int, str], each: Callable[[int], None] | None = None
    ) -> None:
        """Fly an uploaded mission until its last item, which circles for ever, is the current one.

        Parameters
        ----------
        route : Route
            What was uploaded.
        timeout_s : float
            For the whole of it.
        names : dict
            What to say when an item becomes current.
        each : callable, optional
            Called with the current item at every look.
        """
        said, track = 0, Track(route, self.watch, self.guard.limits.off_track_m)

        def at_last_item() -> bool:
            nonlocal said
            item = self.watch.item
            if item != said:
                said = item
                if item in names:
                    self.say(f"item {item} of {route.last}: {names[item]} ({self.where()})")
            if each is not None:
                each(item)
            return item >= route.last

        self.guard.off_track = track.off_m
        try:
            self.wait("mission", at_last_item, timeout_s)
        finally:
            self.guard.off_track = None

    def leave(self) -> None:
        """End well: circle where the mission ended."""
        self.change_mode(LOITER_MODE, self.vehicle.hold)
        self.say(f"done; the vehicle circles here in LOITER ({self.where()})")


def safe_order(order: Callable[[], None]) -> str | None:
    """Try an order; what went wrong, if anything."""
    try:
        order()
    except NotAccepted as error:
        return str(error)
    return None

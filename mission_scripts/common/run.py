"""Runs one mission from its command line to its exit code; whatever happens, the vehicle is safe and the file whole."""

from __future__ import annotations

import argparse
import contextlib
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event

from companion.numbered_files import free_path
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from mission_scripts.common.flight import Flight, Log, safe_order
from mission_scripts.common.guard import Guard
from mission_scripts.common.options import limits_from
from mission_scripts.common.outcome import Aborted, Exit, HandsOff, MissionError, Refused, Response
from mission_scripts.common.recording import ServiceRecorder, Tap, tap_is_enough
from mission_scripts.common.vehicle import LOITER, RTL, NotAccepted, Vehicle, check_kind
from mission_scripts.common.watch import Watch

Mission = Callable[[Flight], Exit]
_CONFIRM_S = 20.0
_TRY_S = 3.0


def run(options: argparse.Namespace, mission: Mission) -> int:
    """Connect, fly, end.

    Returns
    -------
    int
        An :class:`Exit`.
    """
    try:
        airframe = _airframe(options.airframe)
        options.out.mkdir(parents=True, exist_ok=True)
    except (Refused, OSError) as error:
        print(f"refused: {error}")
        return Exit.REFUSED
    log = Log(free_path(options.out / "mission.log"))
    try:
        with _interrupts() as interrupted:
            return _recorded(options, airframe, mission, log, interrupted)
    finally:
        log.close()


def _recorded(options: argparse.Namespace, airframe: Airframe, mission: Mission, log: Log, interrupted: Event) -> int:
    """Fly with the recordings open; close them whatever happens."""
    tap = None if options.no_tap else Tap(free_path(options.out / "flight.tlog"))
    service: ServiceRecorder | None = None
    code = Exit.REFUSED
    try:
        if options.service is not None:
            service = ServiceRecorder(options.service, options.airframe, free_path(options.out / "flight.mcap"))
            log.say(f"spanwise run records on {options.service}")
        code = _connected(options, airframe, mission, log, interrupted, tap)
    except (Refused, FileNotFoundError) as error:
        log.say(f"refused: {error}")
    except Aborted as error:
        log.say(f"{error} before anything was commanded")
        code = error.code
    finally:
        if tap is not None:
            tap.close()
            if tap.trouble is not None:
                log.say(f"{tap.path}: not everything was written: {tap.trouble}")
        if service is not None:
            log.say("waiting for the service to finish its recording")
            service.close()
    _log_recordings(log, options, airframe, tap, service)
    return code


def _connected(
    options: argparse.Namespace, airframe: Airframe, mission: Mission, log: Log, interrupted: Event, tap: Tap | None
) -> Exit:
    watch = Watch(options.companion, airframe.orientation)
    log.say(f"waiting for an autopilot on {options.connect}")
    vehicle = Vehicle(options.connect, watch, tap, options.wait, interrupted)
    try:
        check_kind(watch)
        guard = Guard(watch, limits_from(options), interrupted, watch.place)
        flight = Flight(options, airframe, watch, vehicle, guard, log)
        flight.prepare()
        flight.ask_inertial(tap)
        flight.await_service()
        return _fly(flight, mission)
    finally:
        vehicle.close()


def _fly(flight: Flight, mission: Mission) -> Exit:
    """The mission, and what becomes of the vehicle when it does not end well."""
    try:
        return mission(flight)
    except HandsOff as error:
        flight.say(f"HANDS OFF: {error}; nothing more is commanded")
        return Exit.HANDS_OFF
    except Aborted as error:
        flight.say(f"ABORT: {error}")
        return make_safe(flight, error.response or flight.options.on_abort, error.code)
    except NotAccepted as error:
        if not flight.engaged:
            raise Refused(str(error)) from error
        flight.say(f"ABORT: {error}")
        return make_safe(flight, flight.options.on_abort, Exit.ABORTED)
    except Exception as error:  # whatever it is, an aircraft that was commanded is not left to itself
        if not flight.engaged:
            raise
        what = str(error) if isinstance(error, MissionError) else f"{type(error).__name__}: {error}"
        flight.say(f"ABORT: {what}")
        return make_safe(flight, flight.options.on_abort, Exit.ABORTED)


def make_safe(flight: Flight, response: Response, code: Exit) -> Exit:
    """Order hold or RTL until the heartbeat shows it.

    Below the floor hold is RTL, for a circle there may meet the ground. One that stands where this script armed it is
    disarmed: RTL would let its motor run as soon as somebody carries it. Keeps trying while the link is away, and does
    nothing to a vehicle that was never commanded or that someone else has taken meanwhile.
    """
    if not flight.engaged:
        flight.say("the vehicle was not commanded by this script and is left as it is")
        return code if code is Exit.INTERRUPTED else Exit.REFUSED
    watch, guard = flight.watch, flight.guard
    if watch.height_m < guard.limits.floor_m:
        response = Response.RETURN
    wanted, order = (RTL, flight.vehicle.return_home) if response is Response.RETURN else (LOITER, flight.vehicle.hold)
    what, stands = response.value.upper(), flight.stands
    if stands:
        order, what = flight.vehicle.disarm, "DISARM"
    flight.say(f"ordering {what}")
    guard.interrupted.clear()
    ends_s = time.monotonic() + _CONFIRM_S
    while time.monotonic() < ends_s and not guard.interrupted.is_set():
        expected = guard.expected()
        if watch.age_s("HEARTBEAT") < 2.0 and expected and watch.mode not in (*expected, wanted):
            flight.say(f"HANDS OFF: the vehicle is in mode {watch.mode} by someone else's order")
            return Exit.HANDS_OFF
        trouble = safe_order(order)
        if trouble is not None:
            flight.say(f"  {trouble}; trying again")
        tried_s = time.monotonic()
        while time.monotonic() - tried_s < _TRY_S and not guard.interrupted.is_set():
            flight.hear()
            reached = not watch.armed if stands else watch.mode == wanted
            if reached and watch.age_s("HEARTBEAT") < 2.0:
                flight.say(f"the vehicle confirms {what} ({flight.where()})")
                return code
            time.sleep(0.05)
    flight.say("NOT CONFIRMED: take the vehicle by RC, or rely on its own failsafe")
    return Exit.NOT_CONFIRMED


@contextlib.contextmanager
def _interrupts() -> Iterator[Event]:
    """Ctrl-C, SIGTERM and a terminal that goes set an event and tear nothing apart; a second one ends the waiting."""
    caught = Event()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    for number in before:
        signal.signal(number, lambda *_: caught.set())
    try:
        yield caught
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _airframe(name: str) -> Airframe:
    try:
        return load_airframe(name)
    except Exception as error:  # whatever is wrong with the file, its sentence is what the user needs
        raise Refused(str(error)) from error


def _log_recordings(
    log: Log, options: argparse.Namespace, airframe: Airframe, tap: Tap | None, service: ServiceRecorder | None
) -> None:
    """Say which file to go on with, and how."""
    best: Path | None = None
    if tap is not None:
        log.say(f"{tap.path}: {tap.frames} frames")
        best = tap.path if tap.frames and tap_is_enough(airframe) else None
    if service is not None:
        if service.path.exists():
            log.say(f"{service.path}: {service.path.stat().st_size / 1e6:.1f} MB")
            best = service.path
        else:
            log.say(f"the service wrote nothing; its words are in {service.path.with_suffix('.service.log')}")
    if best is not None:
        log.say(f"next: spanwise identify flight {best} --airframe {options.airframe}")
        log.say(f"   or: spanwise diagnose {best} --airframe {options.airframe}")

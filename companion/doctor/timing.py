"""Loop rate, inertial rates against the modes, filters, clocks."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator

import numpy as np

from companion.adapters.mavlink.decode.source_map import AUTOPILOT_COMPONENT
from companion.adapters.mavlink.vehicle.rates import SAMPLES_PER_PERIOD, needed_integration_rate_hz, needed_loop_rate_hz
from companion.core.wing.lowpass import Butterworth2
from companion.doctor.evidence import Evidence, Finding, FindingLevel, Fix
from companion.params.vehicle import VEHICLE_PARAMETERS
from companion.records import Axis, ClockName, Station

_FILTER_RATIO = 2.5  # chosen: a filter's cut-off over the mode's frequency: nearer ones turn and damp it
_GOOD_BOUND_NS = 2_000_000  # of a clock, above which a note is given (choice)


def check_rates(evidence: Evidence) -> Iterator[Finding]:
    """Whether every sensor wired to the autopilot is fast enough for the wing's modes."""
    needed_hz = SAMPLES_PER_PERIOD * evidence.highest_hz
    wanted_hz = max(evidence.settings.imu_rate_hz, needed_hz) if evidence.live else needed_hz
    pace = _integration(evidence, needed_hz) if evidence.px4 else _loop(evidence, wanted_hz, needed_hz)
    if evidence.live or not evidence.px4:  # a log of PX4's own has what it integrated, whatever goes out as messages
        yield pace
    for station in Station:
        source = evidence.airframe.sensor(station).source
        if source.component == AUTOPILOT_COMPONENT:
            yield _rate(evidence, station, source.message, needed_hz, pace.fixes)


def _loop(evidence: Evidence, wanted_hz: float, needed_hz: float) -> Finding:
    """ArduPilot sends inertial messages at 0.8 of its loop rate at most."""
    value = evidence.parameter("SCHED_LOOP_RATE")
    if value is None:
        return evidence.missing("loop", "SCHED_LOOP_RATE")
    loop_hz = value[1]
    if loop_hz >= needed_loop_rate_hz(wanted_hz):
        return Finding.ok("loop", f"SCHED_LOOP_RATE is {loop_hz:g} Hz")
    text = f"SCHED_LOOP_RATE is {loop_hz:g} Hz: inertial messages come at {0.8 * loop_hz:.0f} Hz at most"
    fix = Fix("SCHED_LOOP_RATE", needed_loop_rate_hz(wanted_hz), reboot=True)
    return Finding.fix("loop", text, fix) if 0.8 * loop_hz < needed_hz else Finding.note("loop", text, fix)


def _integration(evidence: Evidence, needed_hz: float) -> Finding:
    """PX4 sends a mean for every interval of its integration, and no more."""
    value = evidence.parameter("IMU_INTEG_RATE")
    if value is None:
        return evidence.missing("loop", "IMU_INTEG_RATE")
    rate_hz = value[1]
    text = f"IMU_INTEG_RATE is {rate_hz:g} Hz: inertial messages come at that rate at most"
    if rate_hz >= needed_hz:
        return Finding.ok("loop", text)
    return Finding.fix("loop", text, Fix("IMU_INTEG_RATE", needed_integration_rate_hz(needed_hz), reboot=True))


def _rate(evidence: Evidence, station: Station, message: str, needed_hz: float, fixes: tuple[Fix, ...]) -> Finding:
    rate_hz = evidence.rate_hz.get(station, 0.0)
    what = f"{station.name.lower()} {message} at {rate_hz:.0f} Hz"
    if not rate_hz:
        text = f"{station.name.lower()}: no {message} arrives"
        if message == "HIGHRES_IMU" and evidence.live and not evidence.px4:
            text += "; boards with 1 MB of flash do not have it: map RAW_IMU in the airframe file"
        return Finding.fix("rate", text)
    mode = f"the {evidence.highest_hz:.1f} Hz mode"
    if rate_hz >= needed_hz:
        return Finding.ok("rate", f"{what}, {rate_hz / evidence.highest_hz:.0f} samples a period of {mode}")
    text = f"{what} is too slow for {mode}, which needs {needed_hz:.0f} Hz"
    if evidence.onboard:  # logged at a rate of its own (LOG_BITMASK, SDLOG_PROFILE), whatever goes out as messages
        return Finding("rate", FindingLevel.UNKNOWN, f"{text}, as it was logged; over a link it may come faster")
    return Finding.fix("rate", text if fixes else text + ": raise the baud rate of this link", *fixes)


def check_filters(evidence: Evidence) -> Iterator[Finding]:
    """Attenuation of the modes by the autopilot's low-pass filters."""
    names = ("IMU_ACCEL_CUTOFF", "IMU_GYRO_CUTOFF") if evidence.px4 else ("INS_ACCEL_FILTER", "INS_GYRO_FILTER")
    for wanted, axis in zip(names, ("accel", "gyro"), strict=True):
        value = evidence.parameter(wanted)
        if value is None:
            yield evidence.missing("filter", wanted)
            continue
        name, cutoff_hz = value
        if evidence.px4:
            yield Finding.ok("filter", f"{name} acts behind the messages that PX4 sends: nothing to undo")
            continue
        if cutoff_hz <= 0:
            yield Finding.ok("filter", f"{name} is off")
            continue
        wanted_hz = min(max(5.0 * math.ceil(4.0 * evidence.highest_hz / 5.0), 20.0), VEHICLE_PARAMETERS[name].high)
        gain, phase_deg = _butterworth(evidence.highest_hz / cutoff_hz)
        mode = f"{evidence.highest_hz:.1f} Hz mode"
        text = f"{name} {cutoff_hz:g} Hz turns the {mode} by {phase_deg:.0f} deg, gain {gain:.2f}"
        if cutoff_hz < min(_FILTER_RATIO * evidence.highest_hz, wanted_hz):
            yield Finding.fix("filter", text + ": raise it", Fix(name, wanted_hz))
        else:
            yield Finding.ok("filter", text + f", which is undone ({axis})")
    for notch in ("HNTCH", "HNTC2"):
        yield from _notch(evidence, notch)


def _notch(evidence: Evidence, notch: str) -> Iterator[Finding]:
    """A finding on one of the autopilot's two gyro notches, where it is on."""
    enable, centre = evidence.parameter(f"INS_{notch}_ENABLE"), evidence.parameter(f"INS_{notch}_FREQ")
    if enable is not None and enable[1] and centre is not None:
        text = f"gyro notch at {centre[1]:g} Hz"
        if centre[1] < 2.0 * evidence.highest_hz:
            yield Finding.fix("filter", f"{text} sits on the wing's modes: raise INS_{notch}_FREQ")
        else:
            yield Finding.ok("filter", text)


def _butterworth(ratio: float) -> tuple[float, float]:
    """Gain and phase [deg] of a 2nd-order Butterworth low-pass at ``ratio`` of its corner."""
    response = complex(Butterworth2(1.0).response(np.array(ratio)))
    return abs(response), math.degrees(cmath.phase(response))


_WAYS = {
    True: "its gyro in the first manoeuvres, to some 0.4 ms",
    False: "its vertical accelerometer in half a minute with pull-ups and rolls, to some 1 to 2.5 ms",
}


def check_clocks(evidence: Evidence) -> Iterator[Finding]:
    """Whether every clock that stamps samples is known."""
    if not evidence.live and not evidence.clocks:
        return  # a log of somebody else, who asked nobody for the time
    stations: dict[ClockName, Station] = {}
    for station in Station:
        stations.setdefault(evidence.airframe.sensor(station).source.clock, station)
    for clock in sorted(stations.keys() - {ClockName.HOST}):
        state = evidence.clocks.get(clock)
        if state is None:
            yield _unanswered(clock, evidence.axes.get(stations[clock], Axis.NONE))
        elif not state.synced:
            yield Finding.fix("clock", f"{clock}: answers contradict each other; a second sender of its id?")
        else:
            text = f"{clock} known to {state.bound_ns / 1e6:.2f} ms, runs {state.skew_ppm:+.0f} ppm"
            good = state.bound_ns <= _GOOD_BOUND_NS
            yield Finding.ok("clock", text) if good else Finding.note("clock", f"{text}: slow round trips")


def _unanswered(clock: ClockName, axes: Axis) -> Finding:
    """A clock of which nothing is known; a node's is aligned by the motion that its ``axes`` show."""
    unused = f"{clock}: TIMESYNC is not answered; its samples cannot be used"
    if clock is ClockName.BOOT:
        return Finding.fix("clock", unused)
    if not axes & (Axis.GYRO | Axis.Z):
        return Finding.fix("clock", f"{unused}: node firmware without TIMESYNC?")
    text = (
        f"{clock}: TIMESYNC is not answered; it will be aligned by {_WAYS[bool(axes & Axis.GYRO)]} "
        "(tools/wing_node has a firmware that answers: 0.1 ms)"
    )
    return Finding.note("clock", text)

"""Rare messages to records: the autopilot's identity, TIMESYNC answers, flight state, parameters."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.adapters.mavlink.decode.counters import RefusalCounters
from companion.adapters.mavlink.decode.source_map import AUTOPILOT_COMPONENT, SourceMap
from companion.adapters.mavlink.link.dialect import mavlink
from companion.adapters.mavlink.vehicle.clock_reset_detector import LEAPS, ClockResetDetector, StampHistory
from companion.adapters.mavlink.vehicle.vehicle_choice import VehicleChoice
from companion.params.vehicle import VEHICLE_PARAMETERS
from companion.records import (
    AutopilotParameter,
    CameraFeedback,
    ClockName,
    ClockRestart,
    Record,
    Reject,
    TimesyncReply,
    VehicleState,
)

_MOST_REQUESTS = 32  # TIMESYNC requests that may be under way; bound of memory
_STATE_PERIOD_MS = 20  # chosen: 50 states a second at most; display and motion want 20
_VELOCITY_AGE_MS = 150  # a velocity over ground that is older is not that of the attitude: 20 Hz are requested (choice)
# an accuracy that is older is not that of the velocity: ArduPlane streams GPS_RAW_INT at 1 Hz, PX4 at 1 to 5 (choice)
_ACCURACY_AGE_NS = 3_000_000_000
# airspeed and climb that are older are not those of the attitude; every profile of streams has VFR_HUD at 1 Hz at
# least (choice). A state says how old they are, for what is moved on by them
_AIR_AGE_NS = 3_000_000_000
# a landed state or a filter's flags that are older say nothing any more: both come at 1 Hz at least where they are
# streamed, but for PX4's MINIMAL profile (choice)
_WITNESS_AGE_NS = 5_000_000_000
# a boot time that falls by more is another boot's: copies by a slow link are seconds late (choice)
_REBOOT_MS = 10_000
# flags that EKF_STATUS_REPORT and ESTIMATOR_STATUS share; bit 10 means "uninitialised" there, "GPS glitch" here
_NAVIGATES = mavlink.EKF_VELOCITY_HORIZ | mavlink.EKF_POS_HORIZ_ABS
_ASTRAY = mavlink.EKF_CONST_POS_MODE | mavlink.EKF_UNINITIALIZED | mavlink.EKF_GPS_GLITCHING
_PIN_TIMES_US = 1 << 32  # CAMERA_FEEDBACK of a pin is micros() in 32 bits (AP_Camera)
INTEGER_TYPES = (mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_UINT32)


@dataclass(frozen=True, slots=True)
class Heard:
    """A rare message as it came: ``message`` is pymavlink's object, wire units.

    ``payload`` has what this dialect knows no fields for.
    """

    link: int
    system: int
    component: int
    message: Any
    received_host_ns: int
    payload: bytes = b""

    @property
    def name(self) -> str:
        """The message's name, as in the dialect."""
        return str(self.message.get_type())


@dataclass(frozen=True, slots=True)
class Echo:
    """A rare message under our own system and component id: ours sent back by a router, or another's with our id."""

    system: int
    component: int
    message: int
    payload: bytes
    received_host_ns: int


def parameter_value(message: Any, *, bytewise: bool) -> float:
    """The value of a PARAM_VALUE. PX4 puts the bytes of its integers where ArduPilot puts the number as a float."""
    value = float(message.param_value)
    if bytewise and message.param_type in INTEGER_TYPES:
        return float(struct.unpack("<i", struct.pack("<f", value))[0])
    return value


def parameter_encoding(value: float, *, integer: bool) -> tuple[float, int]:
    """The value and type of a PARAM_SET; ``integer`` is for PX4, which refuses another type than the parameter's."""
    if not integer:
        return value, int(mavlink.MAV_PARAM_TYPE_REAL32)
    return struct.unpack("<f", struct.pack("<i", round(value)))[0], int(mavlink.MAV_PARAM_TYPE_INT32)


class GroundWitness:
    """Whether an autopilot says that it is on the ground.

    EXTENDED_SYS_STATE tells it (PX4 sends it unasked). Without, and 5 s after the last, the heartbeat's system status:
    ArduPlane is in standby until it flies and after it has landed, PX4 while it is disarmed.
    """

    def __init__(self) -> None:
        self._landed: tuple[bool, int] | None = None
        self._standby: bool | None = None

    def verdict(self, now_host_ns: int) -> bool | None:
        """None where nothing has told it."""
        if self._landed is None or now_host_ns - self._landed[1] > _WITNESS_AGE_NS:
            return self._standby
        return self._landed[0]

    def landed_state(self, state: int, received_host_ns: int) -> None:
        """Take MAV_LANDED_STATE; an undefined one tells nothing."""
        if state != mavlink.MAV_LANDED_STATE_UNDEFINED:
            self._landed = state == mavlink.MAV_LANDED_STATE_ON_GROUND, received_host_ns

    def system_status(self, state: int) -> None:
        """Take MAV_STATE; critical and emergency are of both, and change nothing."""
        if state in (mavlink.MAV_STATE_STANDBY, mavlink.MAV_STATE_ACTIVE):
            self._standby = state == mavlink.MAV_STATE_STANDBY


class GroundVelocity:
    """Velocity over ground as the autopilot's navigation filter has it, where it has one.

    Without a position GLOBAL_POSITION_INT is sent all the same, with zeros. ArduPilot's EKF_STATUS_REPORT and PX4's
    ESTIMATOR_STATUS say whether the velocity is good; where neither was sent for 5 s, it counts as good.
    """

    def __init__(self) -> None:
        self._newest: Any = None
        self._astray_host_ns: int | None = None
        self._accuracy: tuple[float, int] | None = None

    def receiver(self, message: Any, received_host_ns: int) -> None:
        """Take GPS_RAW_INT: its speed accuracy, mm/s, is an extension, and 0 where the receiver states none."""
        fixed, stated = message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX, message.vel_acc
        self._accuracy = (0.001 * stated, received_host_ns) if fixed and stated else None

    def sigma_mps(self, now_host_ns: int) -> float | None:
        """Accuracy that the receiver stated last; None where it stated nothing, or long ago."""
        if self._accuracy is None or now_host_ns - self._accuracy[1] > _ACCURACY_AGE_NS:
            return None
        return self._accuracy[0]

    def position(self, message: Any) -> None:
        """Take GLOBAL_POSITION_INT."""
        self._newest = message

    def status(self, flags: int, received_host_ns: int) -> None:
        """Take the flags of EKF_STATUS_REPORT or ESTIMATOR_STATUS."""
        is_good = flags & _NAVIGATES == _NAVIGATES and not flags & _ASTRAY
        self._astray_host_ns = None if is_good else received_host_ns

    def ned_mps(self, boot_ms: int, now_host_ns: int) -> tuple[float, float, float] | None:
        """North, east, down at a boot time; None where nothing new and good is told."""
        newest, astray_host_ns = self._newest, self._astray_host_ns
        if astray_host_ns is not None and now_host_ns - astray_host_ns <= _WITNESS_AGE_NS:
            return None
        if newest is None or abs(boot_ms - newest.time_boot_ms) > _VELOCITY_AGE_MS:
            return None
        if newest.lat == newest.lon == 0 or newest.vx == newest.vy == 0:
            return None
        return 0.01 * newest.vx, 0.01 * newest.vy, 0.01 * newest.vz


class Translator:
    """Keeps the little state that rare messages need; driven by chunks alone, so that a replay repeats it."""

    def __init__(
        self, mapping: SourceMap, reset_detector: ClockResetDetector, refusals: RefusalCounters, system: int = 0
    ) -> None:
        self.choice = VehicleChoice(system)
        self._answers: dict[ClockName, StampHistory] = {}
        self.armed = False
        self._mapping = mapping
        self._reset_detector = reset_detector
        self._refusals = refusals
        self._requests: dict[int, set[tuple[int, int]]] = {}
        self.px4 = False
        self._forget_vehicle()

    def _forget_vehicle(self) -> None:
        """Begin without what an autopilot told: another one, or this one after a reboot, may say nothing of it."""
        self._air: tuple[tuple[float, float, float], int] | None = None
        self._last_state_ms: int | None = None
        self._images: dict[int, int] = {}
        self._on_ground, self._velocity = GroundWitness(), GroundVelocity()

    @property
    def system(self) -> int | None:
        """The vehicle's system id, once its autopilot was heard."""
        return self.choice.system

    def sent(self, message: Any) -> None:
        """Take note of a TIMESYNC request of ours."""
        if message.get_type() == "TIMESYNC" and message.tc1 == 0:
            self._requests[message.ts1] = set()
            while len(self._requests) > _MOST_REQUESTS:
                del self._requests[next(iter(self._requests))]

    def records(self, heard: Heard) -> Iterator[Record]:
        """Give what one message means to the pipeline, if anything."""
        name = heard.name
        if name == "HEARTBEAT":
            yield from self._heartbeat(heard)
        elif name == "TIMESYNC" and heard.component == AUTOPILOT_COMPONENT and heard.message.ts1 in self._requests:
            self.choice.answered(heard.system, heard.received_host_ns)
            if heard.system == self.system:
                yield from self._timesync(heard)
        elif heard.system != self.system:
            return
        elif name == "TIMESYNC":
            yield from self._timesync(heard)
        elif heard.component != AUTOPILOT_COMPONENT:
            return
        elif name == "ATTITUDE":
            yield from self._attitude(heard)
        elif name == "VFR_HUD":
            self._vfr_hud(heard)
        elif name == "GLOBAL_POSITION_INT":
            self._velocity.position(heard.message)
        elif name == "GPS_RAW_INT":
            self._velocity.receiver(heard.message, heard.received_host_ns)
        elif name in ("EKF_STATUS_REPORT", "ESTIMATOR_STATUS"):
            self._velocity.status(heard.message.flags, heard.received_host_ns)
        elif name == "EXTENDED_SYS_STATE":
            self._on_ground.landed_state(heard.message.landed_state, heard.received_host_ns)
        elif name == "PARAM_VALUE":
            yield from self._parameter(heard)
        elif name == "CAMERA_FEEDBACK":
            yield from self._feedback(heard)

    def _heartbeat(self, heard: Heard) -> Iterator[Record]:
        message = heard.message
        pilot = message.autopilot != mavlink.MAV_AUTOPILOT_INVALID and message.type != mavlink.MAV_TYPE_GCS
        if heard.component != AUTOPILOT_COMPONENT or not pilot:
            return
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if self.choice.beat(heard.system, heard.received_host_ns, armed=armed):
            self._forget_vehicle()
            for clock in dict.fromkeys(self._mapping.clocks.values()):  # another vehicle, and other clocks
                self._reset_detector.restart(clock, heard.received_host_ns)
                yield ClockRestart(clock, heard.received_host_ns)
        if heard.system == self.system:
            self.px4 = message.autopilot == mavlink.MAV_AUTOPILOT_PX4
            self.armed = armed
            self._on_ground.system_status(message.system_status)

    def _timesync(self, heard: Heard) -> Iterator[Record]:
        message = heard.message
        answered = self._requests.get(message.ts1)
        clock = self._mapping.clocks.get(heard.component)
        sender = (heard.system, heard.component)
        # a routed copy of an answer is later than the answer, so only the first from each sender counts
        if message.tc1 <= 0 or answered is None or clock is None or sender in answered:
            return
        answered.add(sender)
        stamp = np.array([message.tc1], dtype=np.int64)
        if clock not in self._answers:
            self._answers[clock] = self._reset_detector.follow(clock)
        verdict = self._reset_detector.check(self._answers[clock], stamp, heard.received_host_ns, confirmations=1)
        if verdict.keep is not None and not verdict.keep.any():
            name = f"TIMESYNC of component {heard.component}"
            if verdict.ahead:
                self._refusals.add(Reject.INCONSISTENT, name + LEAPS)
            else:
                self._refusals.add(Reject.TIME_BACKWARDS, name)
            return
        if verdict.restart_at >= 0:
            yield ClockRestart(clock, heard.received_host_ns)
        yield TimesyncReply(clock, message.ts1, message.tc1, heard.received_host_ns)

    def _vfr_hud(self, heard: Heard) -> None:
        message = heard.message
        # PX4 without a pitot tube, or with one that it has given up, sends NaN
        airspeed_mps = message.airspeed if math.isfinite(message.airspeed) else message.groundspeed
        if math.isfinite(airspeed_mps) and math.isfinite(message.climb):
            self._air = (airspeed_mps, message.climb, message.throttle / 100.0), heard.received_host_ns
        else:
            self._refusals.add(Reject.NOT_FINITE, "VFR_HUD")

    def _attitude(self, heard: Heard) -> Iterator[Record]:
        message, last = heard.message, self._last_state_ms
        angles = (message.roll, message.pitch, message.yaw)
        if not all(math.isfinite(angle) for angle in angles):
            self._refusals.add(Reject.NOT_FINITE, "ATTITUDE")
            return
        if last is not None and message.time_boot_ms < last - _REBOOT_MS:
            self._forget_vehicle()
        elif last is not None and 0 <= message.time_boot_ms - last < _STATE_PERIOD_MS:
            return
        if self._air is None or heard.received_host_ns - self._air[1] > _AIR_AGE_NS:
            return
        self._last_state_ms = message.time_boot_ms
        yield VehicleState(
            message.time_boot_ms * 1_000_000,
            heard.received_host_ns,
            *angles,
            *self._air[0],
            self.armed,
            self._on_ground.verdict(heard.received_host_ns),
            self._velocity.ned_mps(message.time_boot_ms, heard.received_host_ns),
            self._velocity.sigma_mps(heard.received_host_ns),
            self._air[1],
        )

    def _feedback(self, heard: Heard) -> Iterator[Record]:
        """An edge of the hot-shoe pin: boot time in 32 bits.

        Without a pin ArduPilot sends the GPS time at which it gave the command (0 without GPS), which is no exposure;
        with two cameras it tells each picture more than once.
        """
        message = heard.message
        repeated = self._images.get(message.cam_idx) == message.img_idx
        self._images[message.cam_idx] = message.img_idx
        if not repeated and 0 < message.time_usec < _PIN_TIMES_US:
            t_ns = message.time_usec * 1000
            yield CameraFeedback(message.cam_idx, message.img_idx, t_ns, heard.received_host_ns)

    def _parameter(self, heard: Heard) -> Iterator[Record]:
        message = heard.message
        if message.param_id in VEHICLE_PARAMETERS:  # whatever its value: the pipeline says what is wrong with it
            value = parameter_value(message, bytewise=self.px4)
            yield AutopilotParameter(message.param_id, value, heard.received_host_ns)

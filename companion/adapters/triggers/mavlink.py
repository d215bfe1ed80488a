"""Firing through the autopilot: the trigger process keeps the time, the inertial process owns the link and sends.

The shot that comes back over the pipe is the request: at once when it arrives, the inertial process sends the command
of :class:`LinkFiring`. Pipe, link and autopilot are then part of the latency, which is learned like any other.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass

from companion.errors import DeviceError
from companion.ports import Trigger
from companion.records import Shot, TriggerPlan

MAV_CMD_IMAGE_START_CAPTURE = 2000  # MAVLink common.xml
MAV_CMD_DO_DIGICAM_CONTROL = 203  # MAVLink, as ArduPilot knows it
MAV_CMD_DO_REPEAT_RELAY = 182  # MAVLink common.xml
MAV_CMD_DO_REPEAT_SERVO = 184  # MAVLink common.xml
_ALL_CAMERAS = 0.0  # target of IMAGE_START_CAPTURE (MAVLink common.xml)
_LARGEST_EXACT_FLOAT32 = 1 << 24  # largest count that a command's float parameter holds exactly (derived)
_PULSE_S = 0.05  # chosen: on and off again; ArduPilot goes back after half of it and looks every 20 ms
_REST_NS = 60_000_000  # after a command: the line is low again (derived: half a pulse, and a look late on either side)


@dataclass(frozen=True, slots=True)
class CaptureCommand:
    """The fields of a COMMAND_LONG, without its addressee."""

    command: int
    parameters: tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class LinkFiring:
    """Command that makes the autopilot fire.

    ``kind`` is ``camera``: every camera of the autopilot takes one picture; ``relay``: relay ``channel`` goes on and
    off once; or ``servo``: output ``channel`` goes to ``pulse_us`` and back once. The autopilot refuses a channel that
    its own camera driver holds.
    """

    kind: str = "camera"
    channel: int = 0
    pulse_us: int = 1900

    def command(self, shot: Shot, *, px4: bool = False) -> CaptureCommand:
        """The command of one shot.

        IMAGE_START_CAPTURE's ``param1`` 0 fires all cameras in ArduPilot, where DO_DIGICAM_CONTROL would fire the
        first only; its ``param4`` is the sequence number (plan id, within what a float32 holds exactly), which tells a
        repeated command from a new one. PX4's camera trigger knows DO_DIGICAM_CONTROL alone (``param5`` 1 shoots), and
        looks for it twenty times a second: up to 50 ms of the latency are left to chance. DO_REPEAT_RELAY and
        DO_REPEAT_SERVO come back by themselves.
        """
        if self.kind == "relay":
            return CaptureCommand(MAV_CMD_DO_REPEAT_RELAY, (float(self.channel), 1.0, _PULSE_S, 0.0, 0.0, 0.0, 0.0))
        if self.kind == "servo":
            pulse = (float(self.channel), float(self.pulse_us), 1.0, _PULSE_S, 0.0, 0.0, 0.0)
            return CaptureCommand(MAV_CMD_DO_REPEAT_SERVO, pulse)
        if px4:
            return CaptureCommand(MAV_CMD_DO_DIGICAM_CONTROL, (0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0))
        sequence = float(shot.plan_id % _LARGEST_EXACT_FLOAT32)
        return CaptureCommand(MAV_CMD_IMAGE_START_CAPTURE, (_ALL_CAMERAS, 0.0, 1.0, sequence, 0.0, 0.0, 0.0))


CAMERAS = LinkFiring()


class MavlinkTrigger:
    """Implements :class:`companion.ports.Trigger`: the returned shot asks the inertial process to send the command."""

    def __init__(self, firing: LinkFiring = CAMERAS) -> None:
        self.firing = firing
        self._fired_ns = -_REST_NS

    def fire(self, plan: TriggerPlan) -> Shot:
        """Stamp the request.

        Raises
        ------
        DeviceError
            A relay or servo may still be on from the last shot: a command now would turn the line round, and each
            further shot would end a pulse instead of beginning one.
        """
        now_ns = time.monotonic_ns()
        if self.firing.kind != "camera" and now_ns - self._fired_ns < _REST_NS:
            text = f"{self.firing.kind} {self.firing.channel} may still be on"
            raise DeviceError(f"{text}: no more than {1_000_000_000 // _REST_NS} shots a second, set TRG_RATE so")
        self._fired_ns = now_ns
        return Shot(plan.plan_id, plan.command_host_ns, now_ns)

    def close(self) -> None:
        """Nothing to release; the link is the inertial process's."""


def link_firing(factory: Callable[[], Trigger] | None) -> LinkFiring | None:
    """Command of a trigger that the autopilot fires; None for another kind of trigger, or none."""
    if factory is MavlinkTrigger:
        return CAMERAS
    if isinstance(factory, functools.partial) and factory.func is MavlinkTrigger:
        firing: LinkFiring = factory.args[0]
        return firing
    return None

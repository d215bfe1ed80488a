"""Firing through the autopilot: the trigger process keeps the time, the inertial process owns the link and sends.

The shot that comes back over the pipe is the request: at once when it arrives, the inertial process sends the command
of :func:`capture_command`. Pipe, link and autopilot are then part of the latency, which is learned like any other.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

from companion.records import Shot, TriggerPlan

MAV_CMD_IMAGE_START_CAPTURE = 2000
_ALL_CAMERAS = 0.0
_LARGEST_EXACT_FLOAT32 = 1 << 24


class MavlinkTrigger:
    """Implements :class:`companion.ports.Trigger`: the returned shot asks the inertial process to send the command."""

    def fire(self, plan: TriggerPlan) -> Shot:
        """Stamp the request."""
        return Shot(plan.plan_id, plan.command_host_ns, time.monotonic_ns())

    def close(self) -> None:
        """Nothing to release; the link is the inertial process's."""


@dataclass(frozen=True, slots=True)
class CaptureCommand:
    """The fields of a COMMAND_LONG, without its addressee."""

    command: int
    parameters: tuple[float, float, float, float, float, float, float]


def capture_command(shot: Shot) -> CaptureCommand:
    """IMAGE_START_CAPTURE of one picture by every camera.

    ``param1`` 0 fires all cameras in ArduPilot, where DO_DIGICAM_CONTROL would fire the first only. ``param4`` is the
    sequence number (plan id, within what a float32 holds exactly), which tells a repeated command from a new one.
    """
    sequence = float(shot.plan_id % _LARGEST_EXACT_FLOAT32)
    return CaptureCommand(MAV_CMD_IMAGE_START_CAPTURE, (_ALL_CAMERAS, 0.0, 1.0, sequence, 0.0, 0.0, 0.0))

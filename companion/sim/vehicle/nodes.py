"""A wingtip node that speaks MAVLink: inertial stream at its own clock, heartbeat, TIMESYNC server.

No sockets and no clock inside: :mod:`companion.sim.vehicle.world` tells it the time and carries its frames.
"""

from __future__ import annotations

import math
import struct
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.sim.flight.perturb import TrueClock
from companion.sim.flight.sensors import SensorStream
from companion.sim.vehicle.faults import Faults, boot_origin_ns
from companion.sim.vehicle.wire import SYSTEM_ID, FrameSender, inertial_format, payloads, stamped

_HEARTBEAT_NS = 1_000_000_000  # convention: heartbeats come once a second (MAVLink)
_NAN_Z = struct.pack("<f", math.nan)


class WingNode:
    """One node. A reboot starts its clock from zero."""

    def __init__(self, stream: SensorStream, clock: TrueClock, faults: Faults) -> None:
        self.component = stream.sensor.source.component
        self.sender = FrameSender(self.component)
        self._form = inertial_format(stream.sensor.source.message)
        self._rest = payloads(stream.values, stream.sensor.source)
        self._stamps: list[int] = stream.stamp_ns.tolist()
        self._sent: list[int] = stream.sent_boot_ns.tolist()
        self._clock = clock
        self._faults = faults
        self._next = 0
        self._next_heartbeat_ns = 0
        self._replies: list[bytes] = []

    def extend(self, stream: SensorStream) -> None:
        """Take further samples of the same sensor, of a flight that is flown while they are sent."""
        self._rest += payloads(stream.values, stream.sensor.source)
        self._stamps += stream.stamp_ns.tolist()
        self._sent += stream.sent_boot_ns.tolist()

    def advance(self, now_boot_ns: int) -> list[bytes]:
        """Give the frames that are due."""
        t_s = now_boot_ns * 1e-9
        silent = self._faults.silent(self.component, t_s)
        mute = silent or self._faults.stopped(self.component, t_s)
        frames = self._inertial(now_boot_ns, mute, self._faults.broken(self.component, t_s))
        if now_boot_ns >= self._next_heartbeat_ns:
            self._next_heartbeat_ns += _HEARTBEAT_NS
            frames.append(self.sender.message(_heartbeat()))
        frames += self._replies
        self._replies = []
        return [] if silent else frames

    def greeting(self) -> bytes:
        """A heartbeat out of turn, while the flight has not begun."""
        return self.sender.message(_heartbeat())

    def receive(self, message: Any, now_boot_ns: int) -> None:
        """Answer a TIMESYNC request that is for all or for this node."""
        if message.get_type() != "TIMESYNC" or message.tc1 != 0:
            return
        wanted = (getattr(message, "target_system", 0), getattr(message, "target_component", 0))
        if wanted[0] in (0, SYSTEM_ID) and wanted[1] in (0, self.component):
            answer = mavlink.MAVLink_timesync_message(tc1=self.node_ns(now_boot_ns), ts1=message.ts1)
            self._replies.append(self.sender.message(answer))

    def node_ns(self, now_boot_ns: int) -> int:
        """The node's own time."""
        origin = boot_origin_ns(self._faults, now_boot_ns, self.component)
        return self._clock.from_boot(now_boot_ns) - self._lost(origin)

    def _lost(self, origin_ns: int) -> int:
        """Time that a restart takes off the clock, ns."""
        return self._clock.from_boot(origin_ns) if origin_ns else 0

    def _inertial(self, now_boot_ns: int, mute: bool, broken: bool) -> list[bytes]:
        frames: list[bytes] = []
        lost = self._lost(boot_origin_ns(self._faults, now_boot_ns, self.component))
        while self._next < len(self._sent) and self._sent[self._next] <= now_boot_ns:
            index = self._next
            self._next += 1
            # a sample from before the restart died with the old clock
            if mute or self._stamps[index] < lost:
                continue
            rest = self._rest[index]
            if broken:
                rest = rest[:8] + _NAN_Z + rest[12:]
            frames.append(self.sender.raw(self._form.kind, stamped(self._form, self._stamps[index] - lost, rest)))
        return frames


def _heartbeat() -> Any:
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_IMU, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE, 3
    )

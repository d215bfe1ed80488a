"""DepthAI software trigger, the firing end: a word over a local socket to whoever holds the camera.

A DepthAI device belongs to one process, the one that takes its images. There ``adapters/cameras/oak_soft.py`` hears the
word and passes it to a script on the device, which pulls the sensors' own FSYNC line: no wire to the camera is needed.
Socket, USB and script are part of the latency, which is learned like any other, spread included; a trigger board or a
GPIO on the FSYNC line is steadier.
"""

from __future__ import annotations

import functools
import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass

from companion.errors import DeviceError
from companion.ports import Trigger
from companion.records import Shot, TriggerPlan

WORD = struct.Struct("<q")
"""Plan id."""


@dataclass(frozen=True, slots=True)
class SoftLine:
    """Which pins of the device make the pulse, and what the line is called on this machine.

    The first of ``pins`` drives FSYNC (41 on most OAK boards); the others are held high, as OAK-FFC-4P wants it to join
    its sensors' lines (38 from revision 6 on, 6 before). Two services on one machine need two names.
    """

    pins: tuple[int, ...] = (41,)
    name: str = "spanwise-oak"

    @property
    def address(self) -> str:
        """Address of the socket, in Linux's abstract name space: it is gone with the process that holds it."""
        return f"\0{self.name}"


class OakTrigger:
    """Implements :class:`companion.ports.Trigger`: tells the process that holds the cameras to fire."""

    def __init__(self, line: SoftLine) -> None:
        self.line = line
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def fire(self, plan: TriggerPlan) -> Shot:
        """Say the word now; :class:`DeviceError` while no camera listens, or one that does not keep up."""
        fired_ns = time.monotonic_ns()
        try:
            self._socket.sendto(WORD.pack(plan.plan_id), self.line.address)
        except OSError as error:
            raise DeviceError(f"no DepthAI camera listens for shots: {error}") from error
        return Shot(plan.plan_id, plan.command_host_ns, fired_ns)

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()


def soft_line(factory: Callable[[], Trigger] | None) -> SoftLine | None:
    """The line that the cameras have to listen to for this trigger; None for any other trigger."""
    if isinstance(factory, functools.partial) and factory.func is OakTrigger:
        line: SoftLine = factory.args[0]
        return line
    return None

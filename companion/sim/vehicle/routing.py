"""Several links to one simulated vehicle, with ArduPilot's habit of passing on what one link says to all the others."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol


class Port(Protocol):
    """One end of a link, as :class:`companion.sim.vehicle.world.VehicleLink` is."""

    def send(self, frames: list[bytes], /) -> object:
        """Frames from the vehicle."""
        ...

    def drain(self) -> bytes:
        """Bytes for the vehicle."""
        ...

    def close(self) -> None:
        """Release it."""
        ...


class Router:
    """A link that is made of several; heartbeats of all reach all, so that each knows who is there."""

    def __init__(self, ports: Sequence[Port]) -> None:
        self._ports = list(ports)

    def send(self, frames: list[bytes]) -> None:
        """To every link."""
        for port in self._ports:
            port.send(frames)

    def drain(self) -> bytes:
        """From every link, and on to the others."""
        came = [port.drain() for port in self._ports]
        for index, data in enumerate(came):
            for other, port in enumerate(self._ports):
                if data and other != index:
                    port.send([data])
        return b"".join(came)

    def close(self) -> None:
        """Close every link."""
        for port in self._ports:
            port.close()

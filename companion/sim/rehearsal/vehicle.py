"""The simulated vehicle for rehearsing missions: it takes orders, has several links, and runs as fast as is asked."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence

from companion.sim.flight.flight import Flight
from companion.sim.vehicle.command_protocol import CommandProtocol
from companion.sim.vehicle.companion_stub import CompanionStub
from companion.sim.vehicle.faults import Faults
from companion.sim.vehicle.routing import Port, Router
from companion.sim.vehicle.scripted_pilot import ScriptedPilot
from companion.sim.vehicle.world import VehicleLink, World, WorldOptions
from companion.units import Orientation

_WAKE_S = 0.002  # chosen: a tick of the autopilot's 400 Hz loop is at most so late
_LONGEST_STEP_S = 0.02  # chosen: a machine that stalls makes the flight slower instead of making it jump
_FIELD_OF_VIEW_RAD = 0.37  # chosen: half of a 42 degree lens


class RehearsalVehicle:
    """One vehicle; :meth:`run` keeps it alive until told to stop.

    ``connections`` are links in the vehicle's spelling (:class:`WorldOptions`); what one says is passed on to the
    others. It begins ``height_m`` above home, at 0 on the ground and disarmed, and flies ``speed`` seconds in a real
    second. ``ranges`` puts a :class:`CompanionStub` on the wire; ``obstacle_m`` is a pole north and east of home that a
    forward-looking airframe sees.
    """

    def __init__(
        self,
        flight: Flight,
        connections: Sequence[str],
        *,
        height_m: float = 60.0,
        speed: float = 1.0,
        ranges: bool = False,
        obstacle_m: tuple[float, float] | None = None,
        faults: Faults | None = None,
        parameters: Mapping[str, float] | None = None,
    ) -> None:
        self.speed = speed
        self.boot_ns = 0
        self._obstacle_m = obstacle_m
        orientation = flight.airframe.orientation
        self.companion = CompanionStub(
            self._ahead_m if orientation == Orientation.FORWARD else self._below_m,
            lambda: self.protocol.flown_ns,  # the instant that the distance is of
            orientation=orientation,
        )
        ports: list[Port] = [VehicleLink(connection) for connection in connections]
        self._router = Router([*ports, self.companion] if ranges else ports)
        options = WorldOptions(
            speed=speed, faults=faults or Faults(), parameters=parameters or {}, pilot_height_m=height_m
        )
        self.world = World(flight, options, self._router)

    @property
    def protocol(self) -> CommandProtocol:
        """Command protocol of the vehicle, with its pilot."""
        assert self.world.autopilot.protocol is not None
        return self.world.autopilot.protocol

    @property
    def pilot(self) -> ScriptedPilot:
        """The aeroplane."""
        return self.protocol.pilot

    def run(self, ended: Callable[[], bool]) -> None:
        """Fly in (multiplied) real time until ``ended`` says so, then close the links.

        Faster than real, a machine that stalls makes the flight slower instead of making it jump.
        """
        most_s = math.inf if self.speed == 1.0 else _LONGEST_STEP_S
        before_s = time.monotonic()
        try:
            while not ended():
                now_s = time.monotonic()
                self.boot_ns += round(min(now_s - before_s, most_s) * self.speed * 1e9)
                before_s = now_s
                self.world.run_once(self.boot_ns, time.monotonic_ns())
                time.sleep(_WAKE_S)
        finally:
            self._router.close()

    def _below_m(self) -> float | None:
        """Along the downward axis to level ground at home's height."""
        p = self.pilot
        return p.height_m / (math.cos(p.roll_rad) * math.cos(p.pitch_rad)) if p.airborne else None

    def _ahead_m(self) -> float | None:
        """To the pole, while it is in view."""
        if self._obstacle_m is None:
            return None
        p = self.pilot
        north, east = self._obstacle_m[0] - p.north_m, self._obstacle_m[1] - p.east_m
        off = (math.atan2(east, north) - p.course_rad + math.pi) % math.tau - math.pi
        return math.hypot(north, east) * math.cos(off) if abs(off) < _FIELD_OF_VIEW_RAD else None

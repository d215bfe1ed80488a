"""The landing aeroplane on a MAVLink link: its autopilot flies by the ranges that it receives there."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from companion.records import ClockName, Floats, Station
from companion.sim.flight.aircraft import FlightPlan
from companion.sim.flight.flight import Flight
from companion.sim.flight.sensors import BACKEND_HZ, BackendImu
from companion.sim.landing.landing_flight import LandingFlight, RangeSource
from companion.sim.landing.live_sensors import LiveNode, LiveSensor
from companion.sim.vehicle.autopilot import SimAutopilot
from companion.sim.vehicle.faults import Faults
from companion.sim.vehicle.nodes import WingNode
from companion.sim.vehicle.routing import Port
from companion.sim.vehicle.wire import payloads
from companion.sim.vehicle.world import World, WorldOptions


def flight_of(landing: LandingFlight) -> Flight:
    """The landing as a :class:`companion.sim.flight.flight.Flight`, whose truth grows and whose sensors are silent."""
    plan = FlightPlan(landing.longest_s, landing.approach.airspeed_mps)
    actual, still = landing.real.actual, np.zeros((1, 6))
    backends, nodes = {}, {}
    for station in Station:
        if actual.sensor(station).source.clock is ClockName.BOOT:
            backends[station] = BackendImu(station, actual.sensor(station), still)
        else:
            nodes[station] = LiveNode(landing, station).empty()
    model, truth = landing.model, landing.truth
    return Flight(landing.airframe, landing.real, model, truth, plan, landing.seed, backends, nodes)


class LandingAutopilot(SimAutopilot):
    """An autopilot whose inertial samples come as the flight is flown, and whose wheels tell that it has landed."""

    def __init__(self, landing: LandingFlight, flight: Flight) -> None:
        self._live: dict[str, list[bytes]] = {}
        self._landing = landing
        super().__init__(flight, Faults())

    def feed(self, imu: BackendImu, values: Floats) -> None:
        """Take the next filtered samples of an IMU, (n, 6) at 1 kHz."""
        self._live.setdefault(imu.sensor.source.message, []).extend(payloads(values, imu.sensor.source))

    def reading_m(self, now_ns: int) -> float | None:
        """Newest good range of the rangefinder, as ArduPilot's status has it."""
        del now_ns
        newest = self.received.rangefinder
        return newest.distance_m if newest is not None and newest.used else None

    def _start(self) -> None:
        super()._start()
        self._streams.pop("RAW_IMU", None)  # it has its samples in one message only

    def _pack(self, name: str, imu: BackendImu) -> list[bytes]:
        del imu
        return self._live.setdefault(name, [])

    def _motion(self, name: str, sent_ns: int, boot_ms: int) -> Any:
        message = super()._motion(name, sent_ns, boot_ms)
        if name == "VFR_HUD":  # a prescribed flight's airspeed is its plan's
            message.airspeed = message.groundspeed = math.hypot(*self._landing.present.velocity_ned_mps)
        return message

    def _on_ground(self) -> bool:
        return self._landing.on_ground


class LandingWorld(World):
    """Autopilot and nodes of one landing on one link; the aeroplane flies as the time passes.

    ``watch`` puts an observer between the rangefinder and the autopilot that flies by it.
    """

    def __init__(
        self, landing: LandingFlight, link: Port, watch: Callable[[RangeSource], RangeSource] = lambda source: source
    ) -> None:
        flight = flight_of(landing)
        super().__init__(flight, WorldOptions(), link)
        self.landing = landing
        self.pilot_link = LandingAutopilot(landing, flight)
        self.autopilot = self.pilot_link
        self._imus = [
            (imu, LiveSensor(landing, station, round(1e9 / BACKEND_HZ))) for station, imu in flight.backends.items()
        ]
        live = [(station, LiveNode(landing, station)) for station in sorted(flight.nodes)]
        self._live_nodes = [
            (WingNode(node.empty(), flight.real.clocks[node.empty().clock], Faults()), node) for _, node in live
        ]
        self.nodes = [node for node, _ in self._live_nodes]
        self._ranges = watch(self.pilot_link)
        self._sample()

    def run_once(self, now_boot_ns: int, host_ns: int) -> None:
        """Fly as far as the time has come, then talk."""
        while self.landing.now_ns <= now_boot_ns and not self.landing.over:
            self.landing.advance(self._ranges.reading_m(self.landing.now_ns))
            self._sample()
        super().run_once(now_boot_ns, host_ns)

    def _sample(self) -> None:
        """Hand on what the sensors have measured of the newest truth."""
        for imu, sensor in self._imus:
            self.pilot_link.feed(imu, sensor.until()[2])
        for node, live in self._live_nodes:
            node.extend(live.until())

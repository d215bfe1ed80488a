"""The service in lock-step with an aeroplane that lands by its ranges: images of the path that is really flown."""

from __future__ import annotations

from companion.cli.steps.lockstep import LockStepService
from companion.evaluation.landing.landing_rows import PathPoint, WatchedRange
from companion.evaluation.rendered_shots import InProcessRenderer, Stage
from companion.service.config import ServiceConfig
from companion.sim.landing.landing_flight import LandingFlight, RangeSource
from companion.sim.landing.landing_vehicle import LandingWorld
from companion.sim.vehicle.lockstep import EPOCH_NS, MemoryWire


class LandingService(LockStepService):
    """Stands where :class:`companion.cli.steps.lockstep.LockStepService` stands; ends when the landing is over."""

    def __init__(self, config: ServiceConfig, landing: LandingFlight) -> None:
        wire = MemoryWire()
        self.landing = landing
        self.path: list[PathPoint] = []
        world = LandingWorld(landing, wire, self._watched)
        super().__init__(config, world, wire, InProcessRenderer(Stage.of(world.flight, config.settings, EPOCH_NS)))

    def over(self) -> bool:
        """Whether it stands on its wheels, has gone around, or has flown too long."""
        return self.landing.over

    def _watched(self, source: RangeSource) -> RangeSource:
        watched = WatchedRange(self.landing, source)
        self.path = watched.path
        return watched

    def fly(self) -> None:
        """Fly to the end."""
        while not self.over():
            self.loop.run_once()

"""One landing as a task of the fleet's runner: fly it with its range finder, and give its row."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from companion.cli.steps.landing_lockstep import LandingService
from companion.cli.steps.options import named_value
from companion.evaluation.landing.false_reading import LONG_M, SHORT_M, OneFalseReading
from companion.evaluation.landing.landing_rows import RangeKind, Row, WatchedRange, landing_row
from companion.evaluation.landing.rigid_stereo import RigidStereo
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.service.config import ServiceConfig
from companion.sim.landing.approach import LandingParameters
from companion.sim.landing.landing_flight import LandingFlight, RangeSource, TrueRange, fly_landing

_FALSE_M = {RangeKind.FALSE_LONG: LONG_M, RangeKind.FALSE_SHORT: SHORT_M}
_UNSAID = "TRG_RATE="  # the rate of the images is that of every range finder, and not named with one


@dataclass(frozen=True, slots=True)
class LandingTask:
    """One landing: a task of :func:`companion.evaluation.fleet.runner.run`.

    ``changes`` are NAME=VALUE of settings, and ``folder`` is where its part goes.
    """

    airframe: str
    seed: int
    gusts: bool
    kind: RangeKind
    changes: tuple[str, ...]
    folder: Path

    @property
    def name(self) -> str:
        """Landing in a word."""
        return "-".join((self.airframe, "gusts" if self.gusts else "calm", str(self.seed), self.kind, *self.changes))

    @property
    def result_file(self) -> Path:
        """Where the row lies once it is made."""
        return self.folder / "parts" / f"{self.name}.json"


def landing_tasks(
    airframe: str, seeds: Iterable[int], kinds: Sequence[RangeKind], folder: Path, changes: Sequence[str] = ()
) -> list[LandingTask]:
    """Tasks of every seed, in calm and in gusts, with every range finder."""
    return [
        LandingTask(airframe, seed, gusts, kind, tuple(changes), folder)
        for seed in seeds
        for gusts in (False, True)
        for kind in kinds
    ]


def fly_task(task: LandingTask) -> Row:
    """Fly one landing."""
    settings = Settings().with_values(dict(named_value("--set", change) for change in task.changes))
    row = fly_one(load_airframe(task.airframe), task.seed, task.kind, settings, gusts=task.gusts)
    return row | {"settings": " ".join(change for change in task.changes if not change.startswith(_UNSAID))}


def fly_one(airframe: Airframe, seed: int, kind: RangeKind, settings: Settings, *, gusts: bool) -> Row:
    """Fly one landing with a range finder; its row."""
    limits = LandingParameters(range_min_m=settings.min_range_m, range_max_m=settings.max_range_m)
    return fly_by(LandingFlight(airframe, seed, gusts=gusts, limits=limits), kind, settings, gusts=gusts)


def fly_by(landing: LandingFlight, kind: RangeKind, settings: Settings, *, gusts: bool) -> Row:
    """Fly a landing to its end by a range finder; its row."""
    if kind is RangeKind.SPANWISE:
        with LandingService(ServiceConfig(landing.airframe, settings, ()), landing) as service:
            service.fly()
            return landing_row(kind, landing, service.path, gusts=gusts)
    watched = WatchedRange(landing, _source(landing, kind, settings))
    fly_landing(landing, watched)
    return landing_row(kind, landing, watched.path, gusts=gusts)


def _source(landing: LandingFlight, kind: RangeKind, settings: Settings) -> RangeSource:
    if kind is RangeKind.TRUTH:
        return TrueRange(landing)
    if kind in _FALSE_M:
        return OneFalseReading(landing, _FALSE_M[kind])
    return RigidStereo(landing, settings, in_trim=kind is RangeKind.IN_TRIM)

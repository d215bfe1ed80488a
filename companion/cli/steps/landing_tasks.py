"""One landing as a task of the fleet's runner: fly it with its range finder, and give its row."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from companion.cli.steps.landing_lockstep import LandingService
from companion.evaluation.fleet.runner import FileTask, run
from companion.evaluation.landing.landing_rows import RangeKind, Row, WatchedRange, landing_row
from companion.evaluation.landing.rigid_stereo import RigidStereo
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.service.config import ServiceConfig
from companion.sim.landing.approach import LandingParameters
from companion.sim.landing.landing_flight import LandingFlight, RangeSource, TrueRange, fly_landing

CALM, GUSTS = "calm", "gusts"
_UNSAID = "TRG_RATE="  # the rate of the images is that of every range finder, and not named with one
_BEFORE_SLOPE_S = 1.0  # rigid stereo's first image


def landing_tasks(
    airframe: str, seeds: Sequence[int], kinds: Sequence[RangeKind], folder: Path, changes: Sequence[str] = ()
) -> list[FileTask]:
    """Tasks of every seed, in calm and in gusts, with every range finder; ``changes`` are NAME=VALUE of settings."""
    tasks = []
    for seed in seeds:
        for air in (CALM, GUSTS):
            for kind in kinds:
                words = (airframe, str(seed), air, str(kind), *changes)
                tasks.append(FileTask(Path(f"{kind}-{air}-{seed}"), words, folder))
    return tasks


def fly_all(tasks: Sequence[FileTask], workers: int) -> Iterator[tuple[FileTask, Row]]:
    """Fly the tasks, each in a process of its own; a row that has ``failed`` says why."""
    return run(tasks, fly_task, workers)


def fly_task(task: FileTask) -> Row:
    """Fly one landing."""
    name, seed, air, kind, *changes = task.words
    settings = Settings()
    for change in changes:
        parameter, _, value = change.partition("=")
        settings = settings.replace(parameter, float(value))
    airframe, gusts = load_airframe(name), air == GUSTS
    row = fly_one(airframe, int(seed), RangeKind(kind), settings, gusts=gusts)
    return row | {"settings": " ".join(change for change in changes if not change.startswith(_UNSAID))}


def fly_one(airframe: Airframe, seed: int, kind: RangeKind, settings: Settings, *, gusts: bool) -> Row:
    """Fly one landing with a range finder; its row."""
    limits = LandingParameters(range_min_m=settings.min_range_m, range_max_m=settings.max_range_m)
    landing = LandingFlight(airframe, seed, gusts=gusts, limits=limits)
    if kind is RangeKind.SPANWISE:
        with LandingService(ServiceConfig(airframe, settings, ()), landing) as service:
            service.fly()
            return landing_row(kind, landing, service.path, gusts=gusts)
    watched = WatchedRange(landing, _source(landing, kind, settings))
    fly_landing(landing, watched)
    return landing_row(kind, landing, watched.path, gusts=gusts)


def _source(landing: LandingFlight, kind: RangeKind, settings: Settings) -> RangeSource:
    if kind is RangeKind.TRUTH:
        return TrueRange(landing)
    from_s = landing.approach.level_s - _BEFORE_SLOPE_S
    return RigidStereo(landing, settings, in_trim=kind is RangeKind.IN_TRIM, from_s=from_s)

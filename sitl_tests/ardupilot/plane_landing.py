"""Landings that a real ArduPlane flies by rigid stereo, by Spanwise and by the true range.

``python -m sitl_tests.ardupilot.plane_landing --arduplane FILE``. Take-off and circuit are flown in still air without a
range. On the final leg the flight goes on as a :class:`companion.sim.landing.landing_flight.LandingFlight`, with its
gusts, its wing and its range finder; ArduPlane steers on, in place of the autopilot of our own. Its barometer errs as
that one's does: the mission has the ground where the error puts it.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.cli.steps.landing_demo import sentence
from companion.cli.steps.landing_tasks import LandingTask, fly_by, landing_tasks
from companion.evaluation.fleet.campaign import work_off
from companion.evaluation.landing.landing_rows import RANGE_FINDERS, RangeKind, Row
from companion.evaluation.landing.landing_table import markdown
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.sim.flight.truth import body_from_ned_matrix
from companion.sim.landing.aerodynamics import Controls
from companion.sim.landing.approach import LandingParameters
from companion.sim.landing.autolander import LandingStage
from companion.sim.landing.control_loops import NavigationState
from companion.sim.landing.flexible_aircraft import STEP_NS, FlexibleAircraft
from companion.sim.landing.landing_flight import LandingFlight
from companion.units import GRAVITY_MPS2
from sitl_tests.ardupilot.plane_link import PlaneLink, circuit
from sitl_tests.ardupilot.rail import line_of, stamp_of
from sitl_tests.ardupilot.steered import REST, line_of_body
from tools.bench.landing import write_landings

PICTURE = Path(__file__).resolve().parents[1] / "plane_landing.png"
_MARKS = ("<!-- ArduPlane's landings: begin (generated) -->", "<!-- ArduPlane's landings: end -->")
IMAGES_HZ = 5.0  # of every range finder that has cameras
_RATE_HZ = 1_000_000_000 // STEP_NS
_TALK_FRAMES = 10
_BEFORE_SLOPE_M = 330.0  # final leg ahead of the slope: room for a turn and for the level leg
_LONGEST_S = 400.0


def circled(link: PlaneLink, aircraft: FlexibleAircraft, until_north_m: float) -> list[float]:
    """Fly from the wheels to the final leg; the state there, sixteen numbers.

    Raises
    ------
    TimeoutError
        It did not come there; the texts of the autopilot are named.
    """
    controls = Controls(*aircraft.state[12:16])
    while link.frames < _LONGEST_S * _RATE_HZ:
        aircraft.step(controls)
        body = aircraft.body(controls)
        controls = link.exchange(stamp_of(link.frames, _RATE_HZ) + line_of_body(body).encode())
        if link.frames % _TALK_FRAMES == 0:
            link.talk(link.frames / _RATE_HZ, None)
        on_final = link.reached >= 5 and abs(body.position_ned_m[1]) < 5.0 and abs(body.euler_rad[0]) < 0.1
        if on_final and body.position_ned_m[0] >= until_north_m:
            return list(aircraft.state)
    raise TimeoutError(f"no final leg in {_LONGEST_S:g} s: {link.texts[-3:]}")


class PlanePilot:
    """ArduPlane where :class:`companion.sim.landing.autolander.Autolander` stands.

    A period's commands are those of its last frame. ``stage``, ``flare`` and ``why`` are read from what it says.
    """

    def __init__(self, link: PlaneLink, landing: LandingFlight) -> None:
        self._link, self._landing = link, landing
        self._knots = 1  # the first is where the circuit ended
        self._heard = len(link.texts)
        self.stage = LandingStage.LEVEL
        self.flare: str | None = None
        self.why = ""
        self.dropped = 0

    def commands(self, state: NavigationState, range_m: float | None, *, on_wheels: bool) -> Controls:
        """Fly the newest period frame by frame; ``state`` is not used: ArduPlane has estimators of its own."""
        truth = self._landing.truth
        controls = Controls(0.0, 0.0, 0.0, 0.0)
        for knot, rate in zip(truth.knots[self._knots :], truth.derivatives[self._knots :], strict=True):
            line = self._line(knot, rate, state.airspeed_mps)
            controls = self._link.exchange(stamp_of(self._link.frames, _RATE_HZ) + line.encode())
        self._knots = len(truth.knots)
        self._link.talk(self._link.frames / _RATE_HZ, range_m)
        self._note(on_wheels=on_wheels)
        return controls

    def _line(self, knot: np.ndarray, rate: np.ndarray, airspeed_mps: float) -> str:
        acceleration = rate[3:6] - np.array([0.0, 0.0, GRAVITY_MPS2])
        force = body_from_ned_matrix(knot[None, 6:9])[0] @ acceleration
        return line_of(list(knot[9:12]), list(force), list(knot[0:3]), list(knot[6:9]), list(knot[3:6]), airspeed_mps)

    def _note(self, *, on_wheels: bool) -> None:
        for _, text in self._link.texts[self._heard :]:
            if "abort" in text.lower():
                self.stage, self.why = LandingStage.GO_AROUND, text
            elif self.stage in (LandingStage.LEVEL, LandingStage.SLOPE):
                if text.startswith("Flare"):
                    self.stage, self.flare = LandingStage.FLARE, text
                elif "approach start" in text or "glide slope" in text:
                    self.stage = LandingStage.SLOPE
        self._heard = len(self._link.texts)
        if self.stage is LandingStage.FLARE and on_wheels:
            self.stage = LandingStage.ROLL_OUT


def fly_with_plane(
    executable: Path, folder: Path, airframe: Airframe, seed: int, kind: RangeKind, settings: Settings, *, gusts: bool
) -> Row:
    """Fly take-off, circuit and landing; the row of the landing."""
    limits = LandingParameters(range_min_m=settings.min_range_m, range_max_m=settings.max_range_m)
    parameters = {
        "LAND_FLARE_ALT": limits.flare_alt_m, "LAND_FLARE_SEC": limits.flare_sec, "TECS_LAND_SINK": limits.sink_mps,
        "LAND_SLOPE_RCALC": limits.slope_recalc_m, "LAND_ABORT_DEG": math.degrees(limits.abort_rad),
        "RNGFND1_MIN": limits.range_min_m, "RNGFND1_MAX": limits.range_max_m,
    }  # fmt: skip
    plan = LandingFlight(airframe, seed, gusts=False, limits=limits)
    approach = plan.approach
    final_m = approach.slope_m + _BEFORE_SLOPE_M
    mission = circuit(final_m, approach.slope_m, approach.height_m, -plan.senses.barometer_m)
    with PlaneLink(executable, folder, parameters, mission) as link:
        state = circled(link, FlexibleAircraft(plan.aircraft.plane, plan.model, list(REST)), approach.start_north_m)
        landing = LandingFlight(airframe, seed, gusts=gusts, limits=limits, state=state)
        landing.pilot = PlanePilot(link, landing)
        row = fly_by(landing, kind, settings, gusts=gusts)
    return row | {"texts": [text for _, text in link.texts]}


@dataclass(frozen=True, slots=True)
class PlaneLandingTask:
    """One landing by ArduPlane: a task of :func:`companion.evaluation.fleet.runner.run`."""

    executable: Path
    landing: LandingTask

    @property
    def name(self) -> str:
        """Landing in a word."""
        return f"arduplane-{self.landing.name}"

    @property
    def result_file(self) -> Path:
        """Where the row lies once it is made."""
        return self.landing.folder / "parts" / f"{self.name}.json"


def fly_task(task: PlaneLandingTask) -> Row:
    """Fly one landing, in a worker."""
    wanted = task.landing
    settings = Settings().replace("TRG_RATE", IMAGES_HZ)
    airframe = load_airframe(wanted.airframe)
    with tempfile.TemporaryDirectory(prefix="arduplane-") as folder:
        return fly_with_plane(
            task.executable, Path(folder), airframe, wanted.seed, wanted.kind, settings, gusts=wanted.gusts
        )


def main(arguments: list[str] | None = None) -> int:
    """Fly and print the table."""
    parser = argparse.ArgumentParser(prog="plane_landing", description=__doc__)
    parser.add_argument("--arduplane", type=Path, required=True, metavar="FILE", help="executable built for SITL")
    parser.add_argument("--flights", type=int, default=10, help="landings of each kind")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--out", type=Path, default=Path("out/plane-landing"), help="where parts are left")
    parser.add_argument("--by", nargs="+", choices=list(RangeKind), default=list(RANGE_FINDERS), help="range finders")
    parser.add_argument("--write", action="store_true", help="table and picture into sitl_tests/README.md")
    options = parser.parse_args(arguments)
    kinds = [RangeKind(kind) for kind in options.by]
    landings = landing_tasks("nadir-2m", range(1, options.flights + 1), kinds, options.out)
    tasks = [PlaneLandingTask(options.arduplane, landing) for landing in landings]
    rows = [row for row in work_off(tasks, fly_task, options.workers, describe=sentence) if not row.get("failed")]
    print(f"{len(rows)} of {len(tasks)} landings")
    print(markdown(rows))
    if options.write:
        write_landings(rows, PICTURE, _MARKS)
    return 0


if __name__ == "__main__":
    sys.exit(main())

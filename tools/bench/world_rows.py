"""Rows of the worlds' campaign: world, airframe and axes of the nodes, and accidents in the ideal world."""

from __future__ import annotations

import dataclasses
import zlib
from dataclasses import dataclass

from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import Station
from companion.sim.flight.aircraft import FlightPlan, Jolt, circuit_plan, demo_plan
from companion.sim.flight.world_draw import as_calibrated
from companion.sim.flight.worlds import WORLDS

DURATION_S = 32.0
STRUCK_S = 18.0
AIRFRAMES = ("nadir-2m", "forward-2m")
SENSORS = ("6-axis", "vertical")
_MOST_FLIGHTS = 100  # of a row, so that no two rows of other conditions share a wing (choice)
_FROM_THE_GROUND = ("ideal", "fair", "rough")  # worlds of the flights that begin and end on it


@dataclass(frozen=True, slots=True)
class Accident:
    """One thing that goes wrong at :data:`STRUCK_S`: a sample that lies, a blow, a camera turned, stamps late, ...

    ``velocity_mps`` is how much faster than it flies the autopilot says to fly over ground from then on.
    """

    name: str = ""
    lie: tuple[Station, int, float] | None = None
    blow_mps2: float = 0.0
    knock_rad: float = 0.0
    late_share: float = 0.0
    late_s: float = 0.015
    velocity_mps: float = 0.0
    circuit: bool = False


ACCIDENTS = (
    Accident("root z +8 m/s2, one sample", lie=(Station.ROOT, 2, 8.0)),
    Accident("left z -4 m/s2, one sample", lie=(Station.LEFT, 2, -4.0)),
    Accident("a blow of 40 m/s2 for 20 ms", blow_mps2=40.0),
    Accident("a camera turned by 2 mrad", knock_rad=0.002),
    Accident("a fifth of the stamps 15 ms late", late_share=0.2),
    Accident("velocity over ground 3 m/s too high", velocity_mps=3.0),
)
ON_GROUND = Accident("ground roll, take-off, landing", circuit=True)


@dataclass(frozen=True, slots=True)
class CampaignRow:
    """One row of the table; a flight's seed follows from the row and its number.

    A ``reference`` flies as its world's row does, but without vibration and warm-up, and knows the sensors' true noise.
    """

    world: str
    airframe: str
    sensors: str
    accident: Accident = Accident()
    reference: bool = False

    @property
    def name(self) -> str:
        """World or accident, airframe, axes."""
        what = self.accident.name or self.world
        if self.reference:
            return f"{what}, reference"
        return f"{what} ({self.world})" if self.accident.name and self.world != "ideal" else what

    @property
    def is_ideal_circuit(self) -> bool:
        """Whether it is a flight from the ground with nothing else wrong."""
        return self.accident.circuit and self.world == "ideal"

    @property
    def key(self) -> str:
        """Folder of its flights."""
        words = f"{self.name} {self.airframe} {self.sensors}".replace("/", "").replace(",", "")
        return "".join(letter if letter.isalnum() or letter in "-" else "_" for letter in words)

    @property
    def first_number(self) -> int:
        """Number of the row's first flight: worlds and accidents have wings of their own, sensors share them.

        So a share of constants that are inside three sigma stands on as many wings as there are such rows. A reference
        has the wings of its world.
        """
        conditions = list(dict.fromkeys((row.world, row.accident) for row in rows()))
        return _MOST_FLIGHTS * conditions.index((self.world, self.accident))

    def seed(self, number: int) -> int:
        """Seed of one flight, by airframe and number."""
        return 1000 * (zlib.crc32(self.airframe.encode()) % 1000) + number

    def belief(self) -> Airframe:
        """The airframe that the estimator is given."""
        airframe = as_calibrated(load_airframe(self.airframe), WORLDS[self.world])
        if self.sensors == "6-axis":
            return airframe
        left, right = (dataclasses.replace(sensor, sends="z") for sensor in (airframe.left, airframe.right))
        return dataclasses.replace(airframe, left=left, right=right)

    def plan(self) -> FlightPlan:
        """The flight."""
        if self.accident.circuit:
            return circuit_plan(2.0 * DURATION_S)
        plan = demo_plan(DURATION_S)
        blow = self.accident.blow_mps2
        return dataclasses.replace(plan, jolts=(Jolt(STRUCK_S, blow),)) if blow else plan


def rows(world: str = "", airframe: str = "", sensors: str = "") -> list[CampaignRow]:
    """All rows, or those of the given world, airframe, axes; accidents belong to the worlds in which they happen."""
    worlds = [CampaignRow(w, a, s) for w in WORLDS for a in AIRFRAMES for s in SENSORS]
    everything = list(worlds)
    everything += [CampaignRow("ideal", "nadir-2m", "6-axis", accident) for accident in ACCIDENTS]
    everything += [CampaignRow(w, a, s, ON_GROUND) for w in _FROM_THE_GROUND for a in AIRFRAMES for s in SENSORS]
    everything += [dataclasses.replace(row, reference=True) for row in worlds]
    wanted = (("world", world), ("airframe", airframe), ("sensors", sensors))
    return [row for row in everything if all(getattr(row, name) == value for name, value in wanted if value)]

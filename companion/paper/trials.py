"""The experiments that are run again: the paper's own, and those it did not try."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.paper import printed
from companion.paper.bench import Drive
from companion.paper.range_tables import exact_toe_rad
from companion.params.files import load_airframe
from companion.sim.flight.aircraft import AltitudeStep, FlightPlan, PullUp, Roll

SEEDS = (5, 6, 7)  # convention: three draws, for a spread
SETTLE_S = 15.0  # chosen: clocks and tracker have settled, as in the evaluation of flights
_BOOM_RMS_M = 0.0004  # chosen: the paper prints no amplitude of the boom; the page of set-ups states this one
BOOM_PEAK_M = math.sqrt(2.0) * _BOOM_RMS_M  # derived: peak of a sine of that rms
_WING_RMS_M = 0.0015  # chosen: of the size of the 1.8 mm amplitude that Table 3's angles give
_FLIGHT_RMS_M = 0.005  # chosen: the bend of an aircraft in gusts, above the paper's laboratory
_FLOWN_FROM_M = 60.0  # chosen: the paper's far target as height above the ground


@dataclass(frozen=True, slots=True)
class Pace:
    """How long each experiment runs; shots count from ``from_s`` on, when the wing has been moving that long."""

    duration_s: float
    from_s: float = SETTLE_S


FULL, QUICK = Pace(23.0), Pace(19.0)
REPEATED = ("boom_1m", "boom_random", "wing_60m", "wing_random")
"""One of each kind that the paper did, flown with every seed: for the spread over booms and wings."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One experiment.

    ``drive`` None is a flight in gusts along ``plan``'s manoeuvres; ``calibrated_at_m`` are the rest targets'
    distances, empty where the airframe's own calibration (drawn from its sigmas) stands. The paper's errors are in
    percent of range, None where it prints none.
    """

    key: str
    title: str
    airframe: str
    drive: Drive | None
    amplitude_m: float
    distance_m: float
    calibrated_at_m: tuple[float, ...] = ()
    paper_before_percent: float | None = None
    paper_after_percent: float | None = None
    manoeuvres: bool = False

    @property
    def of_paper(self) -> bool:
        """Whether the paper tried it."""
        return self.key.startswith(("boom", "wing"))


def flight_plan(trial: Trial, pace: Pace) -> FlightPlan:
    """Level flight in turbulence; with manoeuvres a bank and a pull-up while shots are taken."""
    level = (AltitudeStep(0.0, _FLOWN_FROM_M),)
    if not trial.manoeuvres:
        return FlightPlan(pace.duration_s, levels=level)
    bank = Roll(pace.from_s - 1.0, 0.35, 1.5, 1.0)
    return FlightPlan(pace.duration_s, levels=level, rolls=(bank,), pull_ups=(PullUp(pace.from_s + 1.0, 1.5),))


def wing_amplitude_m() -> float:
    """Deflection amplitude that gives the mean of Table 3's exact angles at a peak, half at each camera."""
    factor = load_airframe("paper-flying-wing").wing.symmetric.slope_factor_radpm.value
    return float(np.mean([exact_toe_rad(entry) for entry in printed.OBJECTS])) / (2.0 * factor)


def trials() -> tuple[Trial, ...]:
    """All experiments, in the order of the report."""
    return (*_booms(), *_wings(), *_untried())


def _booms() -> tuple[Trial, ...]:
    boom, peak, near = "paper-beam", BOOM_PEAK_M, (1.0, 2.0)
    return (
        Trial("boom_1m", "boom on the shaker, target at 1 m", boom, Drive.SHAKER_SINE, peak, 1.0, near),
        Trial("boom_2m", "boom on the shaker, target at 2 m", boom, Drive.SHAKER_SINE, peak, 2.0, near),
        Trial("boom_random", "boom, random shaker, 1.5 m", boom, Drive.SHAKER_NOISE, _BOOM_RMS_M, 1.5, near),
    )


def _wings() -> tuple[Trial, ...]:
    wing, far, amplitude = "paper-flying-wing", (4.0, 8.0), wing_amplitude_m()
    objects = tuple(
        Trial(
            f"wing_{entry.name.split()[0].lower()}", f"2 m wing, {entry.name.lower()} at {entry.still_m} m",
            wing, Drive.SINE, amplitude, entry.still_m, far, entry.error_percent, entry.left_percent or 0.0,
        )
        for entry in printed.OBJECTS
    )  # fmt: skip
    return (
        *objects,
        Trial("wing_60m", "2 m wing, target at 60 m", wing, Drive.SINE, amplitude, printed.FAR_M, far,
              printed.FAR_ERROR_PERCENT, printed.FAR_LEFT_PERCENT),
        Trial("wing_random", "2 m wing, random load, 60 m", wing, Drive.NOISE, _WING_RMS_M, printed.FAR_M, far),
    )  # fmt: skip


def _untried() -> tuple[Trial, ...]:
    wing, level = "paper-flying-wing", "level flight in gusts, cameras down, 60 m"
    return (
        Trial("antisymmetric", "2 m wing, antisymmetric load alone, 60 m", wing, Drive.ANTISYMMETRIC, _WING_RMS_M,
              printed.FAR_M, (4.0, 8.0)),
        Trial("antisymmetric_six", "the same with six-axis nodes (nadir-2m)", "nadir-2m", Drive.ANTISYMMETRIC,
              _WING_RMS_M, printed.FAR_M),
        Trial("forward", "cameras forward, random load, wall at 60 m", "forward-2m", Drive.NOISE, _FLIGHT_RMS_M, 60.0),
        Trial("lift", level, "nadir-2m", None, _FLIGHT_RMS_M, _FLOWN_FROM_M),
        Trial("manoeuvres", "the same with a bank and a pull-up", "nadir-2m", None, _FLIGHT_RMS_M, _FLOWN_FROM_M,
              manoeuvres=True),
    )  # fmt: skip

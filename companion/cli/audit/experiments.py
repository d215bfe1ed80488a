"""The paper's experiments, and those it did not try, run again with rendered images through the whole pipeline."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.cli.audit import printed
from companion.cli.audit.bench import Drive, Setup, hang, target
from companion.cli.audit.loop import Scored, fly
from companion.cli.audit.range_tables import toe_rad, wide_factor
from companion.cli.audit.rest_calibration import calibrate, settings_for
from companion.cli.judge import Reading
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Bytes, Floats, Side
from companion.sim.aircraft import FlightPlan, Level
from companion.sim.cameras import Shutters, render_pair
from companion.sim.flight import Flight, build_flight
from companion.sim.renderer import Renderer
from companion.sim.scene import Scene, ground_scene

_SEED = 5
_RANDOM_SHOTS_PER_S = 2.5
_PEAK_RATE_HZ = 3.0
_LAG_S = 0.8
_BOOM_RMS_M = 0.0004
_WING_RMS_M = 0.0015
_FLIGHT_RMS_M = 0.005
_FLOWN_FROM_M = 60.0
WAYS = ("rigid", "in_trim", "corrected", "oracle")


@dataclass(frozen=True, slots=True)
class Pace:
    """How long each experiment runs, and from when shots count (the tracker refits for 10 s)."""

    duration_s: float
    from_s: float


FULL, QUICK = Pace(17.0, 10.5), Pace(14.0, 10.5)


@dataclass(frozen=True, slots=True)
class Trial:
    """One experiment.

    ``drive`` None is a level flight in gusts; ``calibrated_at_m`` are the rest targets' distances,
    empty where the airframe's own calibration (drawn from its sigmas) stands.
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


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """What an experiment gave: scored shots and one pair of its images."""

    trial: Trial
    shots: tuple[Scored, ...]
    images: tuple[Bytes, Bytes]


def wing_amplitude_m() -> float:
    """Deflection amplitude that gives the mean of Table 3's exact angles at a peak, half at each camera."""
    factor = load_airframe("paper-flying-wing").wing.symmetric.slope_factor_radpm.value
    angles = [toe_rad(e.still_m, e.vibrating_m) / wide_factor(e.still_m) for e in printed.OBJECTS]
    return float(np.mean(angles)) / (2.0 * factor)


def trials() -> tuple[Trial, ...]:
    """All experiments, in the order of the report."""
    boom, wing, peak = "paper-beam", "paper-flying-wing", float(np.sqrt(2.0)) * _BOOM_RMS_M
    near, far = (1.0, 2.0), (4.0, 8.0)
    amplitude = wing_amplitude_m()
    objects = tuple(
        Trial(
            f"wing_{entry.name.split()[0].lower()}", f"2 m wing, {entry.name.lower()} at {entry.still_m} m",
            wing, Drive.SINE, amplitude, entry.still_m, far, entry.error_percent, entry.left_percent or 0.0,
        )
        for entry in printed.OBJECTS
    )  # fmt: skip
    return (
        Trial("boom_1m", "boom on the shaker, target at 1 m", boom, Drive.SHAKER_SINE, peak, 1.0, near),
        Trial("boom_2m", "boom on the shaker, target at 2 m", boom, Drive.SHAKER_SINE, peak, 2.0, near),
        *objects,
        Trial("wing_60m", "2 m wing, target at 60 m", wing, Drive.SINE, amplitude, printed.FAR_M, far,
              printed.FAR_ERROR_PERCENT, printed.FAR_LEFT_PERCENT),
        Trial("boom_random", "boom, random shaker 0-200 Hz, 1.5 m", boom, Drive.SHAKER_NOISE, _BOOM_RMS_M, 1.5, near),
        Trial("wing_random", "2 m wing, random load, 60 m", wing, Drive.NOISE, _WING_RMS_M, printed.FAR_M, far),
        Trial("antisymmetric", "cameras down, antisymmetric load alone, 60 m", "nadir-2m", Drive.ANTISYMMETRIC,
              _WING_RMS_M, printed.FAR_M),
        Trial("forward", "cameras forward, gusts, wall at 60 m", "forward-2m", Drive.NOISE, _FLIGHT_RMS_M, 60.0),
        Trial("lift", "in flight, cameras down, 60 m: lift bends the wing", "nadir-2m", None, _FLIGHT_RMS_M, 60.0),
    )  # fmt: skip


def run(trial: Trial, pace: Pace) -> Outcome:
    """Calibrate, vibrate, trigger, correct, range; the whole of it in this process."""
    import cv2

    cv2.setNumThreads(1)
    flight, scene, settings = _prepared(trial, pace)
    count = round(_RANDOM_SHOTS_PER_S * (pace.duration_s - pace.from_s))
    rng = np.random.default_rng([_SEED, 0xED6E])
    edges_ns = np.rint(1e9 * rng.uniform(pace.from_s, pace.duration_s - _LAG_S, count)).astype(np.int64)
    shots = fly(flight, scene, settings, pace.from_s, edges_ns)
    renderer = Renderer(flight.real.actual, flight.truth, scene, flight.seed)
    pair = render_pair(renderer, Shutters(flight.real.actual, flight.seed), int(edges_ns[0]), 0)
    return Outcome(trial, tuple(shots), (pair.left.image, pair.right.image))


def _prepared(trial: Trial, pace: Pace) -> tuple[Flight, Scene, Settings]:
    airframe = load_airframe(trial.airframe)
    settings = Settings().replace("TRG_RATE", _PEAK_RATE_HZ)
    if trial.drive is None:
        flight = build_flight(airframe, _SEED, plan=_flight_plan(pace.duration_s))
        return flight, ground_scene(_SEED), settings
    settings = settings_for(settings, trial.distance_m)
    setup = Setup(airframe, trial.drive, trial.amplitude_m, trial.distance_m, _SEED, pace.duration_s)
    flight = hang(setup)
    if trial.calibrated_at_m:
        flight = dataclasses.replace(flight, airframe=calibrate(setup, settings, trial.calibrated_at_m))
    return flight, target(setup), settings


def _flight_plan(duration_s: float) -> FlightPlan:
    """Level flight in turbulence; lift, gusts and wobble bend the wing."""
    return FlightPlan(duration_s, levels=(Level(0.0, _FLOWN_FROM_M),))


# ------------------------------------------------------------------------------------------------ summaries


def summary(outcome: Outcome, planned: bool) -> dict[str, Any]:
    """Errors of every way over the shots at peaks (``planned``), or at random instants."""
    shots = [shot for shot in outcome.shots if shot.planned == planned]
    found: dict[str, Any] = {
        "shots": len(shots),
        "trusted": sum(shot.trusted for shot in shots),
        "toe_rms_mrad": _rms(np.array([1e3 * shot.toe_rad for shot in shots])),
        "blur_median_px": float(np.median([shot.blur_px for shot in shots])) if shots else float("nan"),
    }
    for way in WAYS:
        readings = [reading for shot in shots if (reading := getattr(shot, way)) is not None]
        found[way] = _errors(readings)
    before, after = found["rigid"]["inverse_rms_pm"], found["corrected"]["inverse_rms_pm"]
    found["removed"] = 1.0 - after / before if before else float("nan")
    trim = found["in_trim"]["inverse_rms_pm"]
    found["removed_of_in_trim"] = 1.0 - after / trim if trim else float("nan")
    return found


def _errors(readings: Sequence[Reading]) -> dict[str, Any]:
    inverse = np.array([reading.inverse_pm for reading in readings])
    true = np.array([reading.true_inverse_pm for reading in readings])
    met = inverse > 0
    percent = 100.0 * np.abs(true[met] / inverse[met] - 1.0)
    return {
        "n": len(readings),
        "beyond_infinity": int(np.sum(~met)),
        "rms_percent": _rms(percent),
        "median_percent": float(np.median(percent)) if len(percent) else float("nan"),
        "median_range_m": float(np.median(1.0 / inverse[met])) if len(percent) else float("nan"),
        "inverse_rms_pm": _rms(inverse - true),
    }


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def one_tip_toe_error_mrad(outcome: Outcome) -> float:
    """Rms of what a correction by one tip alone, taken for symmetric, would get wrong (the paper's assumption)."""
    return 1e3 * _rms(np.array([2.0 * shot.tip_rad[Side.RIGHT] - shot.toe_rad for shot in outcome.shots]))

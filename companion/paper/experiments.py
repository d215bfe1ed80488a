"""Runs one experiment with rendered images through the whole pipeline: calibrate, vibrate, trigger, correct, range."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from companion.core.stereo.geometry import Rig
from companion.paper.bench import Setup, laboratory_flight, target_scene
from companion.paper.loop import fly
from companion.paper.rest_calibration import calibrate, settings_for
from companion.paper.shots import Flown
from companion.paper.trials import Pace, Trial, flight_plan
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Bytes
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.vision.cameras import Shutters, render_pair
from companion.sim.vision.renderer import Renderer
from companion.sim.vision.scene import Scene, ground_scene

_RANDOM_SHOTS_PER_S = 2.5  # chosen: about as many as the trigger takes, so that both scores are as good
_PEAK_RATE_HZ = 3.0  # chosen: at most three shots a second, as the page of set-ups states
_LAG_S = 0.8  # the smoother needs the samples after a shot (choice)


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Result of an experiment: its shots, one pair of its images, and how far belief and truth are apart.

    ``baseline_m`` is the believed distance of the cameras. ``slope_factor_gap`` is the believed slope factor of the
    first symmetric mode over the true one, less 1: the part of the correction that no tracker can mend.
    """

    trial: Trial
    flown: Flown
    images: tuple[Bytes, Bytes]
    baseline_m: float
    slope_factor_gap: float


def run(trial: Trial, pace: Pace, seed: int) -> Outcome:
    """The whole of one experiment, in this process; everything follows from ``seed``."""
    import cv2

    cv2.setNumThreads(1)
    flight, scene, settings = _prepared(trial, pace, seed)
    last_s = pace.duration_s - _LAG_S
    rng = np.random.default_rng([seed, 0xED6E])
    count = round(_RANDOM_SHOTS_PER_S * (last_s - pace.from_s))
    edges_ns = np.rint(1e9 * rng.uniform(pace.from_s, last_s, count)).astype(np.int64)
    flown = fly(flight, scene, settings, (pace.from_s, last_s), edges_ns)
    renderer = Renderer(flight.real.actual, flight.truth, scene, flight.seed)
    pair = render_pair(renderer, Shutters(flight.real.actual, flight.seed), int(edges_ns[0]), 0)
    believed = flight.airframe.wing.symmetric.slope_factor_radpm.value
    gap = believed / flight.real.actual.wing.symmetric.slope_factor_radpm.value - 1.0
    baseline_m = Rig.from_airframe(flight.airframe).baseline_m
    return Outcome(trial, flown, (pair.left.image, pair.right.image), baseline_m, gap)


def _prepared(trial: Trial, pace: Pace, seed: int) -> tuple[Flight, Scene, Settings]:
    airframe = load_airframe(trial.airframe)
    settings = Settings().replace("TRG_RATE", _PEAK_RATE_HZ)
    if trial.drive is None:
        return build_flight(airframe, seed, plan=flight_plan(trial, pace)), ground_scene(seed), settings
    settings = settings_for(settings, trial.distance_m)
    setup = Setup(airframe, trial.drive, trial.amplitude_m, trial.distance_m, seed, pace.duration_s)
    flight = laboratory_flight(setup)
    if trial.calibrated_at_m:
        flight = dataclasses.replace(flight, airframe=calibrate(setup, settings, trial.calibrated_at_m))
    return flight, target_scene(setup), settings

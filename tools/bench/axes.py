"""All axes of the wing nodes against the vertical ones alone, on the same shots: ``python -m tools.bench axes``.

Flies the demo in lock-step, seed by seed, and replays each recording with every other axis hidden. Rows are paired:
the same exposures, the same matches. ``gain`` is the slope of the fast toe error over the fast toe: an error of scale,
constant for a flight, that shows in every swing; ``rest`` is what the fast error would be without it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.steps.lockstep import lock_step_service
from companion.evaluation.flight_evaluation import vertical_only
from companion.evaluation.metrics import DISTANCES_M, FAST_HZ, near, slow_part
from companion.evaluation.rendered_shots import Stage
from companion.evaluation.replay import own_inputs
from companion.evaluation.shot_scores import Shots, collect, replayed, score_shots
from companion.evaluation.true_geometry import TrueGeometry
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Floats
from companion.service.config import ServiceConfig
from companion.sim.flight.flight import build_flight
from companion.sim.vehicle.lockstep import EPOCH_NS


@dataclass(frozen=True, slots=True)
class Paired:
    """One flight, shot by shot: true range and toe, and the toe error of either, rad."""

    seed: int
    z_true_m: Floats
    fast_toe_rad: Floats
    all_axes: Floats
    vertical: Floats
    all_axes_fast: Floats
    vertical_fast: Floats


def fly_pair(airframe: Airframe, seed: int, duration_s: float) -> Paired:
    """Fly a seed and judge it both ways."""
    flight, settings = build_flight(airframe, seed, duration_s), Settings()
    stage = Stage.of(flight, settings, EPOCH_NS)
    judge = TrueGeometry(flight, stage.renderer(), settings, EPOCH_NS)
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "flight.mcap"
        with lock_step_service(ServiceConfig(airframe, settings, (), recording=recording), flight) as service:
            while not service.over():
                service.wait(1.0)
        opened = open_recording(recording)
        flown = collect(opened.records())
        inputs = vertical_only(own_inputs(opened.records(), opened.airframe, settings))
        shots, alone = score_shots(judge, flown), score_shots(judge, replayed(inputs, airframe, settings))
    _, ours, theirs = np.intersect1d(shots.t_s, alone.t_s, assume_unique=True, return_indices=True)
    toes = [float(judge.true_deflection(int(flown.matches[i].mid_exposure_ns[0])).slope_rad.sum()) for i in shots.ids]
    toe = np.array(toes) - slow_part(shots.t_s, np.array(toes), FAST_HZ)
    errors = [_errors(run, at) for run, at in ((shots, ours), (alone, theirs))]
    (all_axes, all_fast), (vertical, vertical_fast) = errors
    z_true_m = shots.ways["corrected"].z_true_m[ours]
    return Paired(seed, z_true_m, toe[ours], all_axes, vertical, all_fast, vertical_fast)


def _errors(run: Shots, at: Floats) -> tuple[Floats, Floats]:
    corrected = run.ways["corrected"]
    return corrected.toe_error_rad[at], corrected.fast_toe_error_rad()[at]


def gain(flown: Paired, error: Floats) -> tuple[float, float]:
    """Slope of a fast error over the fast toe, and the rms of what is left of it (mrad)."""
    slope = float(error @ flown.fast_toe_rad / (flown.fast_toe_rad @ flown.fast_toe_rad))
    return slope, _rms_mrad(error - slope * flown.fast_toe_rad)


def _rms_mrad(values: Floats) -> float:
    return 1e3 * float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--airframe", default="nadir-2m")
    parser.add_argument("--seeds", type=int, default=5, help="flights, from seed 1")
    parser.add_argument("--duration", type=float, default=60.0, help="of each, s")
    options, _ = parser.parse_known_args(arguments)
    airframe = load_airframe(options.airframe)
    print("toe error, mrad rms, all axes / vertical alone, on the same shots; gain and rest of the fast part")
    flights = []
    for seed in range(1, options.seeds + 1):
        flown = fly_pair(airframe, seed, options.duration)
        flights.append(flown)
        print(f"seed {seed:3d}: {_row(flown)}", flush=True)
    for distance_m in DISTANCES_M:
        errors = [(f.all_axes[m], f.vertical[m]) for f in flights if (m := near(f.z_true_m, distance_m)).any()]
        wins = sum(_rms_mrad(ours) < _rms_mrad(alone) for ours, alone in errors)
        print(f"near {distance_m:g} m: all axes better in {wins} of {len(errors)} flights")
    return 0


def _row(flown: Paired) -> str:
    parts = [f"{len(flown.all_axes)} shots {_rms_mrad(flown.all_axes):.3f} / {_rms_mrad(flown.vertical):.3f}"]
    for distance_m in DISTANCES_M:
        m = near(flown.z_true_m, distance_m)
        parts.append(f"{distance_m:g} m {_rms_mrad(flown.all_axes[m]):.3f} / {_rms_mrad(flown.vertical[m]):.3f}")
    for name, error in (("all", flown.all_axes_fast), ("vertical", flown.vertical_fast)):
        slope, rest = gain(flown, error)
        parts.append(f"{name} fast {_rms_mrad(error):.3f}, gain {100 * slope:+.2f} %, rest {rest:.3f}")
    return "; ".join(parts)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Flights with rendered images, toe and range over their sigmas: ``python -m tools.bench rendered``.

Images of both cameras are rendered through the true wing at a steady rate, matched and corrected by the whole pipeline,
as in the demo, but without a live service; what is judged begins at the tenth second. Mounting, lenses and trim are
drawn once a flight and hold for all of it: one flight's error over sigma is hardly more than one draw, and only the
root mean square over flights tells whether the sigma is honest.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from companion.core.pipeline import start, step
from companion.evaluation.flight_evaluation import matches_of, shot_requests
from companion.evaluation.metrics import SETTLED_S, rms
from companion.evaluation.rendered_shots import ShotRenderer, Stage
from companion.evaluation.shot_scores import collect, score_shots
from companion.evaluation.true_geometry import TrueGeometry
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import CorrectedRange, Floats, MatchSet, Record
from companion.sim.flight.flight import build_flight
from companion.sim.flight.offline import HOST_EPOCH_NS
from companion.sim.flight.world_draw import as_calibrated
from companion.sim.flight.worlds import IDEAL, WORLDS, Conditions
from tools.bench.slow import in_order

_FIRST_S, _LAST_S = 0.5, 0.6  # from the start, before the end
_NO_SHOTS = 2


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight, pair by pair, rad: error and sigma of the toe, and of trusted ranges, scored as toe."""

    seed: int
    toe_error_rad: Floats
    toe_sigma_rad: Floats
    range_error_rad: Floats
    range_sigma_rad: Floats

    @property
    def toe_over(self) -> float:
        """Root mean square error of the toe over its sigma."""
        return rms(self.toe_error_rad / self.toe_sigma_rad)

    @property
    def range_over(self) -> float:
        """The same of the trusted ranges."""
        return rms(self.range_error_rad / self.range_sigma_rad)


def fly_one_seed(airframe: Airframe, seed: int, duration_s: float, rate_hz: float, world: Conditions = IDEAL) -> Flown:
    """One flight."""
    flight = build_flight(airframe, seed, duration_s, world=world)
    stage = Stage.of(flight, Settings(), HOST_EPOCH_NS)
    judge, renderer = TrueGeometry(flight, stage.renderer(), stage.settings, HOST_EPOCH_NS), ShotRenderer(stage)
    edges_s = np.arange(_FIRST_S, duration_s - _LAST_S, 1.0 / rate_hz)
    shots = matches_of(renderer.render(request) for request in shot_requests(edges_s, HOST_EPOCH_NS))
    state = start(airframe, dataclasses.replace(Settings(), trigger_policy=_NO_SHOTS))
    records: list[Record] = []
    for record in in_order(flight, shots):
        state, outputs = step(state, record)
        records += [record, *outputs] if isinstance(record, MatchSet) else outputs
    flown = collect(records)
    scored = score_shots(judge, flown)
    ranges = [flown.ranges[pair_id] for pair_id in scored.ids]
    trusted = np.array([entry.trusted for entry in ranges], dtype=bool)
    corrected = scored.ways["corrected"]
    return Flown(
        seed,
        np.array([entry.toe_rad - judge.true_toe_rad(flown.matches[entry.pair_id]) for entry in ranges]),
        np.array([entry.toe_sigma_rad for entry in ranges]),
        corrected.toe_error_rad[trusted],
        np.array([corrected.baseline_m * _inverse_sigma(entry) for entry in ranges])[trusted],
    )


def _inverse_sigma(entry: CorrectedRange) -> float:
    return entry.sigma_m / entry.range_m**2


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 when a sigma lies outside 99 % of chi-square by one draw a flight."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--airframe", default="forward-2m")
    parser.add_argument("--world", default=IDEAL.name, choices=[*WORLDS])
    parser.add_argument("--first", type=int, default=1, help="seed of the first flight")
    parser.add_argument("--seeds", type=int, default=4, help="flights")
    parser.add_argument("--duration", type=float, default=27.0, help="of each, s")
    options, _ = parser.parse_known_args(arguments)
    world, rows = WORLDS[options.world], []
    airframe = as_calibrated(load_airframe(options.airframe), world)
    print(f"toe and range of {airframe.name} in {world.name} from {SETTLED_S:g} s on, mrad; trusted ranges as toe")
    print("seed  pairs  toe mean   rms  stated  error/sigma  ranges   rms  stated  error/sigma")
    for seed in range(options.first, options.first + options.seeds):
        row = fly_one_seed(airframe, seed, options.duration, 4.0, world)
        rows.append(row)
        print(
            f"{seed:4d} {len(row.toe_error_rad):6d} {1e3 * np.mean(row.toe_error_rad):+9.3f}"
            f" {1e3 * rms(row.toe_error_rad):5.3f} {1e3 * rms(row.toe_sigma_rad):7.3f} {row.toe_over:12.2f}"
            f" {len(row.range_error_rad):7d} {1e3 * rms(row.range_error_rad):5.3f}"
            f" {1e3 * rms(row.range_sigma_rad):7.3f} {row.range_over:12.2f}",
            flush=True,
        )
    low, high = np.sqrt(chi2.ppf([0.005, 0.995], len(rows)) / len(rows))
    toe, measured = (rms(np.array([getattr(row, name) for row in rows])) for name in ("toe_over", "range_over"))
    print(f"all: toe {toe:.2f}, ranges {measured:.2f} of sigma; honest between {low:.2f} and {high:.2f} (99 %)")
    return int(not (low < toe < high and low < measured < high))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

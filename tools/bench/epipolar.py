"""Rotation of real image pairs (EuRoC) flexed by +-5 mrad: modal, epipolar and both, beside the Cramer-Rao bound.

What is tuned is tuned on the first 15 of the 40 pairs; the others, under other rotations, are judged.

The bound is that of Cramer and Rao for these very matches (their scatter about each pair's own fit, blunders left out)
with the priors that any estimator may use: slow part followed from pair to pair, fast part known to 0.3 mrad, focal
lengths, radial terms and baseline known to their sigmas. It bounds the mean over all noise.

All seeds turn the same twenty judged pairs, so that their errors are not independent: what lenses and matching leave in
its place is one draw for all of them. The last line takes the yaw's error apart: what all seeds share, what is constant
in a seed (slow part, lenses under that turn), what changes from pair to pair. By these parts a single seed lies above
1.5 times the bound about once in four; so the yaw is judged by all seeds together.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np

from companion.core.stereo.geometry import Rig
from companion.errors import RecordingError
from companion.records import Floats
from tools.bench.euroc_flexing import FAST_SIGMA_RAD, euroc_airframe, flexed_pairs
from tools.bench.euroc_judging import METHODS, TUNED, calibration_error, cramer_rao, estimate, split, tuned_prior

_DATA = Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[3] / "shared"))
_SETTLED = 5
_LIMIT_MRAD = 0.1
_OVER_BOUND = 1.5


def run(folder: Path = _DATA / "measured" / "euroc-stereo", seeds: tuple[int, ...] = (1,)) -> list[dict[str, object]]:
    """One row per seed of the rotations and method: rms error in mrad of pitch, yaw, roll, and the Cramer-Rao bound."""
    rig = Rig.from_airframe(euroc_airframe(folder))
    prior = tuned_prior(rig, flexed_pairs(folder, rig, seed=0, which=slice(0, TUNED)))
    rows: list[dict[str, object]] = []
    for seed in seeds:
        pairs = flexed_pairs(folder, rig, seed, which=slice(TUNED, None))
        used = split(pairs)
        off = calibration_error(rig, pairs, used, prior)
        for method in METHODS:
            verdict = estimate(rig, pairs, used, method, prior)
            rms = 1e3 * np.sqrt(np.mean((verdict.error_rad - off)[_SETTLED:] ** 2, axis=0))
            row: dict[str, Any] = {"way": method, "seed": seed}
            row |= {"pitch_mrad": rms[0], "roll_mrad": rms[2], "yaw_mrad": rms[1]}
            row["stated_yaw_mrad"] = 1e3 * float(np.sqrt(np.mean(verdict.sigma_rad[_SETTLED:, 1] ** 2)))
            if method != "modal":
                bound = cramer_rao(rig, pairs, used, FAST_SIGMA_RAD if method == "both" else None, prior)
                row["bound_yaw_mrad"] = 1e3 * float(np.sqrt(np.mean(bound[_SETTLED:, 1] ** 2)))
                row["yaw_over_bound"] = rms[1] / row["bound_yaw_mrad"]
                row["units"] = ((verdict.error_rad - off) / bound)[_SETTLED:, 1]
            rows.append(row)
    return rows


def _parts(units: Floats) -> str:
    """Errors (seeds, pairs) over their bounds, taken apart by the analysis of variance."""
    if len(units) < 2:
        return "one seed alone does not tell"
    within = float(units.var(axis=1, ddof=1).mean())
    between = max(float(units.mean(axis=1).var(ddof=1)) - within / units.shape[1], 0.0)
    shared, alone = abs(float(units.mean())), float(np.sqrt(within + between))
    return f"{shared:.2f} shared by all seeds, {between**0.5:.2f} of a seed, {within**0.5:.2f} of a pair ({alone:.2f})"


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 when pitch, roll or yaw of both together miss their targets."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6)
    options, _ = parser.parse_known_args(arguments)
    folder = _DATA / "measured" / "euroc-stereo"
    if not folder.exists():
        raise RecordingError(f"{folder} is not there; SPANWISE_DATA names the folder of the measured data")
    missed, ratios, units = 0, [], []
    for row in run(folder, tuple(range(1, options.seeds + 1))):
        cells = (
            f"{key} {value:.3f}" if isinstance(value, float) else f"{key} {value!s:8s}"
            for key, value in row.items()
            if key != "units"
        )
        print("  ".join(cells))
        if row["way"] == "both":
            pitch, roll, yaw, bound = (
                float(str(row[key])) for key in ("pitch_mrad", "roll_mrad", "yaw_mrad", "bound_yaw_mrad")
            )
            missed |= max(pitch, roll) > _LIMIT_MRAD
            ratios.append(yaw / bound)
            units.append(np.asarray(row["units"]))
    pooled = float(np.sqrt(np.mean(np.square(ratios))))
    missed |= pooled > _OVER_BOUND
    print(f"both, yaw over its bound: {pooled:.2f} rms over {len(ratios)} seeds, {max(ratios):.2f} at most")
    print(f"of that: {_parts(np.array(units))}")
    print(f"target, both: pitch and roll <= {_LIMIT_MRAD} mrad, yaw <= {_OVER_BOUND} x its bound over all seeds")
    return int(missed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Rotation of real image pairs (EuRoC) flexed by +-5 mrad: modal, epipolar and both, beside the bound."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from companion.core.stereo.geometry import Rig
from sitl_tests.replay.euroc_flexing import FAST_SIGMA_RAD, euroc_airframe, flexed_pairs
from sitl_tests.replay.euroc_judging import WAYS, calibration_error, cramer_rao, estimate, split

_DATA = Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[3] / "shared"))
_SETTLED = 5


def run(folder: Path = _DATA / "measured" / "euroc-stereo") -> list[dict[str, object]]:
    """One row per way: rms error in mrad of pitch, yaw, roll, and the Cramer-Rao bound of yaw."""
    rig = Rig.from_airframe(euroc_airframe(folder))
    pairs = flexed_pairs(folder, rig)
    used = split(pairs)
    off = calibration_error(rig, pairs, used)
    rows: list[dict[str, object]] = []
    for way in WAYS:
        verdict = estimate(rig, pairs, used, way)
        rms = 1e3 * np.sqrt(np.mean((verdict.error_rad - off)[_SETTLED:] ** 2, axis=0))
        row: dict[str, object] = {"way": way, "pitch_mrad": rms[0], "roll_mrad": rms[2], "yaw_mrad": rms[1]}
        row["stated_yaw_mrad"] = 1e3 * float(np.sqrt(np.mean(verdict.sigma_rad[_SETTLED:, 1] ** 2)))
        if way != "modal":
            bound = cramer_rao(rig, pairs, used, FAST_SIGMA_RAD if way == "both" else None)
            row["bound_yaw_mrad"] = 1e3 * float(np.sqrt(np.mean(bound[_SETTLED:, 1] ** 2)))
        rows.append(row)
    return rows


def main() -> None:
    for row in run():
        print(
            "  ".join(
                f"{key} {value:.3f}" if isinstance(value, float) else f"{value!s:9s}" for key, value in row.items()
            )
        )


if __name__ == "__main__":
    main()

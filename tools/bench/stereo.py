"""Cost of stereo while the extrinsics move, against OpenCV's rigid pipeline: ``python -m tools.bench stereo``.

Both pipelines see the same images, matcher and settings, one thread, in turns. The rigid one has its fixed-point maps
made once; the moving one has a new pose, and so new float maps, for every pair. Beside them: what sparse matching and
one corrected range cost. Times are of the thread's own processor time, so that other work on the machine counts little.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from companion.core.stereo.dense import DenseMatcher
from companion.core.stereo.geometry import Rig
from companion.core.stereo.matching import Matches, match
from companion.core.stereo.ranging import correct
from companion.core.stereo.rectification import rectification, rectify_pair, rest_rectification
from companion.core.stereo.search import expected_search, trim_search
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Bytes, ClockName, Deflection, MatchSet, Side

SIZES = ((640, 480, 800.0), (1280, 800, 1330.0))
DISPARITIES = 64
MOST_OVER_RIGID = 0.10
_LENS = (-0.08, 0.02, 0.0005, -0.0005, 0.0)


def run(rounds: int = 25) -> list[dict[str, Any]]:
    """Measure every size; one row each, times in milliseconds (medians)."""
    return [_measure(width, height, focal, rounds) for width, height, focal in SIZES]


def _measure(width: int, height: int, focal_px: float, rounds: int) -> dict[str, Any]:
    airframe = _airframe(width, height, focal_px)
    rig, settings = Rig.from_airframe(airframe), Settings()
    left, right = _images(width, height, disparity_px=26)
    matcher = DenseMatcher(0, DISPARITIES)
    sgbm = matcher.semi_global
    maps = _fixed_maps(rig)
    slope = iter(np.tile(np.linspace(-0.001, 0.001, 7), rounds))

    def rigid() -> None:
        sgbm.compute(
            *(cv2.remap(image, *pair, cv2.INTER_LINEAR) for image, pair in zip((left, right), maps, strict=True))
        )

    def moving() -> None:
        bend_rad = float(next(slope))
        frame = rectification(rig, rig.pose(Side.LEFT, bend_rad, 0.0), rig.pose(Side.RIGHT, bend_rad, 0.0))
        sgbm.compute(*rectify_pair(frame, rig, left, right))

    narrow = expected_search(rig, settings, (0.0, 0.0), (0.0, 0.0), 0.003)
    wide = trim_search(rig, airframe, settings)
    still = Deflection(0, np.zeros(2), np.zeros(2), np.zeros(2), np.zeros((6, 6)), np.zeros(3), 0, 0.0)
    matches = _match_set(match(left, right, rig, narrow))
    tasks: dict[str, Callable[[], object]] = {
        "rigid_ms": rigid,
        "moving_ms": moving,
        "sparse_ms": lambda: match(left, right, rig, narrow),
        "sparse_wide_ms": lambda: match(left, right, rig, wide),
        "range_ms": lambda: correct(matches, still, still, rig, airframe, settings),
    }
    times = _interleaved(tasks, rounds)
    row: dict[str, Any] = {name: statistics.median(values) for name, values in times.items()}
    pairs = zip(times["moving_ms"], times["rigid_ms"], strict=True)
    row["moving_over_rigid"] = statistics.median(a - b for a, b in pairs) / row["rigid_ms"]
    return {"size": f"{width}x{height}", "matches": len(matches.sigma_px), **row}


def _interleaved(tasks: dict[str, Callable[[], object]], rounds: int) -> dict[str, list[float]]:
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for turn in range(rounds + 2):
        for name, task in tasks.items():
            start = time.thread_time()
            task()
            if turn >= 2:  # the first two fill caches
                times[name].append(1e3 * (time.thread_time() - start))
    return times


def _airframe(width: int, height: int, focal_px: float) -> Airframe:
    changes: dict[str, Any] = {
        "width_px": width,
        "height_px": height,
        "focal_px": Uncertain(focal_px, 0.4),
        "principal_px": (0.5 * (width - 1), 0.5 * (height - 1)),
        "distortion": _LENS,
    }
    return load_airframe("nadir-2m").with_cameras(lambda _, camera: dataclasses.replace(camera, **changes))


def _images(width: int, height: int, disparity_px: int) -> tuple[Bytes, Bytes]:
    """Texture of several octaves, and the same moved along the rows, with noise of their own."""
    random = np.random.default_rng(1)
    wide = sum(
        np.std(noise) ** -1 * noise
        for noise in (
            cv2.GaussianBlur(random.normal(size=(height, width + disparity_px)), (0, 0), sigma)
            for sigma in (1.0, 2.5, 6.0, 15.0)
        )
    )
    grey = 128.0 + 25.0 * np.asarray(wide)
    pair = (grey[:, :width], grey[:, disparity_px:])
    noisy = (np.clip(image + random.normal(scale=1.5, size=image.shape), 0, 255).astype(np.uint8) for image in pair)
    left, right = noisy
    return left, right


def _fixed_maps(rig: Rig) -> list[tuple[Any, Any]]:
    frame = rest_rectification(rig)
    return [
        cv2.initUndistortRectifyMap(
            camera.lens.matrix,
            camera.lens.distortion,
            frame.rectified_from_camera(camera.rest),
            frame.matrix,
            frame.size_px,
            cv2.CV_16SC2,
        )
        for camera in (rig.left, rig.right)
    ]


def _match_set(matches: Matches) -> MatchSet:
    clocks = (ClockName.HOST, ClockName.HOST)
    instants = np.zeros(2, dtype=np.int64)
    return MatchSet(0, 0, clocks, instants, 0, 0, matches.left_px, matches.right_px, matches.sigma_px, 0)


def main(arguments: list[str] | None = None) -> int:
    """Print the table; 1 when the target is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=25)
    parser.add_argument("--json", action="store_true")
    options, _ = parser.parse_known_args(arguments)
    cv2.setNumThreads(1)
    rows = run(options.rounds)
    if options.json:
        print(json.dumps(rows, indent=1))
    else:
        print("size       rigid ms  moving ms  over rigid  sparse ms  (wide search)  matches  range ms")
        for row in rows:
            print(
                f"{row['size']:10} {row['rigid_ms']:8.1f} {row['moving_ms']:10.1f} {row['moving_over_rigid']:10.1%}"
                f" {row['sparse_ms']:10.1f} {row['sparse_wide_ms']:14.1f} {row['matches']:8d} {row['range_ms']:9.2f}"
            )
        print(f"target: moving extrinsics cost at most {MOST_OVER_RIGID:.0%} over rigid (SGBM_3WAY, {DISPARITIES})")
    return int(any(row["moving_over_rigid"] > MOST_OVER_RIGID for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

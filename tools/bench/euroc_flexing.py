"""EuRoC's image pairs, with both cameras turned a little further in every one, as a wing would do it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from companion.adapters.cameras.folder import FolderPair
from companion.core.stereo.geometry import Lens, Pose, Rig
from companion.core.stereo.matching import Matches, match
from companion.core.stereo.rotation import exp_rotation
from companion.core.stereo.search import Search
from companion.core.stereo.triangulation import Rays
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from tools.bench.euroc_calibration import euroc_cameras

FAST_SIGMA_RAD = 0.0003


@dataclass(frozen=True)
class FlexedPair:
    """Matches of one pair whose cameras are turned against each other by ``slow_rad + fast_rad`` (right camera's axes).

    Each has half of it, and the baseline stays where it was.
    """

    t_ns: int
    matches: Matches
    slow_rad: np.ndarray
    fast_rad: np.ndarray
    fast_known_rad: np.ndarray

    @property
    def total_rad(self) -> np.ndarray:
        """True rotation of the right camera against the left, (3,) rad in its axes."""
        return self.slow_rad + self.fast_rad


def euroc_airframe(folder: Path) -> Airframe:
    left, right = euroc_cameras(folder)
    return dataclasses.replace(load_airframe("forward-2m"), left_camera=left, right_camera=right, orientation=0)


def turn_image(image: np.ndarray, lens: Lens, turn_rad: np.ndarray) -> np.ndarray:
    """A camera's image if it were turned by a rotation vector in its own axes: exact but for resampling."""
    columns, rows = np.meshgrid(np.arange(lens.size_px[0], dtype=float), np.arange(lens.size_px[1], dtype=float))
    rays = lens.unproject(np.column_stack([columns.ravel(), rows.ravel()]))
    source = lens.project(rays @ exp_rotation(turn_rad).T).reshape(*columns.shape, 2).astype(np.float32)
    return cv2.remap(image, source[..., 0], source[..., 1], cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT)


def rotations(times_s: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Slow (n, 3) and fast (n, 3) part of the rotation; together they reach, and never pass, 5 mrad in each axis."""
    random = np.random.default_rng(seed)
    phase = random.uniform(0, 2 * np.pi, (2, 3))
    slow = 0.0035 * random.choice([-1.0, 1.0], 3) * (0.8 + 0.2 * np.sin(2 * np.pi * 0.11 * times_s[:, None] + phase[0]))
    fast = 0.0015 * np.sin(2 * np.pi * np.array([4.7, 5.3, 6.1]) * times_s[:, None] + phase[1])
    return slow, fast


def _halves(rig: Rig, turn_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn of the left and of the right camera, each in its own axes, that make up a relative turn (right's axes)."""
    left_from_right = rig.left.rest.camera_from_body @ rig.right.rest.camera_from_body.T
    return -0.5 * left_from_right @ turn_rad, 0.5 * turn_rad


def flexed_pairs(folder: Path, rig: Rig, seed: int = 0, which: slice = slice(None)) -> list[FlexedPair]:
    frames = list(FolderPair(folder).frames())
    pairs = list(zip(frames[0::2], frames[1::2], strict=True))[which]
    times_s = 1e-9 * np.array([left.mid_exposure_ns - pairs[0][0].mid_exposure_ns for left, _ in pairs])
    slow, fast = rotations(times_s, seed)
    random = np.random.default_rng(seed + 1)
    search = Search(rig.left.rest, rig.right.rest, 0.8, 200.0, 0.0, 0.009)
    flexed = []
    for (left, right), s, f in zip(pairs, slow, fast, strict=True):
        turns = _halves(rig, s + f)
        images = turn_image(left.image, rig.left.lens, turns[0]), turn_image(right.image, rig.right.lens, turns[1])
        matches = match(*images, rig, search, most=600, quality=0.0003)
        flexed.append(FlexedPair(left.mid_exposure_ns, matches, s, f, f + FAST_SIGMA_RAD * random.standard_normal(3)))
    return flexed


def rays_of(rig: Rig, matches: Matches, turn_rad: np.ndarray, chosen: np.ndarray) -> Rays:
    """Rays in body axes of some matches, with the cameras believed to be turned by ``turn_rad`` (right's axes)."""
    left, right = (
        Pose(exp_rotation(-turn) @ camera.rest.camera_from_body, camera.rest.position_body_m)
        for camera, turn in zip((rig.left, rig.right), _halves(rig, turn_rad), strict=True)
    )
    n = int(np.sum(chosen))
    return Rays(
        np.tile(left.position_body_m, (n, 1)),
        rig.left.rays(left, matches.left_px[chosen]),
        np.tile(right.position_body_m, (n, 1)),
        rig.right.rays(right, matches.right_px[chosen]),
    )

"""The process behind simulated cameras on a bench: frames of a held board to the camera port, at a steady rate."""

from __future__ import annotations

import contextlib
import dataclasses
import multiprocessing
import os
import socket
import time
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path

import cv2
import numpy as np

from companion.core.stereo.geometry import Rig
from companion.core.stereo.rotation import exp_rotation, log_rotation
from companion.errors import DeviceError
from companion.lifetime import die_with_parent
from companion.params.airframe import Airframe, Camera, Uncertain
from companion.records import Side
from companion.sim.vehicle.starting import opened
from companion.sim.vision.boards import BoardRenderer, ShownBoard, board_poses
from companion.sim.vision.cameras import HEADER, MAGIC

_PERIOD_NS = 200_000_000  # chosen: five pairs a second, which the finder of corners keeps up with
_EXPOSURE_NS = 2_000_000  # chosen: indoors, short enough for a board held still
_START_S = 120.0  # a busy machine imports slowly (choice)
# what a pair of cameras is like before anybody has calibrated it (choice)
_FOCAL, _MIDDLE_PX, _TURN_RAD, _SHIFT_M = 0.01, 4.0, 0.01, 0.003
_BENT = (-0.12, 0.05, 0.0004, -0.0003, 0.0)  # chosen: a small wide-angle lens: k1, k2, p1, p2, k3


@dataclass(frozen=True, slots=True)
class BoardServerConfig:
    """Board, cameras and address of the frame server; picklable. ``airframe`` is the true one."""

    airframe: Airframe
    board: ShownBoard
    seed: int
    frames_path: Path


def uncalibrated(airframe: Airframe, seed: int) -> Airframe:
    """The airframe with its cameras as they came: bent lenses, other focal lengths, turned and shifted mounts."""
    rng = np.random.default_rng([seed, 0xB0A4])
    if airframe.left_camera is None or airframe.right_camera is None:
        raise DeviceError(f"airframe '{airframe.name}' has no camera pair to simulate")

    def true(_: Side, camera: Camera) -> Camera:
        column, row = (np.array(camera.principal_px) + _MIDDLE_PX * rng.standard_normal(2)).tolist()
        turned = exp_rotation(np.array(camera.rotation_rad)) @ exp_rotation(_TURN_RAD * rng.standard_normal(3))
        a, b, c = log_rotation(turned).tolist()
        x, y, z = (np.array(camera.position_m) + _SHIFT_M * rng.standard_normal(3)).tolist()
        return dataclasses.replace(
            camera,
            focal_px=Uncertain(camera.focal_px.value * (1.0 + _FOCAL * rng.standard_normal()), camera.focal_px.sigma),
            principal_px=(column, row),
            distortion=tuple((rng.uniform(0.7, 1.3) * np.array(_BENT)).tolist()),
            rotation_rad=(a, b, c),
            position_m=(x, y, z),
        )

    return airframe.with_cameras(true)


def serve(config: BoardServerConfig) -> None:
    """Show the board to whoever has connected first, until they leave or the parent dies."""
    die_with_parent()
    cv2.setNumThreads(1)
    parent = os.getppid()
    rig = Rig.from_airframe(config.airframe)
    renderer = BoardRenderer(rig, config.board, config.seed)
    door = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    door.bind(str(config.frames_path))
    door.listen(1)
    client, _ = door.accept()
    start_ns = time.monotonic_ns()
    with contextlib.suppress(OSError), client:  # they have seen enough
        for shot, held in enumerate(board_poses(config.board, rig, config.seed)):
            exposed_ns = start_ns + shot * _PERIOD_NS
            time.sleep(max(exposed_ns - time.monotonic_ns(), 0) * 1e-9)
            if os.getppid() != parent:
                return
            for side in Side:
                image = renderer.render(side, held, shot)
                client.sendall(HEADER.pack(MAGIC, side, shot, exposed_ns, _EXPOSURE_NS, 0, *image.shape))
                client.sendall(image.tobytes())


def start_board_server(config: BoardServerConfig) -> BaseProcess:
    """Start the process and return when its door is open; end it with ``terminate()``.

    Raises
    ------
    DeviceError
        When it ends, or has not opened it in time.
    """
    process = multiprocessing.get_context("spawn").Process(target=serve, args=(config,), name="sim-board", daemon=True)
    return opened(process, config.frames_path, _START_S)

"""Rehearsal of a calibration: a board moved before simulated cameras, whose truth then judges the result."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from companion.calibration.boards import Board
from companion.calibration.stereo_rig import RigFit
from companion.core.stereo.geometry import Rig
from companion.core.stereo.rotation import log_rotation
from companion.params.airframe import Airframe
from companion.records import Floats, Frame
from companion.sim.vision.board_server import BoardServerConfig, start_board_server, uncalibrated
from companion.sim.vision.boards import ShownBoard
from companion.sim.vision.cameras import SimCameraPair


class Rehearsal:
    """Implements :class:`companion.ports.CameraPair`: the simulated pair of a bench, server process and all.

    ``airframe`` is the truth: the base airframe with cameras as they came.
    """

    def __init__(self, base: Airframe, board: Board, seed: int) -> None:
        self.airframe = uncalibrated(base, seed)
        self._scratch = tempfile.TemporaryDirectory(prefix="spanwise-")
        path = Path(self._scratch.name) / "frames"
        held = ShownBoard(board.kind, board.squares, board.square_m)
        self._server = start_board_server(BoardServerConfig(self.airframe, held, seed, path))
        self._pair = SimCameraPair(path)

    def poll(self, timeout_s: float) -> list[Frame]:
        """Frames that have arrived within the timeout."""
        return self._pair.poll(timeout_s)

    def close(self) -> None:
        """Put the board away."""
        self._pair.close()
        self._server.terminate()
        self._server.join()
        self._scratch.cleanup()


def errors_in_sigmas(fit: RigFit, truth: Airframe) -> Floats:
    """(24,) what was found less what is true over the stated sigma, in the order of the fit's shared parameters."""
    rig = Rig.from_airframe(truth)
    lenses = [
        np.concatenate([camera.lens.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], camera.lens.distortion])
        for camera in (rig.left, rig.right)
    ]
    left, right = rig.left.rest, rig.right.rest
    turn_rad = log_rotation(right.camera_from_body @ left.camera_from_body.T)
    shift_m = right.camera_from_body @ (left.position_body_m - right.position_body_m)
    off: Floats = fit.bundle.shared - np.concatenate([*lenses, turn_rad, shift_m])
    return off / np.sqrt(np.diag(fit.bundle.covariance))

"""The board that a rehearsed calibration holds up: where its corners are, who sees it, and what comes of it."""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

import numpy as np
import pytest

from companion.calibration.boards import Board, find_corners
from companion.cli import calibrate
from companion.core.stereo.geometry import Rig
from companion.core.stereo.rotation import exp_rotation
from companion.errors import DeviceError
from companion.params.files import load_airframe
from companion.records import Side
from companion.sim.vision.board_server import uncalibrated
from companion.sim.vision.boards import BoardPose, BoardRenderer, ShownBoard, board_poses

SIZES = {"chessboard": ((10, 7), 0.2), "charuco": ((7, 5), 0.3)}


def _true_pixels(rig: Rig, side: Side, board: Board, held: BoardPose) -> np.ndarray:
    """Corners by the rig's own projection: board to left camera to body to either camera."""
    in_left = board.points_m() @ exp_rotation(held.turn_rad).T + held.place_m
    body = in_left @ rig.left.rest.camera_from_body + rig.left.rest.position_body_m
    camera = rig.left if side is Side.LEFT else rig.right
    return camera.project(camera.rest, body)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["chessboard", "charuco"])
def test_corners_are_where_the_true_rig_projects_them(kind: str) -> None:
    """Bent lenses, turned mounts, both cameras: no bias beyond a hundredth of a pixel, scatter of a few."""
    rig = Rig.from_airframe(uncalibrated(load_airframe("forward-2m"), 3))
    squares, square_m = SIZES[kind]
    renderer, board = BoardRenderer(rig, ShownBoard(kind, squares, square_m), 3), Board(kind, squares, square_m)
    off = []
    for shot, held in enumerate(itertools.islice(board_poses(ShownBoard(kind, squares, square_m), rig, 3), 1, 24, 4)):
        for side in Side:
            corners = find_corners(renderer.render(side, held, shot), board)
            if corners is not None:
                # the detector counts this chessboard from its other end, in every view
                ids = corners.ids[::-1] if kind == "chessboard" else corners.ids
                off.append(corners.pixels - _true_pixels(rig, side, board, held)[ids])
    assert len(off) >= 8
    every = np.concatenate(off)
    assert np.abs(every.mean(axis=0)).max() < 0.01
    assert np.abs(np.median(every, axis=0)).max() < 0.01
    assert np.sqrt(np.mean(every**2)) < 0.08


def test_the_holder_keeps_still_and_moves_on_and_keeps_a_chessboard_in_both_images() -> None:
    rig = Rig.from_airframe(load_airframe("forward-2m"))
    squares, square_m = SIZES["chessboard"]
    board, path = Board("chessboard", squares, square_m), []
    for held in itertools.islice(board_poses(ShownBoard("chessboard", squares, square_m), rig, 1), 80):
        path.append(held)
    corners_px = np.array([[_true_pixels(rig, side, board, held) for side in Side] for held in path])
    moved = np.abs(np.diff(corners_px, axis=0)).max(axis=(1, 2, 3))
    assert np.all((moved == 0.0) == (np.arange(79) % 4 % 3 != 0))  # three alike, one on the way
    still = corners_px[1::4]
    inside = np.all((still > 0) & (still < np.array([639, 479])), axis=(1, 2, 3))
    assert inside.mean() > 0.9
    assert np.ptp([held.place_m[2] for held in path]) > 1.0


def test_an_airframe_without_cameras_has_nothing_to_hold_a_board_to() -> None:
    with pytest.raises(DeviceError, match="sitl-plane"):
        uncalibrated(load_airframe("sitl-plane"), 1)


@pytest.mark.long
@pytest.mark.realtime
def test_a_rehearsal_over_the_camera_port_finds_the_true_rig(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command as a user types it: server process, socket, guidance, bundle, report; truth known afterwards."""
    parser = argparse.ArgumentParser()
    calibrate.add_arguments(parser)
    words = ["stereo", "--cameras", "sim", "--board", "chessboard", "--square-m", "0.2", "--airframe", "forward-2m"]
    assert calibrate.execute(parser.parse_args([*words, "--views", "10", "--for", "240", "--out", str(tmp_path)])) == 0
    said = capsys.readouterr().out
    for text in ("hold still", "took view10", "next: ", "against the simulated truth: error over sigma"):
        assert text in said
    assert float(said.rsplit("error over sigma ", 1)[1].split(" rms")[0]) < 2.0
    true = Rig.from_airframe(uncalibrated(load_airframe("forward-2m"), 1))
    calibrated = Rig.from_airframe(load_airframe(str(tmp_path / "airframe.toml")))
    for camera, other in ((true.left, calibrated.left), (true.right, calibrated.right)):
        assert other.lens.focal_px == pytest.approx(camera.lens.focal_px, abs=2.0)
    for name in ("report.html", "report.png", "live.jpg"):
        assert (tmp_path / name).stat().st_size > 10_000

"""Taking calibration views from running cameras: what is taken, what is told, and what the command makes of it."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from companion.calibration.boards import Board, Corners
from companion.calibration.guidance import advice, is_new, perspective
from companion.calibration.live import LiveViews
from companion.calibration.stereo_rig import BoardView
from companion.cli import calibrate
from companion.cli.steps.calibrate_live import take_views
from companion.core.stereo.geometry import Rig
from companion.core.stereo.rotation import exp_rotation
from companion.errors import ConfigError
from companion.params.files import dump_airframe, load_airframe
from companion.records import ClockName, Frame, Side
from sitl_tests.unit.test_calibration_stereo import CHARUCO, SIZE, _pairs, short_base

FOCAL_PX = 600.0


def _corners(
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0), place: tuple[float, float, float] = (0.0, 0.0, 0.9)
) -> Corners:
    """A board seen by an ideal camera, its middle at ``place``."""
    points = CHARUCO.points_m()
    camera_points = (points - points.mean(axis=0)) @ exp_rotation(np.array(turn)).T + np.array(place)
    pixels = FOCAL_PX * camera_points[:, :2] / camera_points[:, 2:] + np.array(SIZE) / 2.0
    return Corners(np.arange(len(points)), pixels)


def _view(**how: tuple[float, float, float]) -> BoardView:
    return BoardView("v", _corners(**how), _corners(**how))


def _frames(k: int, t_s: float, apart_s: float = 0.0) -> list[Frame]:
    _, left, right = _pairs("charuco")[k]
    return [
        Frame(side, k, ClockName.HOST, round(1e9 * (t_s + apart_s * side)), 2_000_000, 0, -1, image)
        for side, image in zip(Side, (left, right), strict=True)
    ]


def test_a_tilt_is_read_from_one_picture_with_its_sign() -> None:
    """A board turned about the vertical axis by b has its depth grow by sin b across: over a width w, w sin b / z."""
    width = 0.04 * (CHARUCO.inner[0] - 1)
    for angle in (-0.4, 0.25):
        falls = perspective(_corners(turn=(0.0, angle, 0.0)), CHARUCO)
        assert falls[0] == pytest.approx(-np.sin(angle) * width / 0.9, rel=1e-3)
        assert abs(falls[1]) < 1e-6
    assert np.allclose(perspective(_corners(), CHARUCO), 0.0, atol=1e-6)


def test_guidance_asks_for_what_is_missing_and_falls_silent() -> None:
    frontal = [_view()]
    said = " | ".join(advice(frontal, CHARUCO, SIZE, wanted=3))
    for words in ("left image", "right image", "left edge toward", "top toward", "distance", "2 more views"):
        assert words in said
    sides = [(x, y, 0.8) for x in (-0.25, 0.25) for y in (-0.2, 0.2)]
    tilts = [(a, 0.0, 0.0) for a in (-0.4, 0.4)] + [(0.0, a, 0.0) for a in (-0.4, 0.4)]
    views = [_view(turn=tilt, place=place) for tilt in tilts for place in sides] + [_view(place=(0.0, 0.0, 1.4))]
    assert advice(views, CHARUCO, SIZE, wanted=10) == []
    assert advice(views, CHARUCO, SIZE, wanted=30) == [f"{30 - len(views)} more views"]


def test_the_same_view_is_not_taken_twice() -> None:
    assert not is_new(_view(place=(0.0, 0.0, 0.9)), [_view(place=(0.005, 0.0, 0.9))], SIZE)
    assert is_new(_view(place=(0.0, 0.0, 0.9)), [_view(place=(0.15, 0.0, 0.9))], SIZE)


@pytest.mark.slow
def test_a_view_is_taken_when_the_board_holds_still() -> None:
    live = LiveViews(CHARUCO, 3, FOCAL_PX)
    assert live.add(_frames(0, 1.0)) == "hold still"
    assert live.add(_frames(1, 1.1)) == "hold still"  # it moved
    assert live.add(_frames(1, 1.2)) == "took view01"
    assert "there already" in str(live.add(_frames(1, 1.3)))
    assert live.add(_frames(2, 5.0)) == "hold still"  # the last look was long ago
    assert live.views[0].name == "view01"


@pytest.mark.slow
def test_frames_that_do_not_belong_together_are_not_paired() -> None:
    live = LiveViews(CHARUCO, 3, FOCAL_PX)
    assert live.add(_frames(0, 1.0)[:1]) is None
    assert live.add(_frames(0, 1.0, apart_s=0.2)) is None
    empty = np.full((SIZE[1], SIZE[0]), 90, np.uint8)
    frames = [Frame(side, 0, ClockName.HOST, 10**9, 0, 0, -1, empty) for side in Side]
    assert live.add(frames) == "no board in the left and right image"


@pytest.mark.parametrize(
    ("board", "hint"),
    [
        (Board("charuco", (7, 5), 0.3), "charuco of 7 x 5 squares of 0.3 m, which need 33 px: at most 5.4 m away"),
        (Board("chessboard", (10, 7), 0.2), "chessboard of 10 x 7 squares of 0.2 m, whole in both images"),
    ],
)
def test_a_board_that_is_not_seen_for_long_is_described(board: Board, hint: str) -> None:
    live = LiveViews(board, 3, FOCAL_PX)
    empty = np.full((SIZE[1], SIZE[0]), 90, np.uint8)
    said = [
        str(live.add([Frame(side, n, ClockName.HOST, n * 10**9, 0, 0, -1, empty) for side in Side])) for n in (1, 5, 6)
    ]
    assert said[0] == said[1] == "no board in the left and right image"
    assert hint in said[2]


class _Rig:
    """A camera pair that shows each board in two exposures; after the last one the user presses Ctrl-C."""

    def __init__(self, boards: int) -> None:
        self.script = [_frames(k, k + 0.3 * again) for k in range(boards) for again in range(2)]
        self.closed = False

    def poll(self, timeout_s: float) -> list[Frame]:
        assert timeout_s > 0.0
        if not self.script:
            raise KeyboardInterrupt
        return self.script.pop(0)

    def close(self) -> None:
        self.closed = True


@pytest.mark.slow
def test_views_are_taken_from_cameras_that_run_until_the_user_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = _Rig(7)
    monkeypatch.setattr(calibrate.cameras, "camera_factory", lambda *_, **__: lambda: rig)
    parser = argparse.ArgumentParser()
    calibrate.add_arguments(parser)
    base = tmp_path / "base.toml"
    base.write_text(dump_airframe(short_base()), encoding="utf-8")
    words = ["stereo", "--cameras", "v4l2:0,1", "--square-m", "0.04", "--airframe", str(base)]
    words += ["--out", str(tmp_path), "--views", "8"]
    assert calibrate.execute(parser.parse_args(words)) == 0
    said = capsys.readouterr().out
    assert rig.closed
    for text in ("hold still", "took view07", "next:", "stopped: calibrating with what there is"):
        assert text in said
    assert len(list((tmp_path / "views" / "cam1").glob("*.png"))) == 7
    assert (tmp_path / "live.jpg").stat().st_size > 10_000
    Rig.from_airframe(load_airframe(str(tmp_path / "airframe.toml")))
    words[words.index(str(base))] = str(tmp_path / "airframe.toml")
    with pytest.raises(ConfigError, match="holds views already"):
        calibrate.execute(parser.parse_args(words))


@pytest.mark.slow
def test_without_a_board_there_is_nothing_to_calibrate(tmp_path: Path) -> None:
    rig = _Rig(0)
    with pytest.raises(ConfigError, match="no view of the board"):
        take_views(rig, CHARUCO, 8, tmp_path, 5.0, FOCAL_PX, lambda _: None)
    assert rig.closed


def test_a_folder_or_cameras_but_not_both() -> None:
    parser = argparse.ArgumentParser()
    calibrate.add_arguments(parser)
    words = ["stereo", "--square-m", "0.04", "--airframe", "forward-2m"]
    with pytest.raises(ConfigError, match="folder of images, or --cameras"):
        calibrate.execute(parser.parse_args(words))

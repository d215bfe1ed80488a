"""Mounting of cameras on their sections by gravity: solved exactly, honestly, and end to end from a recording."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest

from companion.calibration.attitudes import find_attitudes
from companion.calibration.mounting import Attitude, Mounting, airframe_with_mounting, disagreement_rad, mount
from companion.cli import calibrate
from companion.core.stereo.geometry import Rig
from companion.core.stereo.rotation import exp_rotation, log_rotation
from companion.errors import ConfigError, RecordingError
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, Frame, FramePair, ImuBatch, Record, Side, Station
from sitl_tests.unit.test_calibration_stereo import CHARUCO, LEFT, RIGHT, SHIFT, TURN, _pairs

G = 9.80665
TILT_RAD = 0.35


def _attitudes(mounted: np.ndarray, seed: int, *, felt_rad: float, seen_rad: float, n: int = 8) -> list[Attitude]:
    """The board is the world; the aircraft is turned about all axes."""
    random = np.random.default_rng(seed)
    up, usual = np.array([0.3, -0.9, 0.2]), exp_rotation(random.normal(0.0, 1.0, 3))
    up /= np.linalg.norm(up)
    attitudes = []
    for k in range(n):
        section_from_board = exp_rotation(random.uniform(-TILT_RAD, TILT_RAD, 3)) @ usual
        felt = section_from_board @ up + random.normal(0.0, felt_rad, 3)
        camera_from_board = exp_rotation(random.normal(0.0, seen_rad, 3)) @ mounted @ section_from_board
        attitudes.append(Attitude(str(k), felt / np.linalg.norm(felt), camera_from_board))
    return attitudes


def test_without_noise_the_mounting_is_exact() -> None:
    true = exp_rotation(np.array([0.4, -1.2, 0.8]))
    mounting = mount(_attitudes(true, 1, felt_rad=0.0, seen_rad=0.0))
    assert np.allclose(mounting.camera_from_section, true, atol=1e-9)
    assert np.all(mounting.errors_rad < 1e-9)


def test_errors_scatter_as_the_sigma_says() -> None:
    """Eight attitudes leave eleven degrees of freedom: Student's t has rms sqrt(11 / 9) = 1.1."""
    true, unit = exp_rotation(np.array([0.1, 0.05, -0.2])), []
    for seed in range(60):
        mounting = mount(_attitudes(true, seed, felt_rad=1e-3, seen_rad=3e-4))
        unit.append(log_rotation(mounting.camera_from_section @ true.T) / mounting.sigma_rad)
    assert 0.9 < np.sqrt(np.mean(np.square(unit))) < 1.35


def test_attitudes_that_do_not_differ_are_refused() -> None:
    same = _attitudes(np.eye(3), 2, felt_rad=0.0, seen_rad=0.0, n=1) * 6
    with pytest.raises(ConfigError, match="bank the aircraft both ways"):
        mount(same)
    with pytest.raises(ConfigError, match="3 attitudes are too few"):
        mount(same[:3])


def test_an_attitude_whose_board_is_taken_upside_down_is_named() -> None:
    for k in range(8):
        attitudes = _attitudes(np.eye(3), 3, felt_rad=1e-3, seen_rad=3e-4)
        turned = attitudes[k].camera_from_board @ np.diag([-1.0, -1.0, 1.0])
        attitudes[k] = dataclasses.replace(attitudes[k], camera_from_board=turned)
        with pytest.raises(ConfigError, match=f"pitch it too; the attitude that fits worst: {k}"):
            mount(attitudes)


def _base() -> Airframe:
    """The rendered pair's true lenses and relative pose, mounted as the file says."""
    base = load_airframe("forward-2m")
    made = []
    for side, lens, camera in ((0, LEFT, base.left_camera), (1, RIGHT, base.right_camera)):
        assert camera is not None
        focal, tall, column, row = (float(lens.matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
        made.append(
            dataclasses.replace(
                camera,
                focal_px=dataclasses.replace(camera.focal_px, value=focal),
                focal_ratio=tall / focal,
                principal_px=(column, row),
                distortion=tuple(float(value) for value in lens.distortion),
                rotation_rad=tuple(float(-value) for value in TURN) if side else (0.0, 0.0, 0.0),
            )
        )
    return dataclasses.replace(base, left_camera=made[0], right_camera=made[1])


class _Recording:
    """Held still at each rendered board for a second; what each section felt follows from the true mounting."""

    hub = ClockName.HOST

    def __init__(self, left_from_section: np.ndarray) -> None:
        self._mounted = {Side.LEFT: left_from_section, Side.RIGHT: exp_rotation(TURN) @ left_from_section}

    def records(self) -> Iterable[Record]:
        random, turns = np.random.default_rng(8), np.random.default_rng(4)
        up = np.array([0.2, -0.3, 0.9]) / np.linalg.norm([0.2, -0.3, 0.9])
        for k in range(8):
            left_from_board = exp_rotation(turns.uniform(-0.45, 0.45, 3) * np.array([1, 1, 0.4]))
            turns.uniform(size=3)  # the rendering's depth and place
            start = 10**9 + k * 2 * 10**9
            for side, station in ((Side.LEFT, Station.LEFT), (Side.RIGHT, Station.RIGHT)):
                camera_from_board = (exp_rotation(TURN) if side is Side.RIGHT else np.eye(3)) @ left_from_board
                force = G * (self._mounted[side].T @ camera_from_board @ up)
                values = np.column_stack([force + 0.02 * random.standard_normal((100, 3)), np.zeros((100, 3))])
                stamps = start + np.arange(100) * 10_000_000
                yield ImuBatch(station, ClockName.HOST, stamps, values, Axis.ALL, start)
            yield FramePair(k, *(self._frame(side, k) for side in Side))

    def _frame(self, side: Side, k: int) -> Frame:
        image = _pairs("charuco", 8)[k][1 + side]
        return Frame(side, k, ClockName.HOST, 1_500_000_000 + k * 2 * 10**9, 2_000_000, 0, -1, image)


WAY = np.array([0.02, -0.03, 0.01])


@pytest.mark.slow
def test_a_recording_gives_the_mounting_that_was_flown() -> None:
    """The tilts are read off the rendered boards; a turn of (20, -30, 10) mrad of both cameras comes back."""
    base = _base()
    rig = Rig.from_airframe(base)
    together = exp_rotation(WAY)
    recording = _Recording(together @ rig.left.rest.camera_from_body)
    mountings = []
    for side in Side:
        attitudes, refused = find_attitudes(recording, base, CHARUCO, side)
        assert len(attitudes) >= 6  # two may chance to be alike
        assert refused == {}
        mountings.append(mount(attitudes))
        assert np.all(mountings[-1].sigma_rad < 0.1 * np.linalg.norm(WAY))  # it tells the turn to a tenth
    made = Rig.from_airframe(airframe_with_mounting(base, *mountings))
    off = log_rotation(made.left.rest.camera_from_body @ (together @ rig.left.rest.camera_from_body).T)
    assert np.all(np.abs(off) < 4 * mountings[0].sigma_rad)
    right_from_left = made.right.rest.camera_from_body @ made.left.rest.camera_from_body.T
    assert np.allclose(right_from_left, exp_rotation(TURN), atol=1e-9)
    assert disagreement_rad(base, *mountings) < 4e-3


def test_the_pair_is_turned_by_the_mean_of_both_and_keeps_its_relative_pose() -> None:
    base = _base()
    rig = Rig.from_airframe(base)
    ways = (np.array([0.004, 0.0, 0.0]), np.array([0.0, 0.006, 0.0]))
    rests = (rig.left.rest.camera_from_body, rig.right.rest.camera_from_body)
    left, right = (
        Mounting(exp_rotation(way) @ rest, np.full(3, 1e-3), np.zeros(4)) for way, rest in zip(ways, rests, strict=True)
    )
    written = airframe_with_mounting(base, left, right)
    made = Rig.from_airframe(written)
    bias_rad = base.left.accel_bias_sigma_mps2 / 9.80665
    assert written.pair_sigma_rad == pytest.approx(math.sqrt(0.5) * math.hypot(1e-3, bias_rad), rel=1e-3)
    before = rests[1] @ rests[0].T
    assert np.allclose(made.right.rest.camera_from_body @ made.left.rest.camera_from_body.T, before, atol=1e-12)
    seen_m = [
        pair.left.rest.camera_from_body @ (pair.right.rest.position_body_m - pair.left.rest.position_body_m)
        for pair in (rig, made)
    ]
    assert np.allclose(seen_m[1], seen_m[0], atol=1e-12), "the baseline stays as the left camera sees it"
    assert np.allclose(made.left.rest.position_body_m, rig.left.rest.position_body_m)
    turned = log_rotation(made.left.rest.camera_from_body @ rests[0].T)
    assert np.allclose(turned, 0.5 * (ways[0] + before.T @ ways[1]), atol=1e-4)
    assert disagreement_rad(base, left, right) == pytest.approx(np.linalg.norm(ways[1] - before @ ways[0]), abs=1e-4)
    assert SHIFT[0] < 0.0  # the right camera of the rendered pair is on the right


def test_an_aircraft_that_moves_gives_no_attitude() -> None:
    base = _base()

    class Moving(_Recording):
        def records(self) -> Iterable[Record]:
            for record in super().records():
                if isinstance(record, ImuBatch):
                    shaken = record.values + np.sin(np.arange(100))[:, None] * [2.0, 0, 0, 0, 0, 0]
                    record = dataclasses.replace(record, values=shaken)
                yield record

        def _frame(self, side: Side, k: int) -> Frame:
            return Frame(
                side, k, ClockName.HOST, 1_500_000_000 + k * 2 * 10**9, 0, 0, -1, np.zeros((480, 640), np.uint8)
            )

    assert find_attitudes(Moving(np.eye(3)), base, CHARUCO, Side.LEFT) == ([], {})


class _Held(_Recording):
    """One attitude, held for two seconds before ten pictures; the sensor sends some axes."""

    def __init__(self, axes: Axis, images: list[np.ndarray]) -> None:
        super().__init__(np.eye(3))
        self._axes, self._images = axes, images

    def records(self) -> Iterable[Record]:
        stamps = 10**9 + np.arange(200) * 10_000_000
        felt = np.tile([0.5, 0.7, -G, 0.0, 0.0, 0.0], (200, 1)) * self._axes.mask
        yield ImuBatch(Station.LEFT, ClockName.HOST, stamps, felt, self._axes, 10**9)
        for k, image in enumerate(self._images):
            at_ns = 1_500_000_000 + k * 100_000_000
            yield Frame(Side.LEFT, k, ClockName.HOST, at_ns, 2_000_000, 0, -1, image)


def test_an_attitude_without_a_board_is_refused_once_and_not_where_a_later_image_shows_it() -> None:
    bare, board = np.zeros((480, 640), np.uint8), _pairs("charuco", 1)[0][1]
    attitudes, refused = find_attitudes(_Held(Axis.ALL, [bare] * 10), _base(), CHARUCO, Side.LEFT)
    assert attitudes == []
    assert refused == {"0.0 s": "still, but no board in the image"}
    attitudes, refused = find_attitudes(_Held(Axis.ALL, [bare, bare, board]), _base(), CHARUCO, Side.LEFT)
    assert [attitude.name for attitude in attitudes] == ["0.2 s"]
    assert refused == {}


def test_a_node_with_a_vertical_axis_alone_cannot_tell_up() -> None:
    with pytest.raises(RecordingError, match="left section's sensor sends no acceleration along x and y"):
        find_attitudes(_Held(Axis.Z, []), _base(), CHARUCO, Side.LEFT)


def test_a_recording_without_images_says_so() -> None:
    class Blind(_Recording):
        def records(self) -> Iterable[Record]:
            return (record for record in super().records() if not isinstance(record, FramePair))

    with pytest.raises(RecordingError, match="no image of the left camera"):
        find_attitudes(Blind(np.eye(3)), _base(), CHARUCO, Side.LEFT)


def test_the_command_writes_the_mounting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    base = _base()
    rig = Rig.from_airframe(base)

    def drawn_attitudes(
        _recording: object, _base: Airframe, _board: object, side: Side
    ) -> tuple[list[Attitude], dict[str, str]]:
        mounted = (rig.left, rig.right)[side].rest.camera_from_body
        return _attitudes(mounted, 5, felt_rad=1e-3, seen_rad=3e-4), {"12.5 s": "still, but no board in the image"}

    monkeypatch.setattr(calibrate, "open_recording", lambda *_: None)
    monkeypatch.setattr(calibrate, "load_airframe", lambda _: base)
    monkeypatch.setattr(calibrate, "find_attitudes", drawn_attitudes)
    parser = argparse.ArgumentParser()
    calibrate.add_arguments(parser)
    words = ["mounting", "flight.mcap", "--square-m", "0.04", "--airframe", "any", "--out", str(tmp_path)]
    assert calibrate.execute(parser.parse_args(words)) == 0
    said = capsys.readouterr().out
    assert "left  8 attitudes" in said
    assert "right refused 12.5 s" in said
    assert "against the stereo calibration" in said
    made = load_airframe(str(tmp_path / "airframe.toml"))
    assert made.left_camera is not None
    assert np.linalg.norm(made.left_camera.rotation_rad) < 5e-3


def test_what_no_file_may_hold_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    base = _base()
    right = dataclasses.replace(base.camera_pair[1], position_m=(0.0, -1.49, 0.0))
    monkeypatch.setattr(calibrate, "_mounting", lambda *_: dataclasses.replace(base, right_camera=right))
    parser = argparse.ArgumentParser()
    calibrate.add_arguments(parser)
    words = ["mounting", "flight.mcap", "--square-m", "0.04", "--airframe", "forward-2m", "--out", str(tmp_path)]
    with pytest.raises(ConfigError, match=r"airframe\.toml, not written: .* are the cameras swapped"):
        calibrate.execute(parser.parse_args(words))
    assert not (tmp_path / "airframe.toml").exists()

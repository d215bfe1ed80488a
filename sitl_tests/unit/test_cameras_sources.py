"""Frames from folders, videos and DepthAI objects: right stamp, right side, nothing shifted, errors named."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

from companion.adapters.cameras.folder import FolderPair
from companion.adapters.cameras.video import CapturePair
from companion.core.stereo.geometry import Rig
from companion.core.stereo.pairing import FramePairer
from companion.errors import DeviceError
from companion.params.files import load_airframe
from companion.records import ClockName, Side
from tools.bench.euroc_calibration import euroc_cameras


def _write(folder: Path, camera: str, stamps: list[int]) -> None:
    data = folder / camera / "data"
    data.mkdir(parents=True)
    for t_ns in stamps:
        cv2.imwrite(str(data / f"{t_ns}.png"), np.full((6, 8), t_ns % 251, np.uint8))


def test_a_folder_gives_frames_in_order_and_a_missing_one_shifts_nothing(tmp_path: Path) -> None:
    _write(tmp_path, "cam0", [1000, 2000, 3000])
    _write(tmp_path, "cam1", [1000, 3000])
    frames = list(FolderPair(tmp_path, ClockName.BOOT, exposure_ns=10, stamp_to_middle_ns=5).frames())
    assert [(f.side, f.mid_exposure_ns) for f in frames] == [(0, 1005), (1, 1005), (0, 2005), (0, 3005), (1, 3005)]
    assert all(frame.clock is ClockName.BOOT for frame in frames)
    assert all(int(frame.image[0, 0]) == (frame.mid_exposure_ns - 5) % 251 for frame in frames)


def test_data_csv_overrules_the_names(tmp_path: Path) -> None:
    for camera in ("cam0", "cam1"):
        _write(tmp_path, camera, [7])
        (tmp_path / camera / "data.csv").write_text("#timestamp [ns],filename\n1403715273262142976,7.png\n")
    assert [f.mid_exposure_ns for f in FolderPair(tmp_path).frames()] == [1403715273262142976] * 2


def test_what_other_systems_add_to_tables_and_folders_is_passed_over(tmp_path: Path) -> None:
    """The mark that Windows puts before UTF-8, and the files that macOS lays beside its own."""
    for camera in ("cam0", "cam1"):
        _write(tmp_path, camera, [7])
        (tmp_path / camera / "data.csv").write_bytes(b"\xef\xbb\xbf1403715273262142976,7.png\n")
        (tmp_path / camera / "data" / "._7.png").write_bytes(b"x")
    assert [f.mid_exposure_ns for f in FolderPair(tmp_path).frames()] == [1403715273262142976] * 2


def test_a_folder_that_is_not_of_this_kind_is_named(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="cam0"):
        FolderPair(tmp_path)
    _write(tmp_path, "cam0", [1])
    (tmp_path / "cam0" / "data" / "late.png").write_bytes(b"")
    with pytest.raises(DeviceError, match=r"late\.png"):
        FolderPair(tmp_path)


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ("\N{SUPERSCRIPT TWO},7.png\n".encode(), r"data\.csv:1: expected 'time in ns, file name'"),
        (b"\xff\xfe1,7.png\n", r"data\.csv: is no table in UTF-8"),
        (b"#t,name\n1,7.png\n2,7.png\n", r"data\.csv:3: 7\.png has a second stamp here"),
        (b"9" * 19 + b",7.png\n", r"data\.csv:1: expected"),
    ],
)
def test_a_table_of_stamps_that_is_none_is_told_in_a_sentence(tmp_path: Path, table: bytes, sentence: str) -> None:
    _write(tmp_path, "cam0", [7])
    (tmp_path / "cam0" / "data.csv").write_bytes(table)
    with pytest.raises(DeviceError, match=sentence):
        FolderPair(tmp_path)


def test_a_name_whose_digits_are_no_decimal_ones_is_no_stamp(tmp_path: Path) -> None:
    _write(tmp_path, "cam0", [1])
    (tmp_path / "cam0" / "data" / "\N{SUPERSCRIPT TWO}.png").write_bytes(b"")
    with pytest.raises(DeviceError, match="is no time in nanoseconds"):
        FolderPair(tmp_path)


def test_sensor_files_become_cameras_of_the_same_geometry(tmp_path: Path) -> None:
    """Right camera 0.2 m along the left one's rows, turned by 0.03 rad about its own columns."""
    c, s = np.cos(0.03), np.sin(0.03)
    poses = {"cam0": np.eye(4), "cam1": np.array([[c, 0, s, 0.2], [0, 1, 0, 0], [-s, 0, c, 0], [0, 0, 0, 1.0]])}
    for name, pose in poses.items():
        (tmp_path / name).mkdir()
        data = ", ".join(repr(float(x)) for x in pose.ravel())
        text = f"%YAML:1.0\nT_BS:\n  cols: 4\n  rows: 4\n  data: [{data}]\nresolution: [752, 480]\n"
        text += "intrinsics: [458.0, 457.0, 367.0, 248.0]\ndistortion_coefficients: [-0.28, 0.07, 0.0, 0.0]\n"
        (tmp_path / name / "sensor.yaml").write_text(text)
    left, right = euroc_cameras(tmp_path)
    rig = Rig.from_airframe(dataclasses.replace(load_airframe("forward-2m"), left_camera=left, right_camera=right))
    relative = rig.right.rest.camera_from_body @ rig.left.rest.camera_from_body.T
    assert np.allclose(relative, poses["cam1"][:3, :3].T, atol=1e-12)
    assert rig.baseline_m == pytest.approx(0.2)
    assert rig.left.lens.matrix[1, 1] == pytest.approx(457.0)


def test_a_video_pair_plays_to_its_end(tmp_path: Path) -> None:
    for name in ("left", "right"):
        writer = cv2.VideoWriter(str(tmp_path / f"{name}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 20.0, (64, 48))
        for k in range(5):
            writer.write(np.full((48, 64, 3), 40 * k, np.uint8))
        writer.release()
    pair = CapturePair(tmp_path / "left.avi", tmp_path / "right.avi", clock=ClockName.BOOT, start_ns=10**9)
    shots = []
    while frames := pair.poll(0.0):
        shots.append(frames)
    pair.close()
    assert len(shots) == 5
    assert all((left.side, right.side) == (Side.LEFT, Side.RIGHT) for left, right in shots)
    stamps = np.array([left.mid_exposure_ns for left, _ in shots])
    assert np.diff(stamps) == pytest.approx(50_000_000, abs=1_000_000)
    assert stamps[0] >= 10**9
    with pytest.raises(DeviceError, match=r"none\.avi"):
        CapturePair(tmp_path / "none.avi", tmp_path / "left.avi")


@pytest.mark.parametrize("triggered", [True, False])
def test_a_device_without_frames_is_gone_unless_it_waits_for_a_trigger(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, triggered: bool
) -> None:
    class Silent:
        def __init__(self, source: object) -> None:
            self.source = source

        def isOpened(self) -> bool:
            return True

        def grab(self) -> bool:
            return False

        def release(self) -> None: ...

    devices = [tmp_path / "video0", tmp_path / "video2"]
    monkeypatch.setattr("companion.adapters.cameras.video.cv2.VideoCapture", Silent)
    monkeypatch.delenv("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", raising=False)
    for device in devices:
        device.mkdir()  # no file, so that it is taken for a device
    pair = CapturePair(str(devices[0]), str(devices[1]), triggered=triggered)
    if triggered:
        assert pair.poll(0.1) == []
        devices[1].rmdir()
    with pytest.raises(DeviceError, match="gives no more frames"):
        pair.poll(0.1)


@pytest.mark.parametrize("misses", [(), (3,), (3, 4, 9)])
@pytest.mark.parametrize("blind", Side)
def test_a_frame_that_one_camera_misses_makes_no_later_pair_older(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, blind: Side, misses: tuple[int, ...]
) -> None:
    """Ten triggers a second; a driver holds the frames that were not fetched."""
    now_s = [0.0]

    class Driver:
        def __init__(self, source: str) -> None:
            missed = misses if source.endswith(blind.name) else ()
            self.waiting = [0.1 * k for k in range(1, 20) if k not in missed]
            self.at_s = 0.0

        def isOpened(self) -> bool:
            return True

        def grab(self) -> bool:
            """The oldest frame that waits, or the next one when it comes."""
            self.at_s = self.waiting.pop(0)
            now_s[0] = max(now_s[0], self.at_s)
            return True

        def get(self, _: int) -> float:
            return 1e3 * self.at_s

        def retrieve(self) -> tuple[bool, np.ndarray]:
            return True, np.zeros((4, 4), np.uint8)

    monkeypatch.setattr("companion.adapters.cameras.video.cv2.VideoCapture", Driver)
    names = [tmp_path / side.name for side in Side]
    for name in names:
        name.mkdir()
    cameras, pairer, ages_s = CapturePair(*map(str, names), triggered=True), FramePairer(), []
    for _ in range(12):
        for frame in cameras.poll(0.1):
            pairs, _ = pairer.add(frame)
            ages_s += [now_s[0] - 1e-9 * pair.left.mid_exposure_ns for pair in pairs]
    assert len(ages_s) >= 12 - len(misses)
    assert max(ages_s) < 0.01


def test_an_exposure_in_the_wait_for_the_other_camera_makes_a_pair_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The left camera's wait has ended when the line rises; its frame comes with the next call."""
    names = [tmp_path / side.name for side in Side]
    grabs: dict[str, list[float | None]] = {str(names[0]): [None, 1500.0, 4000.0], str(names[1]): [1500.0, 4000.0, 0.0]}

    class Driver:
        def __init__(self, source: str) -> None:
            self.stamps = grabs[source]
            self.stamp_ms: float | None = None

        def isOpened(self) -> bool:
            return True

        def grab(self) -> bool:
            self.stamp_ms = self.stamps.pop(0)
            return self.stamp_ms is not None

        def get(self, _: int) -> float | None:
            return self.stamp_ms

        def retrieve(self) -> tuple[bool, np.ndarray]:
            return True, np.zeros((4, 4), np.uint8)

    monkeypatch.setattr("companion.adapters.cameras.video.cv2.VideoCapture", Driver)
    for name in names:
        name.mkdir()
    cameras, pairer = CapturePair(*map(str, names), triggered=True), FramePairer()
    frames = [frame for _ in range(2) for frame in cameras.poll(0.1)]
    pairs = [pair for frame in frames for pair in pairer.add(frame)[0]]
    assert [(pair.left.mid_exposure_ns, pair.right.mid_exposure_ns) for pair in pairs] == [
        (1_500_000_000, 1_500_000_000),
        (4_000_000_000, 4_000_000_000),
    ]
    for side in Side:
        assert [frame.sequence for frame in frames if frame.side is side] == [0, 1]

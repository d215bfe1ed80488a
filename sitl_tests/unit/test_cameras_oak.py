"""DepthAI without a device: real pipelines and replay nodes, real controls, frames and calibration files."""

from __future__ import annotations

import dataclasses
import datetime
import http.server
import os
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from companion.adapters.cameras import oak
from companion.adapters.cameras.oak import (
    OakPair,
    OakReplayPair,
    OakSensor,
    OakTiming,
    QueuePair,
    camera_queue,
    configure,
    frame_of,
    listen_to_line,
)
from companion.adapters.cameras.oak_calibration import cameras_from_handler, cameras_to_handler, handler_of
from companion.core.stereo.geometry import Rig
from companion.core.stereo.pairing import FramePairer
from companion.errors import DeviceError
from companion.params.airframe import Camera, Uncertain
from companion.params.files import load_airframe
from companion.records import ClockName, Side
from tools.oak_calibration import main as tool

dai = pytest.importorskip("depthai")
SOCKETS = ("CAM_B", "CAM_C")
BRIGHT = 20
SEARCH_MS = "200"  # of the library's search for a device (chosen: two rounds of it)


# ------------------------------------------------------------------------------------------------ frames and time


@pytest.fixture(scope="module")
def videos(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("videos")
    for name in ("left", "right"):
        writer = cv2.VideoWriter(str(folder / f"{name}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
        for k in range(8):
            writer.write(np.full((48, 64, 3), BRIGHT * k + (10 if name == "right" else 0), np.uint8))
        writer.release()
    return folder / "left.avi", folder / "right.avi"


@pytest.mark.slow
def test_replay_nodes_give_pairs_on_the_host_s_clock(videos: tuple[Path, Path]) -> None:
    """The same queues, records and pairing as with a device; device time has become host time in between."""
    pair, frames = OakReplayPair(*videos, OakTiming(exposure_us=1500, rate_hz=25.0)), []
    began_ns = time.monotonic_ns()
    try:
        while len(frames) < 16 and time.monotonic_ns() < began_ns + 20_000_000_000:
            frames += pair.poll(0.2)
    finally:
        pair.close()
    ended_ns = time.monotonic_ns()
    assert len(frames) == 16
    assert all(frame.clock is ClockName.HOST and frame.exposure_ns == 1_500_000 for frame in frames)
    assert all(began_ns - 10**9 < frame.mid_exposure_ns < ended_ns for frame in frames)
    pairer, made = FramePairer(), []
    for frame in frames:
        made += pairer.add(frame)[0]
    assert (
        [frame_pair.left.sequence for frame_pair in made]
        == [frame_pair.right.sequence for frame_pair in made]
        == list(range(8))
    )
    for frame_pair in made:  # MJPEG may be off by a few levels
        assert abs(float(frame_pair.left.image.mean()) - BRIGHT * frame_pair.left.sequence) < 5
        assert abs(float(frame_pair.right.image.mean()) - BRIGHT * frame_pair.left.sequence - 10) < 5
    spacing_ms = np.diff([frame_pair.left.mid_exposure_ns for frame_pair in made]) * 1e-6
    assert np.median(spacing_ms) == pytest.approx(40.0, abs=25.0)


@pytest.mark.slow
def test_images_of_a_replay_that_has_ended_are_not_lost(videos: tuple[Path, Path]) -> None:
    """A machine that stops for longer than the videos last still gets every pair, and then is told the end."""
    pair = OakReplayPair(*videos, OakTiming(rate_hz=100.0))
    try:
        time.sleep(1.0)
        assert len(pair.poll(0.0)) == 16
        with pytest.raises(DeviceError, match="have ended"):
            pair.poll(0.5)
    finally:
        pair.close()


def test_a_replay_of_nothing_is_named(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"none\.avi"):
        OakReplayPair(tmp_path / "none.avi", tmp_path / "none.avi", OakTiming())


def _image(stamp: datetime.timedelta) -> Any:
    image = dai.ImgFrame()
    image.setCvFrame(np.arange(24, dtype=np.uint8).reshape(4, 6), dai.ImgFrame.Type.GRAY8)
    image.setTimestamp(stamp)
    image.setSequenceNum(9)
    return image


def test_a_depthai_frame_becomes_ours() -> None:
    image = _image(datetime.timedelta(seconds=12, microseconds=345678))
    frame = frame_of(image, Side.RIGHT, OakTiming(exposure_us=1500, row_time_ns=12), dai)
    assert frame.row_time_ns == 12
    assert (frame.side, frame.sequence, frame.clock) == (Side.RIGHT, 9, ClockName.HOST)
    assert frame.mid_exposure_ns == 12_345_678_000 + 18  # from the first of four rows to the middle, 1.5 rows on
    assert frame.exposure_ns == 1_500_000
    assert np.array_equal(frame.image, np.arange(24).reshape(4, 6))


def test_long_up_times_keep_their_microseconds() -> None:
    image = _image(datetime.timedelta(days=400, seconds=86399, microseconds=999999))
    assert frame_of(image, Side.LEFT, OakTiming(), dai).mid_exposure_ns == (401 * 86400 * 10**6 - 1) * 1000


def test_the_library_s_clock_is_the_host_s() -> None:
    before, library_s, after = time.monotonic(), dai.Clock.now().total_seconds(), time.monotonic()
    assert before - 1e-5 <= library_s <= after + 1e-5


# ------------------------------------------------------------------------------------------------ left alone


def test_no_pipeline_of_ours_calibrates_the_device(videos: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """The library would by itself, at each start of a pipeline with a calibrated pair, and write it to the device."""
    off = dai.Pipeline.AutoCalibrationMode.OFF
    assert dai.Pipeline(createImplicitDevice=False).getAutoCalibrationMode() is not off, "the library's own way"
    replayed = OakReplayPair(*videos, OakTiming())
    replayed.close()
    monkeypatch.setattr(oak, "library", lambda: WithoutDevice())
    monkeypatch.setattr(oak, "camera_queue", lambda *_: None)
    monkeypatch.setattr(OakPair, "_start", lambda _: None)
    single = OakPair(OakSensor("", "CAM_B"), OakSensor("", "CAM_C"), (64, 48), OakTiming())
    two = OakPair(OakSensor("a", "CAM_B"), OakSensor("b", "CAM_B"), (64, 48), OakTiming())
    pipelines = [pipeline for pair in (replayed, single, two) for pipeline in pair._pipelines.values()]
    assert len(pipelines) == 4
    assert {pipeline.getAutoCalibrationMode() for pipeline in pipelines} == {off}


class WithoutDevice:
    """The library, with pipelines that need no device."""

    def __getattr__(self, name: str) -> Any:
        return getattr(dai, name)

    def Device(self, *_: object) -> None:
        """None is there."""

    def DeviceInfo(self, *_: object) -> None:
        """None is there."""

    @property
    def Pipeline(self) -> Any:
        class Pipeline(dai.Pipeline):  # type: ignore[misc]
            def __init__(self, _device: object) -> None:
                super().__init__(createImplicitDevice=False)

            def create(self, *_: object) -> None:
                """A camera needs a device."""

        return Pipeline


_FLIGHT = "import time; pipeline = dai.Pipeline(createImplicitDevice=False); pipeline.start(); time.sleep(0.5)"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("opened", "chatty"),
    [
        ("import depthai as dai", True),  # the library's own way, which shows that this test would hear it
        ("from companion.adapters.cameras.oak import library; dai = library()", False),
    ],
    ids=["by itself", "ours"],
)
def test_the_library_tells_its_maker_nothing(opened: str, chatty: bool, tmp_path: Path) -> None:
    heard: list[bytes] = []

    class Maker(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            heard.append(self.rfile.read(int(self.headers["content-length"] or 0)))
            self.send_response(200)
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Maker) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        surroundings = {key: value for key, value in os.environ.items() if key != "DEPTHAI_TELEMETRY"}
        surroundings |= {
            "DEPTHAI_TELEMETRY_URL": f"http://127.0.0.1:{server.server_port}",
            "DEPTHAI_CACHE_DIR": str(tmp_path),
            "HOME": str(tmp_path),
        }
        subprocess.run([sys.executable, "-c", f"{opened}; {_FLIGHT}"], env=surroundings, check=True, timeout=60)
        time.sleep(0.5)
        server.shutdown()
    assert bool(heard) == chatty


# ------------------------------------------------------------------------------------------------ set-up


@pytest.mark.parametrize("external", [False, True])
def test_controls_ask_for_what_was_configured(external: bool) -> None:
    control = dai.CameraControl()
    configure(control, OakTiming(exposure_us=1500, iso=800, external=external), dai)
    assert control.getExposureTime() == datetime.timedelta(microseconds=1500)
    assert control.getSensitivity() == 800
    assert (control.frameSyncMode == dai.CameraControl.FrameSyncMode.INPUT) is external


def test_a_camera_node_is_built_on_its_socket_with_grey_images() -> None:
    """The library refuses camera nodes without a device, so that this one is a stand-in that remembers."""
    asked: dict[str, Any] = {}
    output = SimpleNamespace(createOutputQueue=lambda **how: ("queue", how))

    def request(size: tuple[int, int], kind: Any, fps: float) -> Any:
        asked.update(size=size, kind=kind, fps=fps)
        return output

    def build(place: Any) -> Any:
        asked["place"] = place
        return SimpleNamespace(initialControl=dai.CameraControl(), requestOutput=request)

    queue, how = camera_queue(SimpleNamespace(build=build), "CAM_C", (640, 480), OakTiming(rate_hz=20.0), dai)
    assert queue == "queue"
    assert how["blocking"] is False
    assert asked == {
        "place": dai.CameraBoardSocket.CAM_C, "size": (640, 480), "kind": dai.ImgFrame.Type.GRAY8, "fps": 20.0
    }  # fmt: skip
    with pytest.raises(DeviceError, match="CAM_Z"):
        camera_queue(SimpleNamespace(build=build), "CAM_Z", (640, 480), OakTiming(), dai)


def test_a_device_that_cannot_listen_to_the_line_says_so() -> None:
    asked = []

    def role(wanted: Any) -> tuple[bool, str]:
        asked.append(wanted)
        return len(asked) == 1, "no FSYNC pin"

    device = SimpleNamespace(setExternalFrameSyncRole=role)
    listen_to_line(device, dai)
    assert asked == [dai.ExternalFrameSyncRole.SLAVE]
    with pytest.raises(DeviceError, match="no FSYNC pin"):
        listen_to_line(device, dai)


@pytest.mark.slow
def test_without_a_device_the_pair_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """The library looks for ten seconds of its own accord; here none is there to look for."""
    if dai.Device.getAllAvailableDevices():
        pytest.skip("a DepthAI device is connected")
    monkeypatch.setenv("DEPTHAI_SEARCH_TIMEOUT", SEARCH_MS)
    with pytest.raises(DeviceError, match="DepthAI"):
        OakPair(OakSensor("", "CAM_B"), OakSensor("", "CAM_C"), (640, 480), OakTiming())


class Unplugged(QueuePair):
    """A pair whose left queue was closed, as the library does when a device is gone."""

    def __init__(self) -> None:
        super().__init__(OakTiming())
        self._queues = [dai.MessageQueue(), dai.MessageQueue()]
        self._queues[0].close()


def test_a_device_that_was_unplugged_is_a_device_error() -> None:
    with pytest.raises(DeviceError, match="DepthAI camera: MessageQueue was closed"):
        Unplugged().poll(0.0)


# ------------------------------------------------------------------------------------------------ calibration


def _cameras(name: str) -> tuple[Camera, Camera]:
    airframe = load_airframe(name)
    assert airframe.left_camera is not None
    assert airframe.right_camera is not None
    left = dataclasses.replace(
        airframe.left_camera, rotation_rad=(0.003, -0.002, 0.01), focal_px=Uncertain(801.5, 0.4), focal_ratio=0.998,
        distortion=(-0.1, 0.02, 1e-4, -2e-4, 3e-3),
    )  # fmt: skip
    right = dataclasses.replace(airframe.right_camera, rotation_rad=(-0.02, 0.015, -0.004), principal_px=(322.0, 236.5))
    return left, right


@pytest.mark.parametrize("name", ["nadir-2m", "forward-2m"])
def test_a_calibration_survives_the_handler_and_its_file(tmp_path: Path, name: str) -> None:
    left, right = _cameras(name)
    handler = dai.CalibrationHandler()
    cameras_to_handler(handler, SOCKETS, left, right)
    file = tmp_path / "device.json"
    assert handler.eepromToJsonFile(str(file))
    bare = load_airframe(name)
    assert bare.right_camera is not None
    start = dataclasses.replace(left, focal_px=Uncertain(700.0, 0.4), focal_ratio=1.0, distortion=(0.0,) * 5)
    first, other = cameras_from_handler(handler_of(file), SOCKETS, start, bare.right_camera)
    for camera, true in ((first, left), (other, right)):
        assert camera.focal_px.value == pytest.approx(true.focal_px.value, rel=1e-6)
        assert camera.focal_ratio == pytest.approx(true.focal_ratio, rel=1e-6)
        assert camera.principal_px == pytest.approx(true.principal_px, rel=1e-6)
        assert camera.distortion == pytest.approx(true.distortion, rel=1e-5, abs=1e-9)
        assert camera.rotation_rad == pytest.approx(true.rotation_rad, abs=1e-6)
        assert camera.position_m == pytest.approx(true.position_m, abs=1e-6)


def test_a_point_is_where_the_handler_s_own_pose_puts_it() -> None:
    """Independent of our parametrisation: a point in front of the left camera, moved by the handler's 4x4 matrix."""
    left, right = _cameras("nadir-2m")
    handler = dai.CalibrationHandler()
    cameras_to_handler(handler, SOCKETS, left, right)
    rig = Rig.from_airframe(dataclasses.replace(load_airframe("nadir-2m"), left_camera=left, right_camera=right))
    body_m = np.array([2.0, 1.0, 30.0])
    by_us = rig.right.rest.camera_from_body @ (body_m - rig.right.rest.position_body_m)
    in_left = rig.left.rest.camera_from_body @ (body_m - rig.left.rest.position_body_m)
    pose = np.array(handler.getCameraExtrinsics(dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C))
    by_them = (pose @ np.append(100.0 * in_left, 1.0))[:3] / 100.0
    assert by_them == pytest.approx(by_us, abs=1e-4)
    assert handler.getBaselineDistance(dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C) == pytest.approx(198.0)


def test_what_is_not_calibrated_is_named(tmp_path: Path) -> None:
    left, right = _cameras("nadir-2m")
    with pytest.raises(DeviceError, match="CAM_B"):
        cameras_from_handler(dai.CalibrationHandler(), SOCKETS, left, right)
    with pytest.raises(DeviceError, match=r"none\.json"):
        handler_of(tmp_path / "none.json")
    handler = dai.CalibrationHandler()
    cameras_to_handler(handler, SOCKETS, left, right)
    handler.setDistortionCoefficients(dai.CameraBoardSocket.CAM_B, [0.1] * 8 + [0.0] * 6)
    with pytest.raises(DeviceError, match="rational"):
        cameras_from_handler(handler, SOCKETS, left, right)
    for socket in (dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C):
        handler.setCameraType(socket, dai.CameraModel.Fisheye)
        handler.setDistortionCoefficients(socket, [0.1, -0.02, 0.003, -0.001, *[0.0] * 10])
    with pytest.raises(DeviceError, match="CAM_B has a lens model of another kind"):
        cameras_from_handler(handler, SOCKETS, left, right)


def test_the_tool_reads_what_it_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, out = str(tmp_path / "device.json"), tmp_path / "airframe.toml"
    assert tool(["write", file, "--airframe", "nadir-2m"]) == 0
    assert tool(["read", file, "--airframe", "nadir-2m", "--out", str(out)]) == 0
    again, first = load_airframe(str(out)), load_airframe("nadir-2m")
    assert again.right_camera is not None
    assert first.right_camera is not None
    assert again.right_camera.position_m == pytest.approx(first.right_camera.position_m, abs=1e-6)
    assert again.right_camera.rotation_rad == pytest.approx((0.0, 0.0, 0.0), abs=1e-6)
    assert tool(["read", str(tmp_path / "no.json"), "--airframe", "nadir-2m"]) == 2
    assert "no.json" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["write", "{}", "--airframe", "nadir-2m"], "cannot be written"),
        (["read", "{}/device.json", "--airframe", "nadir-2m", "--out", "{}"], "cannot be written"),
        (["read", "{}/device.json", "--airframe", "nadir-2m", "--out", "{}/device.json/a.toml"], "cannot be written"),
        (["read", "{}/device.json", "--airframe", "nadir-2m", "--sockets", "CAM_B", "CAM_B"], "name two"),
        (["read", "{}/device.json", "--airframe", "nadir-2m", "--sockets", "CAM_C", "CAM_B"], "CAM_C as left"),
    ],
)
def test_the_tool_says_wrote_of_what_can_be_loaded_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], sentence: str
) -> None:
    assert tool(["write", str(tmp_path / "device.json"), "--airframe", "nadir-2m"]) == 0
    before = sorted(tmp_path.iterdir())
    capsys.readouterr()
    words = [word.format(tmp_path) for word in words]
    assert tool(words if "--out" in words else [*words, "--out", str(tmp_path / "wing.toml")]) == 2
    said = capsys.readouterr()
    assert sentence in said.err
    assert "wrote" not in said.out
    assert sorted(tmp_path.iterdir()) == before

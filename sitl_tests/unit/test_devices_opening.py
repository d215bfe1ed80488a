"""Cameras and triggers by name: each spelling opens its adapter, a wrong or absent one is said in one sentence."""

from __future__ import annotations

import argparse
import dataclasses
import pickle
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from companion.adapters.cameras import camera_factory as cameras
from companion.adapters.cameras.oak import OakPair, OakSensor
from companion.adapters.cameras.paced import PacedPair, RecordedPair
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.adapters.triggers import trigger_factory as triggers
from companion.adapters.triggers.mavlink import LinkFiring, MavlinkTrigger, link_firing
from companion.adapters.triggers.oak import SoftLine, soft_line
from companion.adapters.triggers.serial_board import SerialBoardTrigger
from companion.cli import run
from companion.core.pipeline import VisionState
from companion.errors import ConfigError, DeviceError
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, Frame, Side
from companion.service import vision
from sitl_tests.manual_clock import ManualClock

MS = 1_000_000
FORMATS = Path(__file__).resolve().parents[2] / "config" / "README.md"


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return load_airframe("nadir-2m")


def _images(folder: Path, stamps: tuple[int, ...], size: tuple[int, int] = (6, 8)) -> None:
    for camera in ("cam0", "cam1"):
        data = folder / camera / "data"
        data.mkdir(parents=True)
        for t_ns in stamps:
            cv2.imwrite(str(data / f"{t_ns}.png"), np.full(size, t_ns % 251, np.uint8))


def _frame(side: Side, t_ns: int) -> Frame:
    return Frame(side, 0, ClockName.CAM_LEFT, t_ns, 5, 7, -1, np.full((2, 2), t_ns % 250, np.uint8))


class Scripted:
    """Pairs at given instants of some clock."""

    def __init__(self, stamps: list[int]) -> None:
        self.stamps, self.closed = stamps, False

    def poll(self, timeout_s: float) -> list[Frame]:
        return [_frame(side, self.stamps.pop(0) if side else self.stamps[0]) for side in Side] if self.stamps else []

    def close(self) -> None:
        self.closed = True


# ------------------------------------------------------------------------------------------------ pacing


def test_a_file_plays_at_its_own_pace_on_the_host_s_clock() -> None:
    clock, source = ManualClock(10**12), Scripted([50 * MS, 150 * MS, 170 * MS])
    pair, deliveries = PacedPair(source, clock), []
    while clock.now_ns() < 10**12 + 400 * MS:
        before_ns = clock.now_ns()
        for frame in pair.poll(0.02):
            deliveries.append((frame.side, frame.mid_exposure_ns - 10**12, clock.now_ns() - 10**12))
            assert frame.clock is ClockName.HOST
            assert (frame.exposure_ns, frame.row_time_ns) == (5, 7)
        assert clock.now_ns() <= before_ns + 20 * MS
    assert [(side, at) for side, at, _ in deliveries] == [(side, at) for at in (0, 100 * MS, 120 * MS) for side in Side]
    assert all(delivered_at == at for _, at, delivered_at in deliveries), "no frame comes before its exposure"
    pair.close()
    assert source.closed


def test_images_of_a_recording_come_back_with_their_stamps(tmp_path: Path, airframe: Airframe) -> None:
    path = tmp_path / "flight.mcap"
    writer = McapWriter(path, About.of(airframe, Settings()))
    for t_ns in (100, 200):
        for side in Side:
            writer.write(_frame(side, t_ns))
    writer.close()
    pair, images = RecordedPair(path), []
    while frames := pair.poll(0.0):
        images += [(frame.side, frame.mid_exposure_ns, int(frame.image[0, 0])) for frame in frames]
    assert images == [(side, t, t) for t in (100, 200) for side in Side]


def test_a_recording_without_images_is_named(tmp_path: Path, airframe: Airframe) -> None:
    path = tmp_path / "blind.mcap"
    McapWriter(path, About.of(airframe, Settings())).close()
    with pytest.raises(DeviceError, match=r"blind\.mcap has no images"):
        RecordedPair(path)


def test_images_of_another_size_than_the_airframe_s_end_vision_with_a_sentence(airframe: Airframe) -> None:
    source: Any = Scripted([50 * MS])
    running: Any = SimpleNamespace(is_set=lambda: False)
    with pytest.raises(DeviceError, match=r"left camera gives 2x2 images; .* for 640x480: set the camera to"):
        vision.run(VisionState.create(airframe, Settings()), source, ManualClock(), print, None, running)
    assert source.closed


# ------------------------------------------------------------------------------------------------ spelling


def test_a_folder_opens_with_the_airframe_s_exposure(tmp_path: Path, airframe: Airframe) -> None:
    _images(tmp_path, (1000, 2000))
    factory = pickle.loads(pickle.dumps(cameras.camera_factory(f"folder:{tmp_path}", airframe, triggered=False)))
    frames = list(factory().poll(0.5))
    assert [frame.side for frame in frames] == list(Side)
    assert frames[0].exposure_ns == 2 * MS
    assert frames[0].clock is ClockName.HOST


@pytest.mark.parametrize("spelling", ["", "webcam:0", "oak", "v4l2:0", "v4l2:0,1,2", "video:a.avi,", "folder:"])
def test_a_wrong_pair_is_refused_with_the_known_ones(spelling: str, airframe: Airframe) -> None:
    with pytest.raises(ConfigError, match="--cameras"):
        cameras.camera_factory(spelling, airframe, triggered=True)


@pytest.mark.parametrize("spelling", [*cameras.SPELLINGS, *triggers.SPELLINGS])
def test_the_page_of_formats_has_each_spelling(spelling: str) -> None:
    rows = [line for line in FORMATS.read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    kind = spelling.split(" ")[0].partition(":")[0]
    named = [word for row in rows for word in re.findall(r"`([^`]+)`", row.split(" | ")[0])]
    assert any(word.partition(":")[0] == kind for word in named), f"config/README.md needs a row of `{spelling}`"


def test_an_airframe_without_cameras_has_none_to_open(airframe: Airframe) -> None:
    blind = dataclasses.replace(airframe, left_camera=None, right_camera=None)
    with pytest.raises(ConfigError, match="no camera pair"):
        cameras.camera_factory("v4l2:0,1", blind, triggered=True)


@pytest.mark.parametrize("unequal", [{"exposure_s": 0.010}, {"row_time_s": 2e-5}])
def test_cameras_that_are_exposed_differently_are_refused(unequal: dict[str, float], airframe: Airframe) -> None:
    """Every kind is opened and stamped by the left camera's."""
    assert airframe.right_camera is not None
    other = dataclasses.replace(airframe, right_camera=dataclasses.replace(airframe.right_camera, **unequal))
    for spelling in ("v4l2:0,1", "oak:CAM_B,CAM_C"):
        with pytest.raises(ConfigError, match="exposure_s and row_time_s of left_camera and right_camera"):
            cameras.camera_factory(spelling, other, triggered=True)


class Device:
    """A V4L2 device as OpenCV opens it; ``asked`` is what was set on all of them."""

    asked: ClassVar[list[tuple[str, int, float]]] = []

    def __init__(self, source: str) -> None:
        self.source = source

    def isOpened(self) -> bool:
        return True

    def set(self, name: int, value: float) -> None:
        self.asked.append((self.source, name, value))


def test_v4l2_devices_are_asked_for_the_airframe_s_sizes(airframe: Airframe, monkeypatch: pytest.MonkeyPatch) -> None:
    assert airframe.right_camera is not None
    right = dataclasses.replace(airframe.right_camera, width_px=1280, height_px=800)
    monkeypatch.setattr("companion.adapters.cameras.video.cv2.VideoCapture", Device)
    cameras.camera_factory("v4l2:left,right", dataclasses.replace(airframe, right_camera=right), triggered=False)()
    width, height = cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT
    sizes = [("left", width, 640), ("left", height, 480), ("right", width, 1280), ("right", height, 800)]
    assert Device.asked == sizes


def test_oak_devices_are_told_apart_and_follow_the_trigger_line(airframe: Airframe) -> None:
    for spelling, expected in (
        ("oak:CAM_B,CAM_C", (OakSensor("", "CAM_B"), OakSensor("", "CAM_C"))),
        ("oak:14442C10/CAM_A, 10.0.0.3/CAM_A", (OakSensor("14442C10", "CAM_A"), OakSensor("10.0.0.3", "CAM_A"))),
    ):
        for triggered in (True, False):
            factory: Any = cameras.camera_factory(spelling, airframe, triggered=triggered)
            assert factory.func is OakPair
            left, right, size, timing, soft = factory.args
            assert soft is None
            assert (left, right, size) == (*expected, (640, 480))
            assert (timing.external, timing.exposure_us) == (triggered, 2000)


def test_the_software_trigger_reaches_the_cameras_that_have_one(airframe: Airframe) -> None:
    soft = SoftLine(pins=(41, 38))
    factory: Any = cameras.camera_factory("oak:CAM_B,CAM_C", airframe, triggered=True, soft=soft)
    assert factory.args[-1] == soft
    assert factory.args[-2].external
    with pytest.raises(ConfigError, match="--trigger oak fires DepthAI cameras only, not --cameras v4l2:0,1"):
        cameras.camera_factory("v4l2:0,1", airframe, triggered=True, soft=soft)


@pytest.mark.parametrize(
    ("spelling", "error"),
    [("folder:/nowhere/at/all", "no such folder"), ("v4l2:/dev/video77,/dev/video78", "/dev/video77"),
     ("video:/no.avi,/no.avi", r"no\.avi")],
)  # fmt: skip
def test_what_is_not_there_is_named(spelling: str, error: str, airframe: Airframe) -> None:
    with pytest.raises(DeviceError, match=error):
        cameras.camera_factory(spelling, airframe, triggered=False)()


def test_triggers_by_name() -> None:
    assert triggers.trigger_factory("none") is None
    assert triggers.trigger_factory("mavlink") is MavlinkTrigger
    relay = triggers.trigger_factory("mavlink:relay,2")
    assert link_firing(relay) == LinkFiring("relay", 2)
    assert link_firing(triggers.trigger_factory("mavlink:servo,9,1750")) == LinkFiring("servo", 9, 1750)
    assert link_firing(MavlinkTrigger) == LinkFiring()
    board: Any = triggers.trigger_factory("serial:/dev/ttyUSB0,57600")
    assert (board.func, board.args) == (SerialBoardTrigger, ("/dev/ttyUSB0", 57600))
    assert link_firing(board) is None
    line: Any = triggers.trigger_factory("gpio:/dev/gpiochip0,17,low")
    assert (line.args, line.keywords) == (("/dev/gpiochip0", 17), {"active_low": True})
    assert soft_line(triggers.trigger_factory("oak")) == SoftLine()
    assert soft_line(triggers.trigger_factory("oak:40, 38")) == SoftLine(pins=(40, 38))
    assert soft_line(line) is None
    for spelling in (
        "",
        "relay",
        "serial",
        "serial:",
        "serial:/dev/x,fast",
        "gpio:/dev/gpiochip0",
        "gpio:a,1,high",
        "mavlink:servo,9",
        "mavlink:x",
        "oak:",
        "oak:pin",
        "oak:\N{SUPERSCRIPT TWO}",
        "gpio:chip,\N{SUPERSCRIPT TWO}",
        "mavlink:relay,\N{SUPERSCRIPT TWO}",
        "serial:/dev/x," + "9" * 5000,
    ):
        with pytest.raises(ConfigError, match="known are none"):
            triggers.trigger_factory(spelling)


def test_a_port_that_is_not_there_and_a_library_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    board = triggers.trigger_factory("serial:/dev/no-such-board")
    assert board is not None
    with pytest.raises(DeviceError, match="cannot open trigger board on /dev/no-such-board"):
        board()
    line = triggers.trigger_factory("gpio:/dev/gpiochip9,1")
    assert line is not None
    monkeypatch.setitem(sys.modules, "gpiod", None)
    with pytest.raises(DeviceError, match=r"spanwise\[gpio\]"):
        line()
    monkeypatch.setitem(sys.modules, "gpiod", SimpleNamespace(Chip=object, __version__="1.5.4"))
    with pytest.raises(DeviceError, match=r"need gpiod 2, this is 1\.5\.4"):
        line()


# ------------------------------------------------------------------------------------------------ the command


def _options(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    run.add_arguments(parser)
    return parser.parse_args(["--connect", "udpin:127.0.0.1:0", "--airframe", "nadir-2m", *words])


def test_run_wires_what_is_named(tmp_path: Path) -> None:
    _images(tmp_path, (1000,))
    parameter_option = ["--parameters", str(tmp_path / "kept")]
    config = run.service_config(_options("--cameras", f"folder:{tmp_path}", "--trigger", "mavlink", *parameter_option))
    assert config.cameras is not None
    assert config.trigger is MavlinkTrigger
    run.try_devices(config)
    blind = run.service_config(_options(*parameter_option))
    assert (blind.cameras, blind.trigger) == (None, None)


def test_run_stops_before_it_starts_when_a_device_is_absent(tmp_path: Path) -> None:
    parameter_option = ["--parameters", str(tmp_path / "kept")]
    with pytest.raises(DeviceError, match="no-such-board"):
        run.execute(_options("--trigger", "serial:/dev/no-such-board", *parameter_option))
    with pytest.raises(ConfigError, match="--record-images needs"):
        run.service_config(_options("--record-images", *parameter_option))

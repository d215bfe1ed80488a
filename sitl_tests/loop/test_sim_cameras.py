"""The simulated camera pair over its real sockets: exact instants, bounded queue, honest gaps, death and return."""

from __future__ import annotations

import dataclasses
import functools
import os
import pickle
import signal
import time
from collections.abc import Iterator
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import pytest

from companion.errors import ConfigError, DeviceError
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import load_airframe
from companion.ports import CameraPair, Trigger
from companion.records import PLAN_UNKNOWN, ClockName, Firing, Frame, Side, TriggerPlan
from companion.sim.vision.camera_server import CameraServer, CameraServerConfig, start_camera_server
from companion.sim.vision.cameras import Shutters, SimCameraPair, SimTriggerLine, render_pair
from companion.sim.vision.renderer import ExposureInterval, Renderer
from companion.sim.vision.scene import ground_scene
from sitl_tests.physics.camera_flight import Path as FlightPath
from sitl_tests.physics.camera_flight import fly


def _airframe() -> Airframe:
    nadir = load_airframe("nadir-2m")
    assert nadir.left_camera is not None
    assert nadir.right_camera is not None
    small = {"width_px": 160, "height_px": 120, "principal_px": (79.5, 59.5)}
    return dataclasses.replace(
        nadir,
        left_camera=dataclasses.replace(nadir.left_camera, latency_s=Uncertain(0.007), **small),
        right_camera=dataclasses.replace(nadir.right_camera, latency_s=Uncertain(0.009), **small),
    )


AIRFRAME = _airframe()
TRUTH = fly(AIRFRAME, FlightPath(40.0, 22.0, swing_m=0.005))


def _config(folder: Path, start_host_ns: int, **changes: object) -> CameraServerConfig:
    config = CameraServerConfig(
        AIRFRAME, TRUTH, ground_scene(1), 5, start_host_ns, folder / "line.sock", folder / "frames.sock"
    )
    return dataclasses.replace(config, **changes)


def _plan(plan_id: int) -> TriggerPlan:
    now = time.monotonic_ns()
    return TriggerPlan(plan_id, Firing.PEAK, now, now, 0, 0.0, now, now)


def _collect(pair: SimCameraPair, count: int, within_s: float = 30.0) -> list[Frame]:
    frames: list[Frame] = []
    deadline = time.monotonic() + within_s
    while len(frames) < count and time.monotonic() < deadline:
        frames += pair.poll(0.05)
    return frames


def _served(server: CameraServer, pair: SimCameraPair, count: int) -> list[Frame]:
    """Run the server's loop here until so many frames have come."""
    frames: list[Frame] = []
    for _ in range(200):
        server.step()
        frames += pair.poll(0.0)
        if len(frames) >= count:
            break
    return frames


# ------------------------------------------------------------------------------------------------ without a process


def test_shutters_open_after_each_cameras_own_latency() -> None:
    shutters = Shutters(AIRFRAME, 3)
    edge_ns = 5_000_000_000
    delay = (
        np.array(
            [[shutters.exposure(side, edge_ns, shot).mid_boot_ns - edge_ns for side in Side] for shot in range(400)]
        )
        * 1e-9
    )
    assert delay.mean(axis=0) == pytest.approx([0.008, 0.010], abs=5e-5)  # latency and half of 2 ms
    assert np.all((delay.std(axis=0) > 1e-4) & (delay.std(axis=0) < 2e-4))
    assert abs(np.corrcoef(delay.T)[0, 1]) < 0.2
    assert shutters.exposure(Side.LEFT, edge_ns, 7) == Shutters(AIRFRAME, 3).exposure(Side.LEFT, edge_ns, 7)


def test_the_middle_rows_middle_is_stamped_with_a_rolling_shutter() -> None:
    camera = AIRFRAME.left_camera
    assert camera is not None
    rolling = dataclasses.replace(AIRFRAME, left_camera=dataclasses.replace(camera, row_time_s=2e-5))
    late, soon = (Shutters(airframe, 3).exposure(Side.LEFT, 0, 0).mid_boot_ns for airframe in (rolling, AIRFRAME))
    assert late - soon == pytest.approx(2e4 * 59.5)


def test_an_airframe_without_cameras_is_refused() -> None:
    with pytest.raises(ConfigError, match="no camera pair"):
        Shutters(dataclasses.replace(AIRFRAME, left_camera=None), 1)


def test_a_pair_without_sockets_is_the_same_pair() -> None:
    renderer, shutters = Renderer(AIRFRAME, TRUTH, ground_scene(1), 5), Shutters(AIRFRAME, 5)
    pair = render_pair(renderer, shutters, 1_000_000_000, 3)
    assert pair.left.clock is ClockName.BOOT
    assert pair.left.plan_id == PLAN_UNKNOWN
    exposure = ExposureInterval(pair.right.mid_exposure_ns, pair.right.exposure_ns)
    assert np.array_equal(pair.right.image, renderer.render(Side.RIGHT, exposure, 3))
    assert pair.right.mid_exposure_ns - pair.left.mid_exposure_ns == pytest.approx(2_000_000, abs=1_000_000)


def test_nobody_at_the_other_end_is_a_device_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.sim.vision.cameras._CONNECT_TRIES", 2)
    monkeypatch.setattr("companion.sim.vision.cameras._CONNECT_WAIT_S", 0.01)
    with pytest.raises(DeviceError, match="no simulated cameras"):
        SimCameraPair(tmp_path / "nothing")
    with pytest.raises(DeviceError, match="no simulated camera listens"):
        SimTriggerLine(tmp_path / "nothing").fire(_plan(1))


@pytest.fixture
def server(tmp_path: Path) -> Iterator[CameraServer]:
    made = CameraServer(_config(tmp_path, time.monotonic_ns() - 100_000_000, queue_shots=2))
    yield made
    made.close()


def test_a_full_queue_drops_the_oldest_shot_whole_and_counts_it(server: CameraServer) -> None:
    line, pair = SimTriggerLine(server.config.line_path), SimCameraPair(server.config.frames_path)
    server.step()
    start = time.monotonic_ns()
    for shot in range(4):  # 30 ms apart, all before the first can be read out
        line.pulse(shot, start + 30_000_000 * shot)
    server.step()
    assert server.counters["shots"] == 4
    assert server.counters["dropped"] == 2
    frames = _served(server, pair, 4)
    assert [(frame.side, frame.sequence) for frame in frames] == [(s, n) for n in (2, 3) for s in Side]
    line.close()
    pair.close()


def test_what_a_full_queue_drops_is_a_whole_shot_though_half_of_the_oldest_is_rendered(server: CameraServer) -> None:
    line, pair = SimTriggerLine(server.config.line_path), SimCameraPair(server.config.frames_path)
    server.step()
    start = server.config.start_host_ns + 20_000_000
    line.pulse(0, start)
    frames = _served(server, pair, 1)  # the left image of shot 0; its right one waits
    for shot in range(1, 6):
        line.pulse(shot, start + 20_000_000 * shot)
    server.step()
    dropped = server.counters["dropped"]
    assert dropped >= 2
    frames += _served(server, pair, 2 * (6 - dropped) - 1)
    for side in Side:
        assert [frame.sequence for frame in frames if frame.side is side] == [0, 4, 5]
    line.close()
    pair.close()


def test_a_busy_camera_ignores_a_second_pulse(server: CameraServer) -> None:
    line, pair = SimTriggerLine(server.config.line_path), SimCameraPair(server.config.frames_path)
    server.step()
    now = time.monotonic_ns()
    for edge in (now, now + 3_000_000, now + 40_000_000):
        line.pulse(1, edge)
    server.step()
    assert server.counters["shots"] == 2
    assert server.counters["busy"] == 1
    line.close()
    pair.close()


def test_shots_outside_the_flight_show_nothing_and_are_counted(server: CameraServer) -> None:
    line, pair = SimTriggerLine(server.config.line_path), SimCameraPair(server.config.frames_path)
    server.step()
    line.pulse(1, server.config.start_host_ns - 500_000_000)
    for _ in range(4):
        server.step()
    assert server.counters["outside"] == 2
    assert pair.poll(0.0) == []
    line.close()
    pair.close()


def test_what_is_not_a_pulse_is_ignored(server: CameraServer) -> None:
    line = SimTriggerLine(server.config.line_path)
    line._socket.sendto(b"noise", str(server.config.line_path))
    server.step()
    assert server.counters["shots"] == 0
    line.close()


def test_lost_images_leave_gaps_in_the_numbers(server: CameraServer) -> None:
    line, pair = SimTriggerLine(server.config.line_path), SimCameraPair(server.config.frames_path)
    server.step()
    line.pulse(0, server.config.start_host_ns + 20_000_000)
    frames = _served(server, pair, 2)
    for shot in range(1, 4):
        line.pulse(shot, server.config.start_host_ns + 20_000_000 + 30_000_000 * shot)
    server.step()
    frames += _served(server, pair, 4)
    assert [frame.sequence for frame in frames if frame.side is Side.LEFT] == [0, 2, 3]
    line.close()
    pair.close()


# ------------------------------------------------------------------------------------------------ the live process


@dataclasses.dataclass
class _Live:
    config: CameraServerConfig
    process: BaseProcess
    line: Trigger

    def offline(self, frame: Frame) -> np.ndarray:
        """The image that this exposure must have given."""
        renderer = Renderer(AIRFRAME, self.config.truth, self.config.scene, self.config.seed)
        exposure = ExposureInterval(frame.mid_exposure_ns - self.config.start_host_ns, frame.exposure_ns)
        return renderer.render(frame.side, exposure, frame.sequence)


@pytest.fixture
def live(tmp_path: Path) -> Iterator[_Live]:
    config = _config(tmp_path, time.monotonic_ns(), truth=fly(AIRFRAME, FlightPath(40.0, 22.0, swing_m=0.005), 60))
    process = start_camera_server(config)
    factory = pickle.loads(pickle.dumps(functools.partial(SimTriggerLine, config.line_path)))
    line: Trigger = factory()
    yield _Live(config, process, line)
    line.close()
    process.terminate()
    process.join(30.0)
    assert not process.is_alive()
    assert not config.line_path.exists()


@pytest.mark.realtime
def test_live_frames_show_the_truth_at_the_instant_that_the_line_said(live: _Live) -> None:
    pair: CameraPair = SimCameraPair(live.config.frames_path)
    fired = []
    for shot in range(4):
        time.sleep(0.06)
        fired.append(live.line.fire(_plan(shot)).fired_host_ns)
    frames = _collect(pair, 8)
    assert len(frames) == 8
    for frame in frames:
        delay_s = (frame.mid_exposure_ns - fired[frame.sequence]) * 1e-9
        assert delay_s == pytest.approx(0.008 if frame.side is Side.LEFT else 0.010, abs=8e-4)
        assert frame.clock is ClockName.HOST
        assert frame.plan_id == PLAN_UNKNOWN
        assert np.array_equal(frame.image, live.offline(frame))
    pair.close()


@pytest.mark.realtime
def test_images_that_are_rendered_late_keep_their_instants(live: _Live) -> None:
    pair = SimCameraPair(live.config.frames_path)
    assert live.process.pid is not None
    time.sleep(0.1)
    os.kill(live.process.pid, signal.SIGSTOP)
    fired = []
    for shot in range(3):
        fired.append(live.line.fire(_plan(shot)).fired_host_ns)
        time.sleep(0.05)
    time.sleep(0.2)
    os.kill(live.process.pid, signal.SIGCONT)
    frames = _collect(pair, 6)
    assert [frame.sequence for frame in frames] == [0, 0, 1, 1, 2, 2]
    for frame in frames:
        assert (frame.mid_exposure_ns - fired[frame.sequence]) * 1e-9 < 0.012
        assert np.array_equal(frame.image, live.offline(frame))
    pair.close()


@pytest.mark.realtime
def test_a_restarted_client_gets_frames_and_a_dead_server_is_a_device_error(live: _Live) -> None:
    SimCameraPair(live.config.frames_path).close()
    pair = SimCameraPair(live.config.frames_path)
    time.sleep(0.2)
    live.line.fire(_plan(0))
    assert len(_collect(pair, 2)) == 2
    live.process.terminate()
    with pytest.raises(DeviceError, match=r"closed|gone"):
        _collect(pair, 1)
    live.process.join(30.0)
    with pytest.raises(DeviceError, match="no simulated camera listens"):
        live.line.fire(_plan(1))
    pair.close()


@pytest.mark.realtime
def test_a_server_that_cannot_start_says_so(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="did not open"):
        start_camera_server(_config(tmp_path / "missing", time.monotonic_ns()))


@pytest.mark.slow
def test_a_slow_client_holds_up_images_but_not_the_shutters(server: CameraServer) -> None:
    line, pair = SimTriggerLine(server.config.line_path), SimCameraPair(server.config.frames_path)
    server.step()
    for shot in range(12):
        line.pulse(shot, server.config.start_host_ns + 20_000_000 + 30_000_000 * shot)
        for _ in range(3):
            server.step()
    assert server.counters["shots"] == 12
    assert server.counters["sent"] + 2 * server.counters["dropped"] + 4 + 1 >= 24  # the rest waits: 2 shots, 1 image
    frames = _served(server, pair, 24 - 2 * server.counters["dropped"])
    assert frames[-1].sequence == 11
    line.close()
    pair.close()

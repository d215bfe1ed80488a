"""A process of the service dies: it is started again, and what a ground station had set is still in force."""

from __future__ import annotations

import errno
import os
import select
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.component.parameter_server import ParameterServer
from companion.adapters.triggers.process import TriggerLink, line_pair
from companion.adapters.triggers.wire import Realtime, pack_report
from companion.errors import DeviceError, LinkDown, LinkError
from companion.lifetime import SharedCount, StopFlag
from companion.params.files import load_airframe
from companion.params.persist import load_stored
from companion.params.settings import Settings
from companion.records import ClockName, Frame, MatchSet, Shot, Side, TriggerPlan
from companion.service import wiring
from companion.service.channel import channel
from companion.service.config import ServiceConfig
from companion.service.supervisor import Supervisor
from companion.service.wiring import Service, resumed
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.simulated_service import SimulatedService
from sitl_tests.ports import free_port

US = 191


def test_only_live_changes_since_the_start_are_taken_up_again() -> None:
    settings = Settings().replace("RNG_MAX", 80.0)  # by the command line, over the 90 that a ground station had set
    now = {"RNG_MAX": 90.0, "TRG_RATE": 7.0, "TRK_LAG": 0.3}
    after = resumed(settings, {"RNG_MAX": 90.0}, now)
    assert (after.max_range_m, after.trigger_rate_hz) == (80.0, 7.0)
    assert after.smoother_lag_s == Settings().smoother_lag_s, "acts from the next start of the service"
    assert resumed(settings, {"RNG_MAX": 90.0}, {"RNG_MAX": 100.0}).max_range_m == 100.0


def test_a_value_that_waits_for_the_next_start_is_shown_and_can_be_taken_back() -> None:
    """IMU_RATE was set from 333 to 200 in flight, and the inertial process then started anew."""
    stored: list[dict[str, float]] = []

    class Store:
        def keep(self, values: dict[str, float]) -> None:
            stored.append(values)

        def problems(self) -> list[str]:
            return []

    running = Settings().replace("IMU_RATE", 333.0)
    server = ParameterServer(running, Store(), {"IMU_RATE": 200.0}, pending={"IMU_RATE": 200.0})
    assert server.settings == running
    server.ask("IMU_RATE", 200.0, 0)
    assert stored == [], "no change"
    server.ask("IMU_RATE", 333.0, 0)
    assert stored == [{"IMU_RATE": 333.0}]


def test_a_trigger_that_cannot_be_opened_ends_its_process_with_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_line(*_: Any) -> None:
        raise DeviceError("no GPIO chip /dev/gpiochip9")

    monkeypatch.setattr(wiring, "serve_trigger", no_line)
    config = ServiceConfig(load_airframe("nadir-2m"), Settings(), (), trigger=lambda: None)
    with pytest.raises(SystemExit, match="spanwise trigger: no GPIO chip"):
        wiring._trigger_process(config, line_pair()[0], StopFlag())


class Vehicle:
    """An autopilot that only beats, and a ground station, on the service's port."""

    def __init__(self, port: int) -> None:
        self.link: Any = mavutil.mavlink_connection(f"udpout:127.0.0.1:{port}", source_system=255)
        self.beats = mavlink.MAVLink(None, 1, 1)
        self.beat_s = 0.0

    def until(self, kind: str, fits: Callable[[Any], bool], within_s: float, ask: Callable[[], None]) -> Any:
        """Ask twice a second until a message of ours fits."""
        ends = time.monotonic() + within_s
        while time.monotonic() < ends:
            if time.monotonic() - self.beat_s > 0.5:
                self.beat_s = time.monotonic()
                self.link.write(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(self.beats))
                ask()
            message = self.link.recv_match(type=kind, blocking=True, timeout=0.1)
            if message is not None and message.get_srcComponent() == US and fits(message):
                return message
        raise AssertionError(f"no such {kind} within {within_s} s")

    def set(self, name: str, value: float) -> None:
        self.link.mav.param_set_send(1, US, name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32)

    def read(self, name: str) -> None:
        self.link.mav.param_request_read_send(1, US, name.encode(), -1)


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture(params=[True, False], ids=["kept in a file", "kept nowhere"])
def service(request: pytest.FixtureRequest, tmp_path: Path, port: int) -> Iterator[Service]:
    config = ServiceConfig(
        airframe=load_airframe("nadir-2m"),
        settings=Settings(),
        connections=(f"udpin:127.0.0.1:{port}",),
        parameters=tmp_path / "parameters" if request.param else None,
        trigger=Deaf,
    )
    with Service(config) as running:
        yield running


class Deaf:
    """A trigger line that does nothing."""

    def fire(self, plan: TriggerPlan) -> Shot:
        return Shot(plan.plan_id, plan.command_host_ns, plan.command_host_ns)

    def close(self) -> None:
        pass


def test_a_full_temporary_folder_stops_no_service_that_keeps_its_parameters(
    port: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(**_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(tempfile, "TemporaryDirectory", full)
    links = (f"udpin:127.0.0.1:{port}",)
    service = Service(ServiceConfig(load_airframe("nadir-2m"), Settings(), links, parameters=tmp_path / "parameters"))
    service.stop()
    assert service._scratch is None


@pytest.mark.realtime
@pytest.mark.slow
def test_a_live_change_survives_the_death_of_the_inertial_process(service: Service, port: int, tmp_path: Path) -> None:
    vehicle = Vehicle(port)
    answer = vehicle.until("PARAM_VALUE", lambda m: m.param_id == "TRG_RATE", 90.0, lambda: vehicle.read("TRG_RATE"))
    assert answer.param_value == Settings().trigger_rate_hz
    vehicle.until("PARAM_VALUE", lambda m: m.param_value == 7.5, 30.0, lambda: vehicle.set("TRG_RATE", 7.5))
    file = (tmp_path if service._scratch is None else Path(service._scratch.name)) / "parameters"
    ends_s = time.monotonic() + 30.0
    while load_stored(file).values.get("TRG_RATE") != 7.5:
        assert time.monotonic() < ends_s, "the change was not stored"
        time.sleep(0.02)
    (worker,) = [worker for worker in service._workers if worker.name == "inertial"]
    assert worker.process is not None
    assert worker.process.pid is not None
    os.kill(worker.process.pid, signal.SIGKILL)
    worker.process.join(30.0)
    killed_s = time.monotonic()
    assert len(service.tend()) == 1
    while vehicle.link.recv_match(blocking=False) is not None:
        pass  # what was said before
    answer = vehicle.until("PARAM_VALUE", lambda m: m.param_id == "TRG_RATE", 90.0, lambda: vehicle.read("TRG_RATE"))
    print(f"answers again {time.monotonic() - killed_s:.2f} s after it was killed")
    assert answer.param_value == 7.5


def killed_and_back(service: Service, vehicle: Vehicle) -> float:
    """Kill the inertial process when its spare is prepared; the seconds until the ground station is answered again."""
    (worker,) = [worker for worker in service._workers if worker.name == "inertial"]
    ends = time.monotonic() + 120.0
    while worker.spare is None or not select.select([worker.spare.line], [], [], 0.1)[0]:
        assert time.monotonic() < ends, "no spare was made"
        service.rest(0.1)
        service.tend()
    assert worker.process is not None
    while vehicle.link.recv_match(blocking=False) is not None:
        pass  # what was said before
    killed_s = time.monotonic()
    worker.process.kill()
    while not (said := service.tend()):
        service.rest(0.25)
    assert "spare takes over" in said[0]
    while vehicle.link.recv_match(blocking=False) is not None:
        pass
    vehicle.until("PARAM_VALUE", lambda m: m.param_id == "TRG_RATE", 60.0, lambda: vehicle.read("TRG_RATE"))
    return time.monotonic() - killed_s


@pytest.mark.realtime
@pytest.mark.slow
def test_a_killed_inertial_process_is_missed_for_less_than_two_seconds(port: int) -> None:
    """And killed again, by the spare that was made meanwhile. What it takes to learn the wing anew comes on top."""
    connections = (f"udpin:127.0.0.1:{port}",)
    with Service(ServiceConfig(load_airframe("nadir-2m"), Settings(), connections, standby=True)) as service:
        vehicle = Vehicle(port)
        vehicle.until("PARAM_VALUE", lambda m: m.param_id == "TRG_RATE", 90.0, lambda: vehicle.read("TRG_RATE"))
        away_s = [killed_and_back(service, vehicle) for _ in range(2)]
        print("answered again after", away_s)
        assert max(away_s) < 2.0


NO_NODE = "/dev/no-such-node,921600"


def test_a_link_that_is_down_is_told_and_the_service_goes_on_without_it(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    airframe, settings = load_airframe("nadir-2m"), Settings()
    service = Service(ServiceConfig(airframe, settings, (f"udpin:127.0.0.1:{port}", NO_NODE)))
    monkeypatch.setattr(Supervisor, "tend", lambda _: [])  # no process is started
    (sentence,) = service.tend()
    assert "/dev/no-such-node: no such device" in sentence
    assert service.tend() == [], "said once"
    service.stop()
    with pytest.raises(LinkDown, match="no-such-node"):
        Service(ServiceConfig(airframe, settings, (NO_NODE,)))
    with pytest.raises(LinkError, match="baud rate"):
        Service(ServiceConfig(airframe, settings, (f"udpin:127.0.0.1:{port}", "/dev/no-such-node,fast")))


def test_the_inertial_process_starts_without_a_link_that_is_down(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    turns: list[list[Any]] = []
    monkeypatch.setattr(wiring.inertial, "run", lambda loop, _: turns.append(list(loop.autopilot.poll(0.01))))
    (_, matches), (shown, _) = channel(), channel()
    for connections in ((NO_NODE,), (NO_NODE, f"udpin:127.0.0.1:{port}")):
        config = ServiceConfig(load_airframe("nadir-2m"), Settings(), connections)
        stop: Any = threading.Event()
        wiring._inertial_process(config, {}, None, matches, None, shown, None, None, SharedCount(), None, stop)
    assert len(turns) == 2


def test_a_record_that_is_too_large_for_a_channel_is_dropped_alone() -> None:
    (sender, receiver) = channel()
    assert sender.send(bytes(1_000_000))
    assert not sender.send(bytes(1_100_000)), "its caller hears of it"
    assert sender.send("the next")
    assert [len(record) for record in receiver.receive()] == [1_000_000, len("the next")]
    sender.end.send(bytes(1_100_000))  # a sender of another making
    sender.send("the one after")
    assert receiver.receive() == ["the one after"]


class Flashes:
    """Two cameras that see one texture at three instants; then vision is told to end, as if it had died."""

    def __init__(self, stop: threading.Event) -> None:
        self._stop, self._left = stop, 3

    def poll(self, timeout_s: float) -> list[Frame]:
        del timeout_s
        if self._left == 0:
            self._stop.set()
            return []
        self._left -= 1
        texture = np.random.default_rng(self._left).integers(0, 255, (480, 640), dtype=np.uint8)
        t_ns = time.monotonic_ns()
        return [Frame(side, self._left, ClockName.HOST, t_ns, 2_000_000, 0, -1, texture) for side in Side]

    def close(self) -> None:
        pass


def test_pairs_are_numbered_on_when_vision_starts_anew() -> None:
    """Ranges, images and the demo's judge tell pairs apart by their numbers alone."""
    (updates_in, updates), (matches_in, matches) = channel(), channel()
    pair_ids = []
    for _ in range(2):
        stop: Any = threading.Event()
        config = ServiceConfig(
            airframe=load_airframe("nadir-2m"), settings=Settings(), connections=(), trigger=Deaf,
            cameras=lambda stop=stop: Flashes(stop),
        )  # fmt: skip
        wiring._vision_process(config, {}, updates, matches_in, None, None, stop)
        pair_ids += [record.pair_id for record in matches.receive() if isinstance(record, MatchSet)]
        time.sleep(0.01)
    updates_in.end.close()
    assert len(pair_ids) == len(set(pair_ids)) == 6


def test_a_trigger_without_realtime_priority_is_told_to_the_ground() -> None:
    run = SimulatedService(build_flight(load_airframe("nadir-2m"), 1, 3.0))
    sentences = [Realtime(False, True, True).sentence()]
    run.cameras.warnings = lambda: [sentences.pop()] if sentences else []  # type: ignore[method-assign]
    run.fly(2.0)  # the warning comes before the vehicle is known, and is kept until it is
    run.close()
    assert "real-time priority" in "".join(run.world.report()["statustexts"])


def test_what_was_not_granted_becomes_one_warning() -> None:
    ours, theirs = line_pair()
    link = TriggerLink(ours)
    theirs.send(pack_report(Realtime(True, True, True)))
    assert link.poll() == []
    assert link.warnings() == []
    theirs.send(pack_report(Realtime(False, True, True)))
    assert link.poll() == []
    (sentence,) = link.warnings()
    assert "real-time priority" in sentence
    assert link.warnings() == []
    theirs.close()
    link.close()

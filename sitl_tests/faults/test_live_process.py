"""The live process beside the service: parameters by the page, and its death, which nobody misses."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("foxglove", reason="the extra live is not installed")

from companion.live.config import LiveConfig
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.service.config import ServiceConfig
from companion.service.wiring import Service
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.live_client import LiveClient, ask, last_words
from sitl_tests.loop.simulated_service import SimulatedService
from sitl_tests.ports import free_port

pytestmark = [pytest.mark.realtime, pytest.mark.slow]


@pytest.fixture
def port() -> int:
    return free_port(socket.SOCK_STREAM)


@pytest.fixture
def service(tmp_path: Path, port: int) -> Iterator[Service]:
    config = ServiceConfig(
        airframe=load_airframe("nadir-2m"),
        settings=Settings(),
        connections=(f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}",),
        parameters=tmp_path / "parameters",
        live=LiveConfig("127.0.0.1", port, None, tmp_path),
    )
    with Service(config) as running:
        yield running


def retried(attempt: Callable[[], object], within_s: float = 120.0) -> object:
    """The first answer that is not empty, of something that takes its time to come up."""
    ends_s = time.monotonic() + within_s
    while time.monotonic() < ends_s:
        try:
            if answer := attempt():
                return answer
        except (OSError, json.JSONDecodeError):
            pass
        time.sleep(0.2)
    raise AssertionError("it never answered")


def parameter(port: int, name: str) -> float:
    about = json.loads(ask(port, "GET", "/about.json")[2])
    return float({row["name"]: row["value"] for row in about["parameters"]}[name])


def test_the_page_sets_a_parameter_and_the_live_process_may_die(service: Service, port: int) -> None:
    client = retried(lambda: LiveClient(port))
    assert isinstance(client, LiveClient)
    client.subscribe("/status/service", "/parameter")
    while True:  # the inertial process runs
        message = client.hear()
        if isinstance(message, tuple) and message[0] == "/status/service":
            break
    assert ask(port, "POST", "/parameters", {"name": "TRG_RATE", "value": 7.5})[0] == 202
    while not (isinstance(message, tuple) and message[0] == "/parameter"):
        message = client.hear()
    assert json.loads(message[2])["value"] == 7.5
    time.sleep(0.5)  # until it is stored
    (worker,) = [worker for worker in service._workers if worker.name == "live"]
    assert worker.process is not None
    worker.process.kill()
    worker.process.join(30.0)
    assert last_words(client) == [], "its death is not the service's end"
    assert ["process live ended" in sentence for sentence in service.tend()] == [True]
    assert service.failed() == []
    assert retried(lambda: parameter(port, "TRG_RATE")) == 7.5, "read anew from where it is kept"
    again = retried(lambda: LiveClient(port))
    assert isinstance(again, LiveClient)
    again.subscribe("/status/service")
    assert isinstance(again.hear(), tuple), "the producers send to the new process"
    for each in (client, again):
        each.close()


def test_the_end_of_the_service_is_said_to_all_who_look(service: Service, port: int) -> None:
    client = retried(lambda: LiveClient(port))
    assert isinstance(client, LiveClient)
    client.subscribe("/status/service")
    while not isinstance(client.hear(), tuple):
        pass
    about = json.loads(ask(port, "GET", "/about.json")[2])
    assert (about["kind"], about["has_images"]) == ("live", False), "it runs without cameras"
    assert 0 < about["began_host_ns"] < time.monotonic_ns()
    service.stop()
    assert last_words(client) == ["the service was stopped"]


def test_a_wish_of_the_page_passes_the_same_checks_as_a_ground_station_s() -> None:
    run = SimulatedService(build_flight(load_airframe("nadir-2m"), 1, 3.0))
    run.fly(0.5)
    run.autopilot.set_own_parameter("RNG_MAX", 90.0)
    run.autopilot.set_own_parameter("RNG_MIN", 95.0)
    run.autopilot.set_own_parameter("NOTHING", 1.0)
    run.fly(2.0)
    run.close()
    assert run.loop.state.settings.max_range_m == 90.0
    assert run.loop.state.settings.min_range_m == Settings().min_range_m
    texts = "".join(run.world.report()["statustexts"])
    assert "RNG_MIN 95 m must be below RNG_MAX 90 m" in texts
    assert "no parameter 'NOTHING'" in texts

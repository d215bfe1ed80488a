"""One spelling of links: what every command, mission and simulated vehicle takes, and what it becomes."""

from __future__ import annotations

import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.adapters.clocks import MonotonicClock
from companion.adapters.mavlink.link.link import open_link
from companion.cli.main import main
from companion.errors import LinkError
from companion.params.links import LinkAddress, LinkKind, parse_link
from companion.sim.vehicle.world import VehicleLink as VehicleLink
from mission_scripts.common.options import parser_for
from sitl_tests.ports import free_port


@pytest.mark.parametrize(
    ("spelling", "mavutil", "mavsdk"),
    [
        ("udpin:0.0.0.0:14550", "udpin:0.0.0.0:14550", "udpin://0.0.0.0:14550"),
        ("udpin://0.0.0.0:14550", "udpin:0.0.0.0:14550", "udpin://0.0.0.0:14550"),
        ("udp:0.0.0.0:14550", "udpin:0.0.0.0:14550", "udpin://0.0.0.0:14550"),
        ("udpout://rover.local:14550", "udpout:rover.local:14550", "udpout://rover.local:14550"),
        ("tcp:127.0.0.1:5760", "tcp:127.0.0.1:5760", "tcpout://127.0.0.1:5760"),
        ("tcpout://127.0.0.1:5760", "tcp:127.0.0.1:5760", "tcpout://127.0.0.1:5760"),
        ("tcpin://0.0.0.0:5760", "tcpin:0.0.0.0:5760", "tcpin://0.0.0.0:5760"),
        ("/dev/ttyAMA0,921600", "/dev/ttyAMA0,921600", "serial:///dev/ttyAMA0:921600"),
        ("/dev/ttyAMA0", "/dev/ttyAMA0,115200", "serial:///dev/ttyAMA0:115200"),
        ("serial:///dev/ttyUSB0:57600", "/dev/ttyUSB0,57600", "serial:///dev/ttyUSB0:57600"),
        ("serial:/dev/ttyUSB0,57600", "/dev/ttyUSB0,57600", "serial:///dev/ttyUSB0:57600"),
        ("serial:///dev/ttyUSB0", "/dev/ttyUSB0,115200", "serial:///dev/ttyUSB0:115200"),
    ],
)
def test_both_spellings_mean_the_same(spelling: str, mavutil: str, mavsdk: str) -> None:
    address = parse_link(spelling)
    assert (str(address), address.mavsdk_url) == (mavutil, mavsdk)


@given(st.sampled_from(list(LinkKind)), st.integers(1, 65535))
def test_what_is_written_is_read_again_in_either_spelling(kind: LinkKind, number: int) -> None:
    host = "/dev/serial/by-path/pci-0000:00:14.0" if kind is LinkKind.SERIAL else "10.0.0.7"
    address = LinkAddress(kind, host, number)
    assert parse_link(str(address)) == parse_link(address.mavsdk_url) == address


@pytest.mark.parametrize(
    "spelling",
    [
        "udpin:0.0.0.0:14550",
        "udpin://0.0.0.0:14550",
        "/dev/ttyUSB0,921600",
        "/dev/ttyUSB0",
        "serial:///dev/ttyUSB0:57600",
    ],
)
def test_a_link_of_nodes_that_cannot_sign_says_so(spelling: str) -> None:
    address = parse_link(f"{spelling},unsigned")
    assert parse_link(spelling).signed
    assert not address.signed
    assert str(address) == str(parse_link(spelling))


@pytest.mark.parametrize("spelling", ["udpin://14550", "tcp://:5760", "udpin://host:70000", "serial:///dev/ttyUSB0,x"])
def test_a_wrong_spelling_names_what_was_written(spelling: str) -> None:
    with pytest.raises(LinkError, match=spelling):
        parse_link(spelling)


def test_the_service_and_the_simulated_vehicle_meet_over_mavsdks_spelling() -> None:
    port = free_port()
    link, vehicle = open_link(f"udpin://127.0.0.1:{port}", MonotonicClock()), VehicleLink(f"udpout://127.0.0.1:{port}")
    try:
        vehicle.send([b"hello"])
        chunk = link.read()
        assert chunk is not None
        assert chunk.data == b"hello"
    finally:
        link.close()
        vehicle.close()


@pytest.mark.parametrize("spelling", ["udpin:0.0.0.0:14540", "udpin://0.0.0.0:14540"])
def test_missions_take_the_services_spelling(spelling: str) -> None:
    options = parser_for("climb_sweep", "").parse_args(["--connect", spelling])
    assert options.connect.mavsdk_url == "udpin://0.0.0.0:14540"


def test_a_mission_refuses_a_wrong_link_with_its_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        parser_for("climb_sweep", "").parse_args(["--connect", "14540"])
    assert ended.value.code == 2
    assert "'14540' is not a connection" in capsys.readouterr().err


def test_a_port_that_there_is_not_is_said_to_be_the_fault() -> None:
    with pytest.raises(LinkError, match="a port is at most 65535"):
        parse_link("udpin:0.0.0.0:99999")


def test_a_simulated_vehicle_says_that_its_port_is_taken_before_it_builds_the_flight(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("companion.cli.vehicle.build_flight", lambda *_args, **_words: pytest.fail("was built"))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        link = f"udpin:127.0.0.1:{taken.getsockname()[1]}"
        assert main(["vehicle", "--connect", link]) == 1
    assert f"cannot open {link}" in (error := capsys.readouterr().err)
    assert "give another HOST:PORT" in error

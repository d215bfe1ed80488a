"""The addresses that are printed can be opened by another device, and say where the token is."""

from __future__ import annotations

import ipaddress
import socket
from pathlib import Path

import pytest

from companion.cli.steps.live_view import say_where
from companion.live import config as live
from companion.live.config import LiveConfig
from companion.live.networks import list_networks, open_addresses

WIRED, WIRELESS, CONTAINERS = ("eth0", "192.168.1.20"), ("wlan0", "10.0.0.7"), ("docker0", "172.17.0.1")
TOKEN = "correct-horse-battery"


def test_an_address_that_means_every_network_becomes_those_of_this_computer() -> None:
    assert open_addresses("0.0.0.0", lambda _: [WIRED, CONTAINERS, WIRELESS]) == ["192.168.1.20", "10.0.0.7"]
    asked: list[int] = []
    assert open_addresses("::", lambda family: asked.append(family) or [("eth0", "fd00::2")]) == ["fd00::2"]  # type: ignore[func-returns-value]
    assert asked == [socket.AF_INET6]


@pytest.mark.parametrize(("host", "loopback"), [("0.0.0.0", "127.0.0.1"), ("::", "::1")])
def test_without_a_network_loopback_is_all(host: str, loopback: str) -> None:
    assert open_addresses(host, lambda _: []) == [loopback]
    assert open_addresses(host, lambda _: [CONTAINERS]) == [loopback]


@pytest.mark.parametrize("host", ["192.168.1.20", "127.0.0.1", "fd00::2", "pi.local"])
def test_an_address_that_was_asked_for_stays(host: str) -> None:
    assert open_addresses(host, lambda _: [WIRELESS]) == [host]


@pytest.mark.parametrize("family", [socket.AF_INET, socket.AF_INET6])
def test_this_computer_s_addresses_are_its_own(family: socket.AddressFamily) -> None:
    for name, address in list_networks(family):
        assert not ipaddress.ip_address(address).is_loopback
        assert name in {name for _, name in socket.if_nameindex()}
        with socket.socket(family, socket.SOCK_STREAM) as end:
            end.bind((address, 0))  # a stranger's cannot be bound


def test_every_address_is_printed_with_the_token_and_where_it_is_kept(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(live, "open_addresses", lambda _host: ["192.168.1.20", "10.0.0.7"])
    say_where(LiveConfig("0.0.0.0", 8770, TOKEN, tmp_path, Path.home() / ".local/state/spanwise/live-token"))
    said = capsys.readouterr().err
    assert f"live view: http://192.168.1.20:8770/?token={TOKEN}\n" in said
    assert f" http://10.0.0.7:8770/?token={TOKEN}\n" in said
    assert "0.0.0.0" not in said
    assert "(the token is in ~/.local/state/spanwise/live-token)" in said


def test_on_loopback_no_token_is_spoken_of(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    say_where(LiveConfig("127.0.0.1", 8770, TOKEN, tmp_path, tmp_path / "live-token"))
    assert capsys.readouterr().err == "live view: http://127.0.0.1:8770/\n"


def test_an_address_of_ipv6_stands_in_brackets(tmp_path: Path) -> None:
    assert LiveConfig("::1", 8770, None, tmp_path).urls == ["http://[::1]:8770/"]

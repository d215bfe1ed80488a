"""Who may look at the live view, and where it is served."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from companion.errors import ConfigError
from companion.live.access import COOKIE, Access
from companion.live.config import live_config, parse_address
from companion.live.requests import Request, parse_head

TOKEN = "correct-horse-battery"


def request(target: str = "/", **headers: str) -> Request:
    return Request("GET", target, {name.replace("_", "-"): value for name, value in headers.items()})


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:8765", "[::1]:8765"])
@pytest.mark.parametrize("origin", [None, "http://localhost:8080", "http://127.0.0.1:8765"])
def test_pages_and_programs_of_this_machine_need_no_token(host: str, origin: str | None) -> None:
    headers = {"host": host} | ({} if origin is None else {"origin": origin})
    assert Access(None, is_loopback=True).admits(request(**headers))


@pytest.mark.parametrize(
    "headers",
    [
        {"host": "127.0.0.1:8765", "origin": "https://evil.example"},  # a page that the operator's browser shows
        {"host": "evil.example:8765"},  # a name that was made to point here
        {"host": "127.0.0.1:8765", "origin": "null"},
        {"host": "127.0.0.1.evil.example"},
        {},
    ],
)
def test_strangers_are_kept_out_although_they_reach_loopback(headers: dict[str, str]) -> None:
    assert not Access(None, is_loopback=True).admits(request(**headers))
    assert not Access(TOKEN, is_loopback=True).admits(request(**headers))


@pytest.mark.parametrize(
    "by",
    [
        request(f"/?token={TOKEN}", host="10.0.0.7:8765"),
        request(host="10.0.0.7:8765", authorization=f"Bearer {TOKEN}"),
        request(host="10.0.0.7:8765", cookie=f"other=1; {COOKIE}={TOKEN}"),
        request(f"/?token={TOKEN}", host="127.0.0.1:8765", origin="https://app.foxglove.dev"),
    ],
)
def test_the_token_lets_in_from_anywhere(by: Request) -> None:
    assert Access(TOKEN, is_loopback=False).admits(by)
    assert not Access("another-token-altogether", is_loopback=False).admits(by)


def test_beyond_loopback_nobody_is_let_in_without_the_token() -> None:
    access = Access(TOKEN, is_loopback=False)
    assert not access.admits(request(host="127.0.0.1:8765"))
    assert not access.admits(request("/?token=", host="localhost"))


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1:9000", ("127.0.0.1", 9000)),
        (":9000", ("127.0.0.1", 9000)),
        ("9000", ("127.0.0.1", 9000)),
        ("0.0.0.0", ("0.0.0.0", 8765)),
        ("[::1]:9000", ("::1", 9000)),
        ("::1", ("::1", 8765)),
    ],
)
def test_an_address_is_a_host_and_a_port(text: str, address: tuple[str, int]) -> None:
    assert parse_address(text) == address


@pytest.mark.parametrize("text", ["127.0.0.1:http", "70000", "127.0.0.1:70000", "flight.mcap", "out/flight.mcap"])
def test_what_is_no_address_is_refused_in_a_sentence(text: str) -> None:
    with pytest.raises(ConfigError, match="HOST:PORT"):
        parse_address(text)


def test_a_token_is_made_beyond_loopback_and_kept_from_others(tmp_path: Path) -> None:
    file = tmp_path / "state" / "live-token"
    assert live_config("127.0.0.1:8765", tmp_path, file).token is None
    assert not file.exists()
    first = live_config("0.0.0.0:8765", tmp_path, file)
    assert first.token is not None
    assert len(first.token) >= 20
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert live_config("0.0.0.0:8765", tmp_path, file).token == first.token
    assert all(first.token in url for url in first.urls)
    local = live_config("127.0.0.1:8765", tmp_path, file)
    assert local.token == first.token, "a page of another origin may come with it"
    assert not [url for url in local.urls if first.token in url]


def test_a_token_that_can_be_guessed_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "live-token"
    file.write_text("1234\n")
    with pytest.raises(ConfigError, match="live-token"):
        live_config("0.0.0.0:8765", tmp_path, file)


NO_REQUESTS = (
    b"", b"GET", b"GET / FTP/1.0\r\n\r\n", b"GET http://x HTTP/1.1\r\n\r\n", b"\x16\x03\x01\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost : x\r\n\r\n", b"GET / HTTP/1.1\r\nnothing\r\n\r\n",
)  # fmt: skip


@pytest.mark.parametrize("head", NO_REQUESTS)
def test_what_is_no_request_is_none(head: bytes) -> None:
    assert parse_head(head) is None


@pytest.mark.parametrize("head", [b"GET / HTTP/1.1\r\nHost: [\r\n", b"GET //[x HTTP/1.1\r\nHost: localhost\r\n"])
def test_an_address_that_is_none_is_no_request(head: bytes) -> None:
    assert parse_head(head) is None

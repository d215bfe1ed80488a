"""The live view over real sockets: topics, parameters, recordings, and clients of every kind."""

from __future__ import annotations

import argparse
import http.client
import json
import socket
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="the extra live is not installed")

from companion.adapters.recordings.mcap.messages import message_of
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.cli.steps.live_view import read_live
from companion.errors import ConfigError
from companion.live.config import LiveConfig
from companion.live.door import listen
from companion.live.feed import ALWAYS, BIT, RECORDED
from companion.live.session import LiveSession, Subject
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import (
    ClockName,
    Frame,
    Health,
    Notice,
    ParameterChange,
    RawChunk,
    ServiceStatus,
    Shot,
    Side,
    Tick,
)
from sitl_tests.loop.live_client import LiveClient, Refused, ask

TOKEN = "correct-horse-battery"


@dataclass
class View:
    """A session, and what it asked of the service."""

    session: LiveSession
    port: int
    asked: list[tuple[str, float]] = field(default_factory=list)
    masks: list[int] = field(default_factory=list)


def make_view(folder: Path, token: str | None = None, *, can_set: bool = True, host: str = "127.0.0.1") -> View:
    config = LiveConfig(host, 0, token, folder)
    asked: list[tuple[str, float]] = []
    masks: list[int] = []
    subject = Subject(
        load_airframe("nadir-2m"),
        Settings(),
        "test",
        ask=(lambda name, value: asked.append((name, value))) if can_set else None,
        request_topics=masks.append,
    )
    listening = listen(config)
    port = listening.getsockname()[1]
    return View(LiveSession(config, subject, listening), port, asked, masks)


@pytest.fixture
def view(tmp_path: Path) -> Iterator[View]:
    made = make_view(tmp_path)
    yield made
    made.session.close()


def until(fits: Callable[[], bool], within_s: float = 20.0) -> None:
    ends_s = time.monotonic() + within_s
    while not fits():
        assert time.monotonic() < ends_s, "it never came to that"
        time.sleep(0.01)


def test_a_subscriber_gets_the_bytes_and_the_schema_of_a_recording(view: View) -> None:
    client = LiveClient(view.port)
    topics = ("/trigger/shot", "/mavlink/sent")
    client.subscribe(*topics)
    until(lambda: bool(view.masks) and view.masks[-1] == ALWAYS | BIT[Shot] | BIT[RawChunk])
    records = [Shot(4, 1_000, 1_250), RawChunk(130, 2_000, b"\xfd\x00")]
    for record in [Tick(5), RawChunk(0, 6, b"received, not asked for"), *records]:
        view.session.publish(record)
    heard = [client.hear() for _ in records]
    assert heard == [(topic, *message_of(record)) for topic, record in zip(topics, records, strict=True)]
    assert client.channels["/trigger/shot"]["schemaName"] == "spanwise.Shot"
    assert json.loads(client.channels["/trigger/shot"]["schema"])["properties"].keys() >= {"plan_id", "fired_host_ns"}
    client.close()
    until(lambda: view.masks[-1] == ALWAYS)


def test_images_go_out_as_jpeg_in_foxglove_s_own_message(view: View) -> None:
    client = LiveClient(view.port)
    client.subscribe("/camera/right")
    until(lambda: bool(view.masks) and bool(view.masks[-1] & BIT[Frame]))
    image = np.full((48, 64), 90, np.uint8)
    view.session.publish(Frame(Side.RIGHT, 3, ClockName.HOST, 5_000, 1_000, 0, 8, image))
    message = client.hear()
    assert isinstance(message, tuple)
    content = json.loads(message[2])
    assert client.channels["/camera/right"]["schemaName"] == "foxglove.CompressedImage"
    assert (content["format"], content["plan_id"], content["mid_exposure_ns"]) == ("jpeg", 8, 5_000)
    client.close()


def test_the_protocol_s_earlier_name_is_understood_and_a_strange_one_refused(view: View) -> None:
    client = LiveClient(view.port, "foxglove.websocket.v1")
    assert b"foxglove.websocket.v1" in client.answer
    client.close()
    with pytest.raises(Refused, match="400"):
        LiveClient(view.port, "mqtt")


def test_a_page_of_another_origin_gets_neither_websocket_nor_files(view: View) -> None:
    with pytest.raises(Refused, match="403"):
        LiveClient(view.port, Origin="https://evil.example")
    assert ask(view.port, "GET", "/about.json", Origin="https://evil.example")[0] == 403
    status, _, _ = ask(
        view.port, "POST", "/parameters", {"name": "RNG_MAX", "value": 90}, Origin="https://evil.example"
    )
    assert status == 403
    assert view.asked == []


def test_the_token_opens_everything_and_stays_as_a_cookie(tmp_path: Path) -> None:
    view = make_view(tmp_path, TOKEN)
    try:
        strange = {"Origin": "https://app.foxglove.dev"}
        with pytest.raises(Refused, match="403"):
            LiveClient(view.port, path="/?token=wrong", **strange)
        LiveClient(view.port, path=f"/?token={TOKEN}", **strange).close()
        status, headers, _ = ask(view.port, "GET", f"/?token={TOKEN}", **strange)
        assert status == 200
        cookie = headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        assert ask(view.port, "GET", "/about.json", Cookie=cookie.split(";")[0], **strange)[0] == 200
    finally:
        view.session.close()


def test_blueos_learns_who_this_is_and_a_person_is_asked_for_the_token(tmp_path: Path) -> None:
    """In the order in which BlueOS asks: the first page, then its entry; a person types the token then."""
    view = make_view(tmp_path, TOKEN, host="0.0.0.0")
    try:
        status, _, page = ask(view.port, "GET", "/")
        assert (status, b"<form" in page) == (200, True)
        status, _, entry = ask(view.port, "GET", "/register_service")
        assert (status, json.loads(entry)["name"]) == (200, "Spanwise")
        assert ask(view.port, "GET", "/about.json")[0] == 403
        with pytest.raises(Refused, match="403"):
            LiveClient(view.port, path="/register_service")
        status, headers, page = ask(view.port, "GET", f"/?token={TOKEN}")
        assert (status, b"<form" in page) == (200, False)
        cookie = headers["Set-Cookie"].split(";")[0]
        assert ask(view.port, "GET", "/register_service", Cookie=cookie)[2] == entry
    finally:
        view.session.close()


def test_a_parameter_is_checked_before_it_is_asked_for(view: View) -> None:
    assert ask(view.port, "POST", "/parameters", {"name": "RNG_MAX", "value": 90})[0] == 202
    for wish, words in (
        ({"name": "RNG_MAX", "value": 1e9}, "RNG_MAX"),
        ({"name": "NOTHING", "value": 1}, "no parameter"),
        ({"name": "RNG_MAX", "value": 5, "more": 1} | {"name": "RNG_MIN", "value": 99.0} | {}, None),
        ({"name": "RNG_MIN"}, "name and value"),
        ({"name": "RNG_MIN", "value": "nan"}, "finite"),
    ):
        status, _, body = ask(view.port, "POST", "/parameters", wish)
        if words is not None:
            assert (status, words in body.decode()) == (400, True), body
    assert view.asked[0] == ("RNG_MAX", 90.0)
    assert all(name in ("RNG_MAX", "RNG_MIN") for name, _ in view.asked)


def test_a_change_reaches_those_who_follow_and_those_who_come_later(view: View) -> None:
    client = LiveClient(view.port)
    client.subscribe("/parameter")
    until(lambda: bool(view.masks))
    view.session.publish(ParameterChange("RNG_MAX", 90.0, 7))
    assert client.hear() == ("/parameter", *message_of(ParameterChange("RNG_MAX", 90.0, 7)))
    about = json.loads(ask(view.port, "GET", "/about.json")[2])
    assert {row["name"]: row["value"] for row in about["parameters"]}["RNG_MAX"] == 90.0
    client.say({"op": "getParameters", "parameterNames": ["RNG_MAX"], "id": "q"})
    answer = client.hear()
    assert isinstance(answer, dict)
    assert [(each["name"], each["value"]) for each in answer["parameters"]] == [("RNG_MAX", 90.0)]
    client.say({"op": "setParameters", "parameters": [{"name": "RNG_MAX", "value": 50}], "id": "r"})
    answer = client.hear()
    assert isinstance(answer, dict)
    assert answer["parameters"][0]["value"] == 90.0, "the websocket changes nothing"
    assert view.asked == []
    client.close()


@pytest.mark.parametrize("said", ["[" * 4000, '{"on": "false"}', '{"on": 1}'])
def test_a_wish_that_is_none_is_refused(view: View, said: str) -> None:
    assert _posted(view.port, said)[0] == 400
    view.session.tend()
    assert json.loads(ask(view.port, "GET", "/recordings.json")[2])["on"] is False


def test_json_may_name_its_characters(view: View) -> None:
    assert _posted(view.port, '{"on": false}', "application/json; charset=utf-8")[0] == 202
    assert _posted(view.port, '{"on": false}', "text/plain")[0] == 405


def _posted(port: int, body: str, kind: str = "application/json") -> tuple[int, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.request("POST", "/record", body, {"Content-Type": kind})
    answer = connection.getresponse()
    read = answer.read()
    connection.close()
    return answer.status, read


def test_who_only_knocks_does_not_shut_the_owner_out(view: View) -> None:
    """Heads that never end, from the owner's own address and from another."""
    ends = []
    for number in range(90):
        end = socket.create_connection(
            ("127.0.0.1", view.port), timeout=20, source_address=(f"127.0.0.{2 + number % 8}", 0)
        )
        end.sendall(b"GET / HT")
        ends.append(end)
    for _ in range(20):
        ends.append(socket.create_connection(("127.0.0.1", view.port), timeout=20))
    assert ask(view.port, "GET", "/about.json")[0] == 200
    client = LiveClient(view.port)
    for end in ends:
        end.close()
    assert ask(view.port, "GET", "/about.json")[0] == 200
    client.close()


def test_a_replay_sets_nothing(tmp_path: Path) -> None:
    view = make_view(tmp_path, can_set=False)
    assert ask(view.port, "POST", "/parameters", {"name": "RNG_MAX", "value": 90})[0] == 409
    assert json.loads(ask(view.port, "GET", "/about.json")[2])["can_set"] is False
    view.session.close()


def test_what_was_said_before_is_there_for_who_comes_later(view: View) -> None:
    view.session.publish(Notice(4, "node_left clock restarted", 9))
    assert json.loads(ask(view.port, "GET", "/about.json")[2])["events"] == [[4, "node_left clock restarted", 9]]


def test_the_page_s_button_records_everything_and_the_file_can_be_fetched(view: View, tmp_path: Path) -> None:
    assert ask(view.port, "POST", "/record", {"on": True})[0] == 202
    view.session.tend()
    assert view.masks[-1] == ALWAYS | RECORDED, "the producers are told to send all but images"
    ticks = [Tick(1_000_000_000 * second) for second in range(1, 6)]
    for tick in ticks:
        view.session.publish(tick)
    ask(view.port, "POST", "/record", {"on": False})
    view.session.tend()
    (listed,) = json.loads(ask(view.port, "GET", "/recordings.json")[2])["files"]
    status, headers, body = ask(view.port, "GET", f"/recordings/{listed['name']}")
    assert (status, len(body)) == (200, listed["bytes"])
    assert listed["name"] in headers["Content-Disposition"]
    fetched = tmp_path / "fetched.mcap"
    fetched.write_bytes(body)
    recording = McapRecording(fetched)
    assert list(recording.records()) == ticks
    assert not recording.replayable, "its estimation began before it"


HIDDEN = (
    "/recordings/../secret", "/recordings/..%2fsecret", "/recordings/none.mcap", "/../main.js", "/page/main.js",
    "/__init__.py", "/session.py",
)  # fmt: skip


@pytest.mark.parametrize("path", HIDDEN)
def test_no_other_file_is_served(path: str, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("x")
    folder = tmp_path / "recordings"
    folder.mkdir()
    view = make_view(folder)
    assert ask(view.port, "GET", path)[0] == 404
    view.session.close()


JUNK = (
    b"\x16\x03\x01\x02\x00" * 40 + b"\r\n\r\n",
    b"GET / HTTP/1.1\r\nA: " + b"x" * 40_000,
    b"\r\n\r\n",
    b"POST /parameters HTTP/1.1\r\nHost: localhost\r\nContent-Length: 99999999\r\n\r\n",
    b"POST /record HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 2\r\n\r\n[]",
)


def test_hostile_bytes_end_their_own_connection_alone(view: View) -> None:
    for junk in JUNK:
        with socket.create_connection(("127.0.0.1", view.port), timeout=20) as end:
            end.sendall(junk)
            end.shutdown(socket.SHUT_WR)
            assert b" 202 " not in end.recv(4096)
    assert ask(view.port, "GET", "/about.json")[0] == 200


def test_a_client_that_never_reads_delays_nobody_else(view: View) -> None:
    asleep, awake = LiveClient(view.port), LiveClient(view.port)
    for client in (asleep, awake):
        client.subscribe("/status/service")
    until(lambda: len(view.masks) >= 2)
    last = 3_000
    for number in range(1, last + 1):
        counters = {f"counter {place}": number for place in range(200)}  # some 5 kB
        view.session.publish(ServiceStatus(number, Health.ACTIVE, "tracking", counters))
        if number % 100 == 0:
            while True:
                message = awake.hear()
                if isinstance(message, tuple) and message[1] == number:
                    break
    assert message[1] == last
    asleep.close()
    awake.close()


def test_a_taken_port_is_told_before_anything_starts(view: View, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="in use"):
        listen(LiveConfig("127.0.0.1", view.port, None, tmp_path))


def test_no_address_is_said_that_somebody_else_serves(
    view: View, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with pytest.raises(ConfigError, match="in use"):
        read_live(argparse.Namespace(live=f"127.0.0.1:{view.port}"), tmp_path / "flight.mcap")
    assert capsys.readouterr().err == ""


def test_a_websocket_s_frames_come_through_whole(view: View) -> None:
    """A message of half a megabyte passes the door in many pieces."""
    client = LiveClient(view.port)
    client.subscribe("/mavlink/received")
    until(lambda: bool(view.masks))
    chunk = RawChunk(0, 77, bytes(range(256)) * 2_000)
    view.session.publish(chunk)
    message = client.hear()
    assert isinstance(message, tuple)
    assert message[2][-len(chunk.data) :] == chunk.data
    assert struct.unpack_from("<I", message[2], 12)[0] == len(chunk.data)
    client.close()

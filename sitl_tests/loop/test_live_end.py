"""The end of a live view: those who look are told why nothing more comes, and the terminal stays quiet."""

from __future__ import annotations

import dataclasses
import json
import os
import pty
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("foxglove", reason="the extra live is not installed")

from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.cli.steps.live_view import live_session
from companion.live.about import ENDINGS, INTERRUPTIONS, ViewKind
from companion.live.config import LiveConfig
from companion.live.session import LiveSession, Subject
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, Frame, Health, ServiceStatus, Side, Tick
from sitl_tests.loop.live_client import LiveClient, ask, last_words
from sitl_tests.ports import free_port

ROOT = Path(__file__).resolve().parents[2]


@contextmanager
def watched(folder: Path, kind: ViewKind) -> Iterator[tuple[LiveSession, LiveClient, int]]:
    """A live view as a command serves it, and a client that follows its status."""
    masks: list[int] = []
    subject = Subject(load_airframe("nadir-2m"), Settings(), "test", kind=kind, request_topics=masks.append)
    config = LiveConfig("127.0.0.1", free_port(socket.SOCK_STREAM), None, folder)
    with live_session(config, subject) as session:
        assert session is not None
        client = LiveClient(config.port)
        client.subscribe("/status/service")
        while not masks:
            time.sleep(0.01)
        yield session, client, config.port


def status(number: int) -> ServiceStatus:
    return ServiceStatus(number, Health.ACTIVE, "tracking", {f"counter {place}": number for place in range(20)})


@pytest.mark.parametrize("kind", list(ViewKind))
def test_all_who_look_are_told_the_end_although_much_waits_for_them(kind: ViewKind, tmp_path: Path) -> None:
    with watched(tmp_path, kind) as (session, client, _):
        for number in range(1, 200):
            session.publish(status(number))
    assert last_words(client) == [ENDINGS[kind]]


@pytest.mark.parametrize("kind", list(ViewKind))
def test_what_is_stopped_before_its_end_does_not_claim_to_have_ended(kind: ViewKind, tmp_path: Path) -> None:
    def stopped() -> LiveClient:
        with watched(tmp_path, kind) as (_, client, _):
            holder.append(client)
            raise KeyboardInterrupt

    holder: list[LiveClient] = []
    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert last_words(holder[0]) == [INTERRUPTIONS[kind]]


def test_who_comes_after_the_end_learns_of_it(tmp_path: Path) -> None:
    with watched(tmp_path, ViewKind.REPLAY) as (session, _, port):
        assert json.loads(ask(port, "GET", "/about.json")[2])["ended"] == ""
        session.end()
        assert json.loads(ask(port, "GET", "/about.json")[2])["ended"] == "the recording has ended"


def test_the_facts_say_when_it_began(tmp_path: Path) -> None:
    with watched(tmp_path, ViewKind.REPLAY) as (session, _, port):
        assert json.loads(ask(port, "GET", "/about.json")[2])["began_host_ns"] is None
        session.begin(7_000)
        session.begin(8_000)
        assert json.loads(ask(port, "GET", "/about.json")[2])["began_host_ns"] == 7_000


QUIET = """
import sys, time
from pathlib import Path
from companion.live.about import ViewKind
from sitl_tests.loop.test_live_end import status, watched
with watched(Path(sys.argv[1]), ViewKind.LIVE) as (session, client, port):
    for number in range(1, 400):
        session.publish(status(number))
    client.break_off()
    for number in range(400, 800):
        session.publish(status(number))
    time.sleep(0.5)
"""


@pytest.mark.slow
def test_a_browser_that_is_closed_prints_nothing(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", QUIET, str(tmp_path)], cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "flight.mcap"
    about = dataclasses.replace(About.of(load_airframe("nadir-2m"), Settings()), part_number=2)  # nothing to compare
    writer = McapWriter(path, about)
    for number in range(1, 10):
        writer.write(Tick(number * 50_000_000))
    writer.close()
    return path


def replay_words(recording: Path, port: int) -> list[str]:
    command = f"from companion.cli.main import main; import sys; sys.exit(main(['replay', {str(recording)!r}, " \
              f"'--live', '127.0.0.1:{port}']))"  # fmt: skip
    return [sys.executable, "-c", command]


@pytest.mark.slow
def test_on_a_terminal_the_page_stays_until_ctrl_c(recording: Path) -> None:
    port = free_port(socket.SOCK_STREAM)
    ours, theirs = pty.openpty()
    replay = subprocess.Popen(
        replay_words(recording, port), cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
    )  # fmt: skip
    os.close(theirs)
    said = b""
    while b"until Ctrl-C" not in said:
        assert select.select([ours], [], [], 60.0)[0], said
        said += os.read(ours, 4096)
    assert b"the recording has ended; its page stays up" in said
    assert said.index(b"outputs sha256") < said.index(b"until Ctrl-C"), "the result is not held back"
    time.sleep(0.5)
    assert json.loads(ask(port, "GET", "/about.json")[2])["ended"] == "the recording has ended"
    replay.send_signal(signal.SIGINT)
    assert replay.wait(30.0) == 3, "as without a page: there is nothing to estimate in it"
    os.close(ours)


@pytest.mark.slow
def test_without_a_terminal_a_replay_ends_by_itself(recording: Path) -> None:
    done = subprocess.run(
        replay_words(recording, free_port(socket.SOCK_STREAM)), cwd=ROOT, env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 3
    assert "Ctrl-C" not in done.stderr


def test_a_recording_says_whether_images_may_be_in_it(recording: Path, tmp_path: Path) -> None:
    assert not McapRecording(recording).has_images
    with_images = tmp_path / "images.mcap"
    writer = McapWriter(with_images, About.of(load_airframe("nadir-2m"), Settings()))
    writer.write(Frame(Side.LEFT, 1, ClockName.HOST, 50_000_000, 1_000, 0, 1, np.zeros((4, 4), np.uint8)))
    writer.close()
    assert McapRecording(with_images).has_images
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[:-200])
    assert McapRecording(cut).has_images, "its end would have said"

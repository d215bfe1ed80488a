"""How `spanwise run` ends: on SIGTERM in time, when killed with its children, and with a sentence where none flies."""

from __future__ import annotations

import errno
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from companion.adapters.mavlink.vehicle.absence import Absence
from companion.adapters.recordings.mcap import recorder as recorder_room
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.mcap.recorder import keep_recording
from companion.adapters.recordings.mcap.recorder_client import RecorderClient, recorder_channel
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.cli.terminal.status_view import View
from companion.errors import RecordingError
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Health, Notice, Reject, ServiceStatus, Tick
from companion.service.supervisor import Supervisor
from sitl_tests.loop.ground_stations import S, TurnedClock
from sitl_tests.ports import free_port

ABOUT = About.of(load_airframe("nadir-2m"), Settings())
STALL_S = 0.3  # for which a busy machine may stop


class Flight:
    """A `spanwise run` of its own without a vehicle; its lines are gathered."""

    def __init__(self, folder: Path, *words: str) -> None:
        self.port = free_port()
        run = [sys.executable, "-c", "import sys; from companion.cli.main import main; sys.exit(main())", "run"]
        link = ["--connect", f"udpin:127.0.0.1:{self.port}", "--airframe", "nadir-2m", "--plain"]
        self.process = subprocess.Popen(
            [*run, *link, "--parameters", str(folder / "kept"), *words],
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)

    def until(self, fits: Callable[[], bool], within_s: float = 120.0) -> None:
        ends = time.monotonic() + within_s
        while not fits():
            assert time.monotonic() < ends, "".join(self.lines)
            assert self.process.poll() is None, "".join(self.lines)
            time.sleep(0.02)

    def says(self, words: str) -> bool:
        return any(words in line for line in self.lines)

    def ready(self) -> None:
        self.until(lambda: self.says("waiting for"))

    def children(self) -> list[int]:
        """Processes of the service, less the tracker that multiprocessing keeps."""
        return [pid for pid, line in processes_of(self.process.pid) if "spawn_main" in line]

    def end(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._reader.join(2.0)
        if self.process.stderr is not None:
            self.process.stderr.close()


def processes_of(parent: int) -> list[tuple[int, str]]:
    children = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                status = (entry / "stat").read_text().rpartition(")")[2].split()
                line = (entry / "cmdline").read_text()
            except OSError:
                continue
            if int(status[1]) == parent:
                children.append((int(entry.name), line))
    return children


def alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture
def fly(tmp_path: Path) -> Iterator[Callable[..., Flight]]:
    flights: list[Flight] = []

    def begin(*words: str) -> Flight:
        flights.append(Flight(tmp_path, *words))
        return flights[-1]

    yield begin
    for flight in flights:
        flight.end()


linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")


@linux
@pytest.mark.realtime
@pytest.mark.slow
def test_killing_the_service_ends_its_processes_and_frees_the_port(fly: Callable[..., Flight], tmp_path: Path) -> None:
    recording = tmp_path / "flight.mcap"
    flight = fly("--record", str(recording))
    flight.ready()
    flight.until(lambda: recording.exists() and recording.stat().st_size > 0)  # it says so before
    children = flight.children()
    assert len(children) >= 2, "inertial and recorder at least"
    flight.process.send_signal(signal.SIGKILL)
    flight.process.wait()
    killed_s = time.monotonic()
    while any(map(alive, children)):
        assert time.monotonic() - killed_s < 1.5 + STALL_S
        time.sleep(0.02)
    print(f"children gone {time.monotonic() - killed_s:.2f} s after their parent")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as again:
        again.bind(("127.0.0.1", flight.port))
    assert list(McapRecording(recording).records())


@linux
@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_service_within_three_seconds_and_finishes_the_recording(
    fly: Callable[..., Flight], tmp_path: Path, ending: signal.Signals
) -> None:
    flight = fly("--record", str(tmp_path / "flight.mcap"))
    flight.ready()
    asked_s = time.monotonic()
    for number in flight.children() if ending is signal.SIGHUP else ():  # a terminal that closes tells the group
        os.kill(number, ending)
    flight.process.send_signal(ending)
    assert flight.process.wait(10.0) == 0
    print(f"ended {time.monotonic() - asked_s:.2f} s after {ending.name}")
    assert time.monotonic() - asked_s < 3.0 + STALL_S
    recording = McapRecording(tmp_path / "flight.mcap")
    assert list(recording.records())
    assert recording.notices == []


@linux
@pytest.mark.realtime
@pytest.mark.slow
def test_a_full_disk_at_the_start_is_told_and_the_service_goes_on(fly: Callable[..., Flight], tmp_path: Path) -> None:
    """No process of the service may write a byte to a file, as on a full disk."""
    flight = fly("--record", str(tmp_path / "flight.mcap"))
    flight.until(lambda: bool(flight.children()))
    while not flight.says("not recording") and flight.process.poll() is None:
        for child in flight.children():
            resource.prlimit(child, resource.RLIMIT_FSIZE, (0, 0))
        flight.until(lambda: flight.says("not recording") or flight.says("waiting for"))
        time.sleep(0.05)
    assert flight.says("flight.mcap: cannot be written")
    time.sleep(1.0)
    assert not list(tmp_path.glob("*.mcap")), "no empty file stays"
    assert flight.process.poll() is None
    assert not flight.says("ended"), "".join(flight.lines)


@pytest.mark.realtime
@pytest.mark.slow
def test_without_a_vehicle_it_says_what_the_doctor_says_and_ends_3(fly: Callable[..., Flight]) -> None:
    flight = fly("--for", "15")
    flight.until(lambda: flight.says("no autopilot heartbeat: nothing arrives; check port, cable"))
    assert flight.process.wait(30.0) == 3


# ------------------------------------------------------------------------------------------ without processes


def test_silence_bytes_and_others_are_three_different_complaints() -> None:
    absence = Absence()
    assert absence.due(0, junk=False) is None
    nothing = absence.due(4 * S, junk=False)
    assert nothing is not None
    assert "nothing arrives" in nothing.text
    assert absence.due(20 * S, junk=False) is None
    bytes_come = absence.due(21 * S, junk=True)
    assert bytes_come is not None
    assert "baud rate?" in bytes_come.text
    absence.beat(255, 190)
    others = absence.due(22 * S, junk=True)
    assert others is not None
    assert "only 255/190 beat" in others.text
    assert absence.due(51 * S, junk=True) is None
    assert absence.due(53 * S, junk=True) is not None


def test_plain_lines_show_what_was_said_once_and_what_was_refused() -> None:
    view = View("flight")
    view.say("process vision ended (1); started again (try 1)", here=True)
    view.take(Notice(4, "process vision ended (1); started again (try 1)", 1))
    view.take(Notice(4, "no range: too few matches", 2))
    view.take(Notice(4, "no range: too few matches", 3))
    again = "no range: too few matches"
    assert view.sentences() == ["process vision ended (1); started again (try 1)", again, again]
    assert view.sentences() == []
    for counters, sentence in (
        ({str(Reject.CRC): 2, "samples left": 900}, f"refused: 2 {Reject.CRC}"),
        ({str(Reject.CRC): 2, "samples left": 999}, None),
        ({str(Reject.CRC): 5, str(Reject.STALE): 1}, f"refused: 3 {Reject.CRC}, 1 {Reject.STALE}"),
    ):
        view.take(ServiceStatus(1, Health.BOOT, "", counters))
        assert view.refusals() == sentence
    assert not view.began
    view.take(ServiceStatus(1, Health.STANDBY, ""))
    assert view.began


class FullDisk(McapWriter):
    """A file that takes its beginning and ``room`` records more."""

    room = 0

    def __init__(self, path: Path, about: About) -> None:
        super().__init__(path, about)
        self._left = type(self).room

    def write(self, record: Any) -> None:
        if self._left <= 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._left -= 1
        super().write(record)
        self.flush()


def record_on_a_full_disk(folder: Path, room: int = 0) -> tuple[int, float]:
    """A second of records into a recorder without room; how often it complained, and what a write cost at most, s."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorder_room, "_on_terminate", list)
        patch.setattr(recorder_room, "_TRY_AGAIN_S", 0.3)
        patch.setattr(recorder_room, "McapWriter", FullDisk)
        patch.setattr(FullDisk, "room", room)
        client_end, recorder_end = recorder_channel()
        client, said, longest_s = RecorderClient(client_end), [], 0.0
        thread = threading.Thread(target=keep_recording, args=(folder / "a.mcap", ABOUT, [recorder_end], said.append))
        thread.start()
        for number in range(100):
            begun_s = time.monotonic()
            client.write(Tick(number))
            longest_s = max(longest_s, time.monotonic() - begun_s)
            time.sleep(0.01)
        client.close()
        thread.join(5.0)
        assert not thread.is_alive()
        assert client.dropped == 0
        assert "No space left" in said[0]
    return len(said), longest_s


@pytest.mark.slow
@pytest.mark.parametrize("room", [0, 3])
def test_a_disk_that_fills_up_is_told_and_the_next_file_is_tried(room: int, tmp_path: Path) -> None:
    """A written file stays, an empty one does not, producers never wait, and the last one ends it."""
    said, longest_s = record_on_a_full_disk(tmp_path, room)
    assert said >= 2
    assert longest_s < STALL_S
    files = sorted(tmp_path.iterdir())
    if room == 0:
        assert files == []
    else:
        first = [record for record in McapRecording(tmp_path / "a.mcap").records() if isinstance(record, Tick)]
        assert first == [Tick(0), Tick(1), Tick(2)]
        assert all(file.stat().st_size for file in files)


def test_a_file_that_cannot_even_begin_does_not_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(McapWriter, "_begin", full)
    with pytest.raises(RecordingError, match="No space left"):
        McapWriter(tmp_path / "a.mcap", ABOUT)
    assert list(tmp_path.iterdir()) == []


def test_a_disk_on_which_nothing_can_be_removed_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read_only(*_: object) -> None:
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(recorder_room, "remove_oldest", read_only)
    monkeypatch.setattr(recorder_room, "_on_terminate", lambda: [signal.SIGTERM])
    _client, end = recorder_channel()
    said: list[str] = []
    keep_recording(tmp_path / "a.mcap", ABOUT, [end], said.append, keep_bytes=1000)
    assert said == [f"not recording: {tmp_path / 'a.mcap'}: Read-only file system"]


def _deaf(_: object) -> None:
    """A worker that hears neither the flag nor SIGTERM."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    while True:
        time.sleep(0.1)


@pytest.mark.realtime
@pytest.mark.slow
def test_workers_that_do_not_obey_are_ended_in_time() -> None:
    class Now:
        now_ns = staticmethod(time.monotonic_ns)
        sleep_until = staticmethod(lambda _: None)

    supervisor = Supervisor(Now())
    for name in ("one", "two", "three"):
        supervisor.add(name, _deaf)
    supervisor.add("recorder", _deaf, optional=True, last=True)
    with supervisor:
        time.sleep(2.0)
        began_s = time.monotonic()
    assert time.monotonic() - began_s < 3.0 + STALL_S
    assert not any(worker.alive() for worker in supervisor._workers)


def test_an_optional_worker_that_is_given_up_does_not_end_the_service(monkeypatch: pytest.MonkeyPatch) -> None:
    supervisor = Supervisor(TurnedClock())
    supervisor.add("recorder", print, optional=True)
    supervisor.add("inertial", print)
    for worker in supervisor._workers:
        worker.restarts = 99
    assert supervisor.failed() == ["inertial"]

"""The recorder process: nothing is lost in order, nobody waits, and what is dropped is told."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.mcap import recorder, writer
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.mcap.recorder import keep_recording
from companion.adapters.recordings.mcap.recorder_client import RecorderClient, RecorderReceiver, recorder_channel
from companion.adapters.recordings.mcap.writer import About
from companion.lifetime import SharedCount
from companion.numbered_files import free_path, remove_oldest
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, Frame, Notice, RawChunk, Side, Tick
from sitl_tests.unit.recordings_help import assert_equal

ABOUT = About.of(load_airframe("nadir-2m"), Settings())


def collect(end: socket.socket) -> list[object]:
    """Records that a recorder would write, until the producer ends."""
    outlet, records = RecorderReceiver(end), []
    while True:
        batch = outlet.receive()
        if batch is not None:
            records += batch.records
            if batch.last:
                return records


def frame(sequence: int) -> Frame:
    image = np.random.default_rng(sequence).integers(0, 256, (800, 1280), dtype=np.uint8)
    return Frame(Side.LEFT, sequence, ClockName.HOST, sequence, 1, 0, 0, image)


def test_everything_arrives_in_order_large_images_included() -> None:
    client_end, theirs = recorder_channel()
    client = RecorderClient(client_end)
    written = [frame(i) if i % 40 == 0 else Tick(i) for i in range(200)]
    got: list[object] = []
    reader = threading.Thread(target=lambda: got.extend(collect(theirs)))
    reader.start()
    for record in written:
        client.write(record)
    client.close()
    reader.join()
    assert client.dropped == 0
    assert len(got) == len(written)
    for before, after in zip(written, got, strict=True):
        assert_equal(before, after)


def test_a_recorder_that_takes_nothing_makes_nobody_wait_and_the_losses_are_counted() -> None:
    client_end, theirs = recorder_channel()
    client = RecorderClient(client_end, capacity_bytes=1 << 20)
    chunk = RawChunk(0, 1, bytes(10_000))
    start = time.perf_counter()
    for _ in range(1000):
        client.write(chunk)
    assert time.perf_counter() - start < 1.0, "writing waited for the recorder"
    client.close()
    outlet, received_count, reported_drops = RecorderReceiver(theirs), 0, 0
    theirs.setblocking(False)
    while True:
        try:
            batch = outlet.receive()
        except BlockingIOError:
            break
        if batch is not None:
            received_count, reported_drops = received_count + len(batch.records), reported_drops + batch.dropped
            if batch.last:
                break
    assert client.dropped > 800
    assert received_count + client.dropped == 1000
    assert reported_drops <= client.dropped


def test_a_dead_recorder_costs_the_records_and_nothing_else() -> None:
    client_end, theirs = recorder_channel()
    client = RecorderClient(client_end)
    theirs.close()
    for i in range(10):
        client.write(Tick(i))
    client.close()
    assert client.dropped == 10


def test_a_recorder_started_again_goes_on_with_the_next_whole_batch() -> None:
    client_end, theirs = recorder_channel()
    client = RecorderClient(client_end)
    client.write(frame(1))
    theirs.recv(1 << 20)  # the first packet of the first batch goes to a recorder that dies
    client.write(Tick(7))
    client_closing = threading.Thread(target=client.close)
    client_closing.start()
    got = collect(theirs)
    client_closing.join()
    assert Tick(7) in got
    assert not [record for record in got if isinstance(record, Frame)]


def test_an_existing_file_is_never_written_over(tmp_path: Path) -> None:
    assert free_path(tmp_path / "a.mcap") == tmp_path / "a.mcap"
    (tmp_path / "a.mcap").write_bytes(b"old")
    assert free_path(tmp_path / "a.mcap") == tmp_path / "a.2.mcap"
    (tmp_path / "a.2.mcap").write_bytes(b"old")
    assert free_path(tmp_path / "a.mcap") == tmp_path / "a.3.mcap"
    (tmp_path / "a.mcap").unlink()
    assert free_path(tmp_path / "a.mcap") == tmp_path / "a.3.mcap", "the newest has the highest number"
    for name in ("a.99999.mcap", "c.mcap", "c.999999999.mcap"):
        (tmp_path / name).write_bytes(b"old")
    for name in ("a.mcap", "c.mcap") * 3:
        path = free_path(tmp_path / name)
        assert not path.exists()
        path.write_bytes(b"new")
    (tmp_path / "b.mcap").mkdir()
    assert free_path(tmp_path / "b.mcap") == tmp_path / "b.2.mcap"


def test_a_file_with_a_date_in_its_name_is_somebodys_own(tmp_path: Path) -> None:
    for name in ("flight.20261130.mcap", "flight.mcap", "flight.2.mcap"):
        (tmp_path / name).write_bytes(b"old")
    remove_oldest(tmp_path / "flight.mcap", 0)
    assert [path.name for path in tmp_path.iterdir()] == ["flight.20261130.mcap"]


def test_a_long_recording_goes_on_in_parts_and_the_oldest_make_room(tmp_path: Path) -> None:
    path, keep_bytes, others = tmp_path / "a.mcap", 400_000, ("ab.mcap", "a.note", "a.2.txt")
    for name in others:
        (tmp_path / name).write_bytes(bytes(1_000_000))
    path.write_bytes(bytes(300_000))  # of the flight before
    client_end, theirs = recorder_channel()
    client, random = RecorderClient(client_end), np.random.default_rng(1)
    said: list[str] = []
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}

    def produce() -> None:
        for i in range(600):  # 2 KB that cannot be compressed, 0.1 s of recorded time each
            client.write(RawChunk(0, i * 100_000_000, random.bytes(2000)))
            time.sleep(0.001)
        client.close()

    producer = threading.Thread(target=produce)
    producer.start()
    keep_recording(path, ABOUT, [theirs], said.append, None, keep_bytes)
    producer.join()
    for number, handler in handlers.items():
        signal.signal(number, handler)
    assert said == []
    assert client.dropped == 0
    parts = sorted(tmp_path.glob("a.*.mcap"), key=lambda file: int(file.name.split(".")[1]))
    assert int(parts[-1].name.split(".")[1]) >= 3, "1.2 MB are three times what is kept"
    assert sum(file.stat().st_size for file in parts[:-1]) <= keep_bytes
    assert not path.exists(), "the oldest is gone"
    stamps = [record.received_host_ns for file in parts for record in McapRecording(file).records()]
    assert stamps == list(range(stamps[0], 60_000_000_000, 100_000_000)), "nothing is missing between the parts"
    for file in parts:
        recording = McapRecording(file)
        assert not recording.cut
        assert recording.part_number > 1
        assert recording.complete
        assert not recording.replayable
        assert any("a replay estimates anew" in notice.text for notice in recording.notices)
    assert all((tmp_path / name).exists() for name in others), "only recordings of this name are ours to remove"


@pytest.mark.slow
def test_a_recording_reaches_the_disk_every_period_and_at_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, folders = tmp_path / "a.mcap", []
    on_disk_bytes: list[int] = []
    force = writer._force

    def forced(number: int) -> None:
        force(number)
        on_disk_bytes.append(os.fstat(number).st_size)

    monkeypatch.setattr(recorder, "_on_terminate", list)
    monkeypatch.setattr(writer, "_SYNC_PERIOD_NS", 100_000_000)
    monkeypatch.setattr(writer, "_force", forced)
    monkeypatch.setattr(writer, "sync_folder", folders.append)
    client_end, theirs = recorder_channel()
    client = RecorderClient(client_end)
    thread = threading.Thread(target=keep_recording, args=(path, ABOUT, [theirs], pytest.fail))
    began_s = time.monotonic()
    thread.start()
    for second in range(50):
        client.write(Tick(second * 1_000_000_000))
        time.sleep(0.02)
    client.close()
    thread.join()
    assert 3 <= len(on_disk_bytes) <= 10 * (time.monotonic() - began_s) + 2
    assert on_disk_bytes == sorted(on_disk_bytes)
    assert on_disk_bytes[-1] == path.stat().st_size
    assert folders == [tmp_path]


def test_a_recording_in_this_process_waits_for_no_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "_force", pytest.fail)
    tape = writer.McapWriter(tmp_path / "a.mcap", ABOUT)
    for second in range(3):
        tape.write(Tick(second * 1_000_000_000))
    tape.flush()
    tape.close()


def test_several_producers_share_one_file_and_drops_are_in_it(tmp_path: Path) -> None:
    channels = [recorder_channel() for _ in range(2)]
    clients = [RecorderClient(client_end) for client_end, _ in channels]
    for i in range(50):
        clients[0].write(Tick(i))
        clients[1].write(Notice(6, str(i), i))
    clients[1]._refused += 4  # as if four records had not fitted
    for client in clients:
        client.close()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    keep_recording(tmp_path / "two.mcap", ABOUT, [theirs for _, theirs in channels], pytest.fail)
    for number, handler in handlers.items():
        signal.signal(number, handler)
    recording = McapRecording(tmp_path / "two.mcap")
    records = list(recording.records())
    assert [record.now_host_ns for record in records if isinstance(record, Tick)] == list(range(50))
    assert [record.text for record in records if isinstance(record, Notice)] == [str(i) for i in range(50)]
    assert recording.dropped == 4
    assert not recording.replayable


@pytest.mark.parametrize(("successor", "started_before"), [(False, False), (True, False), (False, True)])
def test_a_flight_that_goes_on_in_new_processes_is_not_replayable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, successor: bool, started_before: bool
) -> None:
    """Estimation began anew in the middle of the file, or before it: no replay gives what was published."""
    monkeypatch.setattr(recorder, "_on_terminate", list)
    client_end, theirs = recorder_channel()
    client, parts = RecorderClient(client_end, successor=successor), SharedCount()
    if started_before:
        parts.next()
    client.write(Tick(1))
    client.close()
    keep_recording(tmp_path / "a.mcap", ABOUT, [theirs], pytest.fail, parts=parts)
    recording = McapRecording(tmp_path / "a.mcap")
    assert list(recording.records()) == [Tick(1)]
    assert recording.replayable is not (successor or started_before)
    assert bool(recording.notices) is (successor or started_before)


_PRODUCER = """
import sys, time
from pathlib import Path
from companion.adapters.recordings.mcap.recorder import keep_recording
from companion.adapters.recordings.mcap.recorder_client import RecorderClient, recorder_channel
from companion.adapters.recordings.mcap.writer import About
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Tick
import threading

mine, theirs = recorder_channel()
client = RecorderClient(mine)

def produce():
    i = 0
    while True:
        client.write(Tick(i * 10_000_000))
        i += 1
        if i == 500:
            print("five seconds of it written", flush=True)
        time.sleep(0.001)

threading.Thread(target=produce, daemon=True).start()
keep_recording(Path(sys.argv[1]), About.of(load_airframe("nadir-2m"), Settings()), [theirs], print)
"""


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("number", "least_ns", "cut"), [(signal.SIGKILL, 3_900_000_000, True), (signal.SIGTERM, 4_900_000_000, False)]
)
def test_a_killed_recorder_costs_a_second_and_a_terminated_one_nothing(
    tmp_path: Path, number: int, least_ns: int, cut: bool
) -> None:
    path = tmp_path / "killed.mcap"
    producer = subprocess.Popen([sys.executable, "-c", _PRODUCER, str(path)], stdout=subprocess.PIPE, text=True)
    assert producer.stdout is not None
    producer.stdout.readline()
    time.sleep(0.1)
    os.kill(producer.pid, number)
    producer.wait()
    producer.stdout.close()
    recording = McapRecording(path)
    stamps = [record.now_host_ns for record in recording.records() if isinstance(record, Tick)]
    assert stamps == [i * 10_000_000 for i in range(len(stamps))]
    assert stamps[-1] >= least_ns
    assert any("truncated at" in notice.text for notice in recording.notices) is cut

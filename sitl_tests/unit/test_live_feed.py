"""The producers' end of the live view: nobody looking costs nothing, and a view that never reads holds up nobody."""

from __future__ import annotations

import selectors
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.mcap.recorder_client import RecorderReceiver, recorder_channel
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.live.feed import ALWAYS, BIT, RECORDED, FeedEnd, ImagePace, Interest, LiveFeed
from companion.live.page_recording import PageRecording
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, Frame, Notice, ParameterChange, RawChunk, Record, Side, Tick, TriggerPlan
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.simulated_service import SimulatedService

MS = 1_000_000


@pytest.fixture
def feed() -> Iterator[tuple[LiveFeed, RecorderReceiver, Interest]]:
    interest = Interest()
    end, theirs = recorder_channel()
    feed = LiveFeed(FeedEnd(end, interest))
    yield feed, RecorderReceiver(theirs), interest
    feed.close()
    end.close()
    theirs.close()


def test_a_recording_of_the_page_reaches_the_disk_every_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    syncs: list[int] = []
    monkeypatch.setattr(McapWriter, "sync", lambda writer: syncs.append(writer.size_bytes))
    tape = PageRecording(tmp_path)
    tape.begin(About.of(load_airframe("nadir-2m"), Settings()))
    for second in range(4):
        tape.write(Tick(2_000 * second * MS))
    assert len(syncs) == 1, "as often as a disk may be asked"
    assert syncs[0] > 0
    tape.end()
    assert len(syncs) == 2, "and the whole file"


def received(receiver: RecorderReceiver, within_s: float) -> list[Record]:
    with selectors.DefaultSelector() as selector:
        selector.register(receiver, selectors.EVENT_READ)
        records: list[Record] = []
        while not records and selector.select(within_s):
            batch = receiver.receive()
            records += [] if batch is None else batch.records  # type: ignore[arg-type]
        return records


def test_while_nobody_looks_nothing_leaves_and_no_thread_runs(
    feed: tuple[LiveFeed, RecorderReceiver, Interest],
) -> None:
    live, receiver, _ = feed
    before = threading.active_count()
    for number in range(1000):
        live.write(Tick(number))
        live.write(RawChunk(0, number, b"x" * 100))
    assert threading.active_count() == before
    assert received(receiver, 0.2) == []


def test_what_is_rare_and_wanted_later_leaves_all_the_same(feed: tuple[LiveFeed, RecorderReceiver, Interest]) -> None:
    live, receiver, _ = feed
    said = Notice(4, "a sentence", 5)
    live.write(said)
    assert received(receiver, 10.0) == [said]


def test_only_kinds_that_somebody_looks_at_leave(feed: tuple[LiveFeed, RecorderReceiver, Interest]) -> None:
    live, receiver, interest = feed
    interest.mask = ALWAYS | BIT[Tick]
    live.write(RawChunk(0, 1, b"not looked at"))
    live.write(Tick(7))
    assert received(receiver, 10.0) == [Tick(7)]


def test_every_kind_has_a_bit_of_its_own() -> None:
    bits = [bit for kind, bit in BIT.items() if kind.__name__ != "FramePair"]
    assert len(set(bits)) == len(bits)
    assert all(bit.bit_count() == 1 for bit in bits)
    assert ALWAYS & BIT[ParameterChange]
    assert not RECORDED & BIT[Frame]
    assert max(bits) < 2**64


@pytest.mark.slow
def test_a_view_that_never_reads_costs_a_bounded_queue(feed: tuple[LiveFeed, RecorderReceiver, Interest]) -> None:
    live, _, interest = feed
    interest.mask = ALWAYS | RECORDED
    for number in range(40_000):
        live.write(RawChunk(0, number, bytes(2_000)))
    assert live.dropped > 0, "80 MB do not wait"


@pytest.mark.slow
def test_a_view_that_never_reads_changes_no_plan() -> None:
    """The same flight with everything looked at and nothing read, and without a live view."""
    flight = build_flight(load_airframe("nadir-2m"), 4, 4.0)
    plans = []
    for is_watched in (False, True):
        service = SimulatedService(flight)
        end, theirs = recorder_channel()
        interest = Interest()
        interest.mask = ALWAYS | RECORDED
        live = LiveFeed(FeedEnd(end, interest))
        write = service.tape.write

        def both(record: Record, live: LiveFeed = live, write=write) -> None:  # type: ignore[no-untyped-def]
            write(record)
            live.write(record)

        if is_watched:
            service.tape.write = both  # type: ignore[method-assign]
        service.fly(3.0)
        plans.append(service.tape.of(TriggerPlan))
        service.close()
        theirs.close()
        live.close()
    assert len(plans[0]) > 10
    assert plans[0] == plans[1]


def frame(side: Side, at_ms: float) -> Frame:
    return Frame(side, 0, ClockName.HOST, round(at_ms * MS), MS, 0, -1, np.zeros((4, 4), np.uint8))


@pytest.mark.parametrize("first", list(Side))
def test_two_pairs_of_images_pass_a_second_whichever_side_comes_first(first: Side) -> None:
    pace = ImagePace()
    second = Side(1 - first)
    passed = [
        (side, at_ms)
        for at_ms in range(0, 3000, 100)
        for side, late_ms in ((first, 0.0), (second, 0.3))
        if pace.take(frame(side, at_ms + late_ms))
    ]
    assert len(passed) == 12, "pairs at 0, 500 ... 2500 ms"
    times = [at_ms for _, at_ms in passed]
    assert times[::2] == times[1::2] == [0, 500, 1000, 1500, 2000, 2500]


def test_a_frame_without_a_partner_does_not_stop_the_images() -> None:
    pace = ImagePace()
    passed = [at_ms for at_ms in range(0, 2000, 100) if pace.take(frame(Side.LEFT, at_ms))]
    assert passed == [0, 500, 1000, 1500]

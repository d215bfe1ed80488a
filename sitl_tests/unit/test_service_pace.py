"""A machine that cannot keep up is told by name, with figures, as long as that lasts; and told again when it does."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from companion.core.pipeline import VisionState, start
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, Frame, Notice, Record, ServiceStatus, Side, Tick
from companion.service import vision
from companion.service.inertial import InertialLoop
from companion.service.pace import Overload, TickPace, VisionPace
from sitl_tests.manual_clock import ManualClock

MS = 1_000_000
SECOND = 1_000_000_000


def ticked(pace: TickPace, apart_ms: int, from_ms: int, for_ms: int) -> list[tuple[int, Overload]]:
    said = []
    for at_ms in range(from_ms, from_ms + for_ms, apart_ms):
        overload = pace.ticked(at_ms * MS)
        if overload is not None:
            said.append((at_ms, overload))
    return said


def test_ticks_on_time_or_a_single_stall_are_nothing_to_speak_of() -> None:
    pace = TickPace()
    assert ticked(pace, 10, 0, 10_000) == []
    assert ticked(pace, 10, 13_000, 10_000) == [], "three seconds without a turn, once: a neighbour's burst"


def test_a_loop_that_turns_at_a_third_of_its_rate_is_told_each_window_until_it_keeps_up() -> None:
    pace = TickPace()
    ticked(pace, 10, 0, 4_000)
    (at_ms, overload), *repeated = ticked(pace, 30, 4_000, 20_000)
    assert at_ms - 4_000 < 7_000
    assert "cannot keep up" in overload.sentence
    assert "every 30 ms" in overload.sentence
    assert len(repeated) >= 6, "a process that takes over must hear of it"
    better = ticked(pace, 18, 24_000, 10_000)
    assert better, "not clear of the limit"
    assert all(overload.text for _, overload in better)
    *_, (_, again) = ticked(pace, 10, 34_000, 10_000)
    assert again.text == ""
    assert "keeps up again: inertial" in again.sentence


def overloads(pace: VisionPace, spent_ms: int, apart_ms: int, lost: int, from_s: float, for_s: float) -> list[Overload]:
    """Shots every ``apart_ms``, of each pair made ``lost`` pairs skipped before it."""
    said, now_ms = [], from_s * 1e3
    while now_ms < (from_s + for_s) * 1e3:
        now_ms += max(spent_ms, apart_ms)
        pace.worked(spent_ms * MS, 1, 2 * lost, 700 * MS)
        said.append(pace.looked(round(now_ms * MS)))
    return [overload for overload in said if overload is not None]


def test_vision_that_has_time_to_spare_says_nothing_though_a_camera_loses_images() -> None:
    assert overloads(VisionPace(), 70, 125, 1, 0.0, 20.0) == []


def test_vision_that_is_at_work_all_the_time_tells_what_it_would_need() -> None:
    """Eight shots a second, 200 ms each: 1.6 s a second; three of eight are skipped."""
    pace = VisionPace()
    overloads(pace, 70, 125, 0, 0.0, 3.0)
    said = []
    now_ms = 3_000
    for k in range(100):
        now_ms += 200
        pace.worked(200 * MS, 1, (0, 2, 0, 2, 2)[k % 5], 900 * MS)
        said.append(pace.looked(now_ms * MS))
    overload, *repeated = [overload for overload in said if overload is not None]
    assert len(repeated) >= 6
    assert "vision needs 1.6 s a second" in overload.text
    assert "images wait 0.9 s" in overload.text
    assert "6 of 16 shots skipped" in overload.text
    assert [overload.text for overload in overloads(pace, 70, 125, 0, 23.0, 8.0)] == [""]


class SlowVision:
    """Matching takes 200 ms of the clock; the flag stops after so many pairs."""

    def __init__(self, clock: ManualClock, pairs: int) -> None:
        self.clock, self.left, self.number = clock, pairs, 0

    def poll(self, timeout_s: float) -> list[Frame]:
        del timeout_s
        self.number += 1
        image = np.zeros((480, 640), np.uint8)
        at_ns = self.number * 200 * MS
        return [Frame(side, self.number, ClockName.HOST, at_ns, MS, 0, -1, image) for side in Side]

    def is_set(self) -> bool:
        return self.number >= self.left

    def close(self) -> None: ...


def test_the_vision_process_sends_the_strain_to_the_inertial_one(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, sent = ManualClock(SECOND), list[Any]()
    cameras = SlowVision(clock, 40)

    def slow(state: VisionState, record: Frame, now_ns: int) -> list[Record]:
        clock.sleep_until(now_ns + 100 * MS)
        return []

    monkeypatch.setattr(vision, "vision_step", slow)
    state = VisionState.create(load_airframe("nadir-2m"), Settings())
    vision.run(state, cameras, clock, sent.append, None, cameras)  # type: ignore[arg-type]
    assert sent
    assert all(isinstance(overload, Overload) and overload.who == "vision" for overload in sent)


@dataclass
class Vehicle:
    """An autopilot that says nothing and hears everything."""

    clock: ManualClock
    turn_ms: int = 10
    heard: list[Record] = field(default_factory=list)

    def poll(self, timeout_s: float) -> list[Record]:
        self.clock.sleep_until(self.clock.now_ns() + self.turn_ms * MS)
        return []

    def publish(self, record: Record) -> None:
        self.heard.append(record)

    def close(self) -> None: ...


class Nothing:
    def send(self, plan: object) -> None: ...

    def poll(self) -> list[Any]:
        return []

    def warnings(self) -> list[str]:
        return []

    def close(self) -> None: ...


def test_the_operator_and_the_state_hear_of_it_and_the_recording_stays_what_a_replay_makes() -> None:
    clock = ManualClock(SECOND)
    vehicle, recorded, shown, inbox = Vehicle(clock), list[Record](), list[Record](), list[Any]()

    class Recorder(Nothing):
        def write(self, record: Record) -> None:
            recorded.append(record)

    def taken() -> list[Any]:
        said = inbox[:]
        inbox.clear()
        return said

    loop = InertialLoop(
        start(load_airframe("nadir-2m"), Settings()),
        vehicle,
        clock,
        Nothing(),
        taken,
        shown.append,
        Recorder(),  # type: ignore[arg-type]
    )

    def fly(seconds: int) -> list[str]:
        """Reasons of the states of these seconds."""
        before = len(shown)
        ends_ns = clock.now_ns() + seconds * SECOND
        while clock.now_ns() < ends_ns:
            loop.run_once()
        return [record.reason for record in shown[before:] if isinstance(record, ServiceStatus)]

    assert not any("keep up" in reason for reason in fly(4))
    vehicle.turn_ms = 40
    assert "cannot keep up: inertial turns every 40 ms" in fly(7)[-1]
    inbox.append(Overload("vision", "vision needs 1.6 s a second"))
    both = fly(2)[-1]
    assert "every 40 ms" in both
    assert "vision needs 1.6 s a second" in both
    inbox.append(Overload("vision", "vision needs 1.7 s a second"))
    assert "vision needs 1.7 s a second" in fly(2)[-1], "repeated, with the figures of now, and no second notice"
    vehicle.turn_ms = 10
    inbox.append(Overload("vision", ""))
    assert "keep up" not in fly(5)[-1]
    said = [record.text for record in vehicle.heard if isinstance(record, Notice) and "keep" in record.text]
    assert len(said) == 4, said
    inbox.append(Overload("vision", "vision needs 1.8 s a second"))
    assert "cannot keep up" in fly(2)[-1]
    assert "keep up" not in fly(10)[-1], "its process was started again, and has nothing to take back"
    states = [record for record in recorded if isinstance(record, ServiceStatus)]
    assert not any("keep up" in state.reason for state in states), "the recording must replay to what is in it"
    assert sum(isinstance(record, Tick) for record in recorded) > 500

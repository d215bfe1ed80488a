"""Asking for rates: one request at a time, less where denied, again where it falls back, and saying what to change."""

from __future__ import annotations

import itertools

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.vehicle.periodic_requests import ParameterReader, TimesyncTimer
from companion.adapters.mavlink.vehicle.rates import IntervalRequest, RateKeeper, needed_loop_rate_hz
from companion.records import ClockName

S, MS = 1_000_000_000, 1_000_000
RAW, HIGHRES = 27, 105
ACCEPTED, DENIED, FAILED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_FAILED


class Vehicle:
    """Answers like ArduPilot: whole milliseconds, nothing faster than 0.8 of its loop; may forget what it promised."""

    def __init__(self, loop_hz: float) -> None:
        self.loop_hz = loop_hz
        self.interval_ms: dict[int, int] = {}
        self.counts: dict[int, float] = {}

    def command(self, request: IntervalRequest) -> int:
        interval_ms = request.interval_us // 1000
        if interval_ms < int(1250 / self.loop_hz):
            return int(DENIED)
        self.interval_ms[request.message] = interval_ms
        return int(ACCEPTED)

    def run(self, seconds: float) -> None:
        for message, interval_ms in self.interval_ms.items():
            self.counts[message] = self.counts.get(message, 0.0) + seconds * 1000 / interval_ms


def fly(keeper: RateKeeper, vehicle: Vehicle, start_s: int, seconds: int) -> tuple[list[IntervalRequest], list[str]]:
    requests, texts = [], []
    for step in range(start_s * 20, (start_s + seconds) * 20):
        now = 1 + step * S // 20
        request = keeper.due(now)
        if request is not None:
            requests.append(request)
            keeper.acknowledged(vehicle.command(request), now)
        vehicle.run(0.05)
        if step % 20 == 0:
            keeper.verify({message: int(count) for message, count in vehicle.counts.items()}, now)
        texts += [notice.text for notice in keeper.notices()]
    return requests, texts


def test_a_fast_autopilot_is_asked_once_for_each_message() -> None:
    keeper, vehicle = RateKeeper({RAW: 333, HIGHRES: 333}), Vehicle(400)
    requests, texts = fly(keeper, vehicle, 0, 20)
    assert requests == [IntervalRequest(RAW, 3003), IntervalRequest(HIGHRES, 3003)]
    assert texts == []
    assert keeper.delivered_hz[RAW] == pytest.approx(333, rel=0.02)


@pytest.mark.parametrize("late_ms", [100, 350, 500, 1_000])
@pytest.mark.parametrize("lost", [(), (0,), (1, 2)])
def test_an_acknowledgement_is_that_of_its_own_message(late_ms: int, lost: tuple[int, ...]) -> None:
    """Over a slow radio a request is repeated before it is acknowledged; HIGHRES_IMU is not to be had at all."""
    keeper = RateKeeper({RAW: 333, HIGHRES: 333})
    on_the_way: list[tuple[int, int]] = []
    texts: list[str] = []
    asked = itertools.count()
    for now in range(1, 20 * S, 10 * MS):
        while on_the_way and on_the_way[0][0] <= now:
            keeper.acknowledged(on_the_way.pop(0)[1], now)
        request = keeper.due(now)
        if request is not None and next(asked) not in lost:
            result = FAILED if request.message == HIGHRES else ACCEPTED
            on_the_way.append((now + late_ms * MS, int(result)))
        texts += [notice.text for notice in keeper.notices()]
    assert texts
    assert all(text.startswith("HIGHRES_IMU: autopilot cannot") for text in texts)
    assert keeper._wanted[RAW].settled
    assert not keeper._wanted[HIGHRES].settled


def test_a_denied_rate_is_lowered_until_granted_and_the_loop_rate_is_told() -> None:
    keeper, vehicle = RateKeeper({RAW: 333}), Vehicle(50)
    keeper.loop_rate(50)
    requests, texts = fly(keeper, vehicle, 0, 5)
    assert vehicle.interval_ms == {RAW: 25}
    assert len(requests) == 2
    assert texts == ["RAW_IMU at 333 Hz denied: set SCHED_LOOP_RATE 400, reboot"]
    assert all(len(text) <= 50 or "SCHED" in text[:60] for text in texts)


def test_a_denied_rate_is_found_without_knowing_the_loop_rate() -> None:
    keeper, vehicle = RateKeeper({RAW: 333}), Vehicle(50)
    fly(keeper, vehicle, 0, 10)
    assert 25 <= vehicle.interval_ms[RAW] <= 32


def test_a_rate_that_falls_back_is_asked_for_again() -> None:
    keeper, vehicle = RateKeeper({RAW: 333}), Vehicle(400)
    fly(keeper, vehicle, 0, 5)
    vehicle.interval_ms[RAW] = 100
    requests, texts = fly(keeper, vehicle, 5, 4)
    assert requests == [IntervalRequest(RAW, 3003)]
    assert vehicle.interval_ms[RAW] == 3
    assert len(texts) == 1
    assert "asking again" in texts[0]


def test_a_rate_that_never_comes_is_asked_for_less_and_less_often_and_the_remedy_told_once() -> None:
    keeper, vehicle = RateKeeper({RAW: 333}), Vehicle(400)
    vehicle.run = lambda seconds: None  # type: ignore[method-assign]
    keeper.loop_rate(50)
    requests, texts = fly(keeper, vehicle, 0, 60)
    assert 4 <= len(requests) <= 12
    assert len(texts) == 2
    assert "SCHED_LOOP_RATE 400" in texts[1]


def test_an_answer_that_does_not_come_is_asked_for_again_with_pauses() -> None:
    keeper = RateKeeper({RAW: 333, HIGHRES: 333})
    asked = [keeper.due(step * 100 * MS) for step in range(1, 101)]
    assert 10 <= len([request for request in asked if request]) <= 30
    assert {request.message for request in asked if request} == {RAW, HIGHRES}


def test_a_message_that_the_autopilot_does_not_have_is_told_and_not_hammered() -> None:
    keeper = RateKeeper({HIGHRES: 333})
    texts = []
    for step in range(200):
        now = 1 + step * S // 10
        if keeper.due(now):
            keeper.acknowledged(FAILED, now)
        texts += keeper.notices()
    assert len(texts) == 1
    assert "HIGHRES_IMU" in texts[0].text


def test_after_a_reboot_everything_is_asked_for_again() -> None:
    keeper, vehicle = RateKeeper({RAW: 333}), Vehicle(50)
    fly(keeper, vehicle, 0, 3)
    keeper.restart(3 * S)
    vehicle.loop_hz = 400
    requests, _ = fly(keeper, vehicle, 3, 2)
    assert requests == [IntervalRequest(RAW, 3003)]


@pytest.mark.parametrize(("rate_hz", "loop_hz"), [(333, 400), (40, 50), (200, 250), (400, 500)])
def test_the_needed_loop_rate(rate_hz: float, loop_hz: int) -> None:
    assert needed_loop_rate_hz(rate_hz) == loop_hz


def test_time_is_asked_for_often_at_first_and_after_a_restart() -> None:
    timer = TimesyncTimer()
    asked = [step for step in range(20_000) if timer.due(1 + step * MS)]
    assert sum(step < 5000 for step in asked) == pytest.approx(100, abs=3)
    assert sum(10_000 <= step < 15_000 for step in asked) == pytest.approx(50, abs=2)
    timer.hurry(20 * S)
    assert sum(timer.due(20 * S + step * MS) for step in range(5000)) == pytest.approx(100, abs=3)


@pytest.mark.parametrize("loop_hz", [50, 300, 400, 1000])
def test_questions_come_at_every_phase_of_the_autopilots_loop(loop_hz: int) -> None:
    timer, phases, now = TimesyncTimer(), [], 1
    while len(phases) < 100:
        now = max(now, timer.next_host_ns)
        assert timer.due(now)
        phases.append(now * loop_hz % S / S)
    phases.sort()
    gaps = [b - a for a, b in itertools.pairwise([*phases, phases[0] + 1.0])]
    assert max(gaps) < 0.1, "of a hundred questions one comes within a tenth of the loop before its answer"


def test_an_answer_is_awaited_only_from_those_who_answer() -> None:
    timer, now = TimesyncTimer(), 1
    assert not timer.awaiting(now)
    assert timer.due(now)
    assert timer.awaiting(now + 5 * MS)
    timer.answered(ClockName.BOOT)
    assert not timer.awaiting(now + 5 * MS)
    awaited = 0
    for _ in range(20):
        now = max(now + 50 * MS, timer.next_host_ns)
        assert timer.due(now)
        awaited += timer.awaiting(now + 5 * MS)
        assert not timer.awaiting(now + 50 * MS)
    assert awaited == 5  # five requests without an answer, and it is waited for no more
    timer.answered(ClockName.BOOT)
    now = timer.next_host_ns
    assert timer.due(now)
    assert timer.awaiting(now + 5 * MS)


def test_missing_parameters_are_asked_for_a_few_times_then_left_until_the_next_round() -> None:
    reader = ParameterReader(("A", "B"))
    asked: list[str] = []
    for step in range(1, 2000):
        name = reader.due(step * 10 * MS)
        if name is not None:
            asked.append(name)
            if name == "A":
                reader.arrived("A")
    assert asked.count("A") == 1
    assert asked.count("B") == 5
    assert reader.due(31 * S) in ("A", "B")


def test_what_a_vehicle_has_does_not_wait_for_what_it_has_not() -> None:
    """PX4 answers for none of ArduPilot's names; its own stand behind them, and are asked for in the first round."""
    names = tuple(f"N{number}" for number in range(40))
    reader, asked = ParameterReader(names), []
    for step in range(1, 401):
        if (name := reader.due(step * 10 * MS)) is not None:
            asked.append(name)
    assert asked[:40] == list(names)
    assert len(asked) == 80, "one every 50 ms"


@pytest.mark.parametrize(
    ("loop_hz", "wanted_hz", "mode_hz", "remedy"),
    [
        (50, 333, 7.3, "set SCHED_LOOP_RATE 100, reboot"),
        (50, 333, 20.0, "set SCHED_LOOP_RATE 250, reboot"),
        (400, 50, 7.3, "set IMU_RATE 73, restart"),
    ],
)
def test_a_rate_too_low_for_the_mode_is_told_with_parameter_and_value(
    loop_hz: float, wanted_hz: float, mode_hz: float, remedy: str
) -> None:
    keeper, vehicle = RateKeeper({RAW: wanted_hz}, {RAW}), Vehicle(loop_hz)
    keeper.mode(mode_hz)
    keeper.loop_rate(loop_hz)
    _, texts = fly(keeper, vehicle, 0, 50)
    remedies = [text for text in texts if f"{mode_hz:.1f} Hz mode needs" in text]
    assert len(remedies) == 1
    assert remedies[0].endswith(remedy)
    _, texts = fly(keeper, vehicle, 50, 60)
    assert len([text for text in texts if "mode needs" in text]) == 1, "once a minute"


def test_a_rate_that_is_enough_for_the_mode_is_not_complained_of() -> None:
    keeper, vehicle = RateKeeper({RAW: 333.0}, {RAW}), Vehicle(50)
    keeper.mode(3.9)
    keeper.loop_rate(50)
    _, texts = fly(keeper, vehicle, 0, 30)
    assert not [text for text in texts if "mode needs" in text]
    slow = RateKeeper({RAW: 333.0}, ())
    slow.mode(20.0)
    _, texts = fly(slow, Vehicle(50), 0, 30)
    assert not [text for text in texts if "mode needs" in text], "attitude need not be as fast"


@pytest.mark.parametrize(
    ("integration_hz", "mode_hz", "remedy"), [(50, 7.3, "set IMU_INTEG_RATE 100, reboot"), (200, 7.3, "")]
)
def test_px4_is_not_asked_for_more_than_it_integrates(integration_hz: float, mode_hz: float, remedy: str) -> None:
    """It grants everything, and sends a mean for every interval of its integration."""
    keeper, vehicle = RateKeeper({RAW: 333.0}, {RAW}), Vehicle(10_000)
    keeper.mode(mode_hz)
    keeper.integration_rate(integration_hz)
    keeper.due(1)
    keeper.acknowledged(ACCEPTED, 1)
    vehicle.interval_ms[RAW] = round(1000 / integration_hz)
    requests, texts = fly(keeper, vehicle, 1, 40)
    assert requests == []
    assert [text.endswith(remedy) for text in texts] == ([True] if remedy else [])


def test_silence_is_no_slow_rate() -> None:
    keeper = RateKeeper({RAW: 333.0}, {RAW})
    keeper.mode(7.3)
    texts = []
    for second in range(1, 20):
        keeper.verify({}, second * S)
        texts += [notice.text for notice in keeper.notices()]
    assert not [text for text in texts if "mode needs" in text]


def test_an_ardupilot_in_the_place_of_a_px4_is_advised_by_its_own_parameter() -> None:
    keeper, vehicle = RateKeeper({RAW: 333}), Vehicle(50)
    keeper.integration_rate(200.0)
    keeper.loop_rate(50)
    _, texts = fly(keeper, vehicle, 0, 5)
    assert texts == ["RAW_IMU at 333 Hz denied: set SCHED_LOOP_RATE 400, reboot"]

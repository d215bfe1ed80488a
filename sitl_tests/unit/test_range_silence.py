"""Settings that leave nothing to publish are refused; a tracked wing without a range is told with its reason."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import pytest

from companion.cli.steps.options import read_settings
from companion.core.silence import RangeSilence
from companion.core.trigger.planner import Policy
from companion.errors import ConfigError
from companion.params.files import load_airframe
from companion.params.persist import store
from companion.params.settings import Settings
from companion.records import CorrectedRange, Firing, Health, Notice, Reject, Rejected, ServiceStatus, Shot, TriggerPlan
from companion.service.config import ServiceConfig
from companion.service.wiring import Service
from companion.sim.flight.flight import Flight, build_flight
from sitl_tests.loop.ground_stations import Air, Station
from sitl_tests.loop.simulated_service import EPOCH_NS, SimulatedService

S = 1_000_000_000
TICK_NS = 10_000_000


def refused(reason: Reject | None) -> CorrectedRange:
    return CorrectedRange(1, 1, 0, 25, 40.0, 0.1, 0.04, 0.0002, 20.0, 50, trusted=reason is None, reject=reason)


def plan(number: int, reject: Reject | None) -> TriggerPlan:
    """Due after its number's tenth of a second, and planned at the time of the one before."""
    due_ns = 100_000_000 * number
    firing = Firing.SKIP if reject else Firing.PEAK
    return TriggerPlan(number, firing, due_ns, due_ns, 0, 1.0, due_ns, due_ns - 100_000_000, reject)


def wait(silence: RangeSilence, seconds: float, begin_ns: int = 0, *, usable: bool = True) -> int:
    """Tick every 10 ms."""
    for now_ns in range(begin_ns, begin_ns + round(seconds * S) + TICK_NS, TICK_NS):
        silence.tick(now_ns, usable=usable)
    return begin_ns + round(seconds * S)


# ------------------------------------------------------------------------------------------ silence


def test_five_seconds_without_a_range_are_said_and_one_range_ends_it() -> None:
    silence = RangeSilence()
    now_ns = wait(silence, 4.9)
    assert silence.reason(Settings()) is None
    now_ns = wait(silence, 0.2, now_ns)
    assert silence.reason(Settings()) == "no range: no shot is planned"
    silence.note(refused(None))
    assert silence.reason(Settings()) is None


@pytest.mark.parametrize(
    ("records", "words"),
    [
        ([refused(Reject.NO_MATCHES)] * 3 + [refused(Reject.SIGMA_TOO_LARGE)], "too few matches (RNG_MATCHES)"),
        ([refused(Reject.OUT_OF_RANGE)], "range outside its limits (RNG_MIN, RNG_MAX)"),
        ([plan(k, Reject.BLUR_TOO_LARGE) for k in range(9)], "no shot: predicted blur too large (TRG_BLUR)"),
        ([plan(1, None), Shot(1, 0, 0)], "shots bring no image pairs"),
        ([plan(k, None) for k in range(9)], "nothing fires"),
        ([plan(k, Reject.BLUR_TOO_LARGE if k % 3 else None) for k in range(9)], "no shot: predicted blur too large"),
        ([Rejected(Reject.CLOCK_UNSYNCED, "camera frames", 0)], "clock not synced"),
        ([plan(1, None), Rejected(Reject.DEVICE_FAILED, "line is gone", 0)], "device failed: line is gone"),
    ],
)
def test_the_most_frequent_cause_is_named(records: list[Any], words: str) -> None:
    silence = RangeSilence()
    wait(silence, 6.0)
    for record in records:
        silence.note(record)
    assert words in str(silence.reason(Settings()))


def test_what_is_refused_before_the_tracker_is_ready_explains_nothing() -> None:
    silence = RangeSilence()
    now_ns = wait(silence, 10.0, usable=False)
    for number in range(100):
        silence.note(plan(number, Reject.NOT_SETTLED))
    wait(silence, 6.0, now_ns)
    assert silence.reason(Settings()) == "no range: no shot is planned"


def test_a_trigger_that_is_off_is_named() -> None:
    silence = RangeSilence()
    wait(silence, 6.0)
    off = Settings().replace("TRG_POLICY", float(Policy.OFF))
    assert silence.reason(off) == "no range: triggering is off (TRG_POLICY 2)"


def test_what_was_long_ago_explains_nothing() -> None:
    """A minute of blurred pairs, then half a minute of featureless water."""
    silence = RangeSilence()
    now_ns = 0
    for reason, seconds in ((Reject.SIGMA_TOO_LARGE, 60), (Reject.NO_MATCHES, 30)):
        for _ in range(seconds):
            silence.note(refused(reason))
            now_ns = wait(silence, 1.0, now_ns)
    assert "too few matches" in str(silence.reason(Settings()))


def test_a_flickering_tracker_does_not_hide_the_silence() -> None:
    silence = RangeSilence()
    now_ns = 0
    for _ in range(6):
        now_ns = wait(silence, 1.0, now_ns)
        now_ns = wait(silence, 0.5, now_ns, usable=False)
    assert silence.reason(Settings()) is not None


def test_it_is_repeated_calmly_and_a_new_reason_is_said_at_once() -> None:
    silence = RangeSilence()
    said = []
    now_ns = wait(silence, 6.0)
    for second in range(90):
        silence.note(refused(Reject.NO_MATCHES if second < 60 else Reject.OUT_OF_RANGE))
        reason = silence.reason(Settings())
        assert reason is not None
        text = silence.due(reason, Settings(), now_ns)
        said += [text] if text else []
        now_ns = wait(silence, 1.0, now_ns)
    assert 4 <= len(said) <= 7
    assert "too few" in said[0]
    assert "outside its limits" in said[-1]


def test_a_tracker_that_never_gets_ready_is_said_after_half_a_minute() -> None:
    silence = RangeSilence()
    now_ns = wait(silence, 29.0, usable=False)
    assert silence.due("inconsistent", Settings(), now_ns) is None
    now_ns = wait(silence, 2.0, now_ns, usable=False)
    assert silence.due("inconsistent", Settings(), now_ns) == "no range: inconsistent"


@pytest.fixture(scope="module")
def flight() -> Flight:
    return build_flight(load_airframe("nadir-2m"), 6, 21.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("RNG_MIN", 100.0, "outside its limits"),
        ("TRG_POLICY", 2.0, "triggering is off"),
        pytest.param("RNG_MATCHES", 100.0, "few", marks=pytest.mark.long),
    ],
)
def test_a_flight_without_ranges_is_not_active_and_the_ground_hears_why(
    flight: Flight, name: str, value: float, words: str
) -> None:
    service = SimulatedService(flight, settings=Settings().replace(name, value))
    tape = service.fly(20.0)
    service.close()
    statuses = tape.of(ServiceStatus)
    first = next(k for k, status in enumerate(statuses) if status.health is Health.ACTIVE)
    silent = [status for status in statuses[first:] if status.health is not Health.ACTIVE]
    assert silent
    assert silent[0].at_host_ns - statuses[first].at_host_ns <= 6 * S
    assert all(status.health is Health.STANDBY and words in status.reason for status in silent)
    assert words in " ".join(service.world.report()["statustexts"])
    assert [notice.text for notice in tape.of(Notice)] == [silent[0].reason], "once in these seconds"


@pytest.mark.slow
@pytest.mark.parametrize("cameras", [True, False])
def test_a_flight_with_ranges_and_one_without_cameras_stay_active(flight: Flight, cameras: bool) -> None:
    airframe = flight.airframe
    if not cameras:
        airframe = dataclasses.replace(airframe, left_camera=None, right_camera=None)
    service = SimulatedService(flight, airframe=airframe)
    tape = service.fly(20.0)
    service.close()
    active_ns = [status.at_host_ns for status in tape.of(ServiceStatus) if status.health is Health.ACTIVE]
    assert active_ns[-1] - active_ns[0] == pytest.approx((len(active_ns) - 1) * S, rel=0.02), "without a break"
    assert active_ns[-1] > EPOCH_NS + 18 * S


# ------------------------------------------------------------------------------------------ contradicting settings


def test_what_contradicts_is_refused_when_set_and_the_value_in_force_comes_back() -> None:
    station = Station()
    air = Air(station)
    air.run(2.0)
    for name, value, in_force in (("RNG_MAX", 5.0, 5.0), ("RNG_MIN", 100.0, 4.0), ("RNG_MIN", 5.0, 4.0)):
        station.set(name, value)
        air.run(1.0)
        assert station.values[name] == in_force
    station.set("RNG_MATCHES", 500.0)
    air.run(1.0)
    assert station.values["RNG_MATCHES"] == 12.0
    said = [record.text for record in air.records if isinstance(record, Notice)]
    assert any("RNG_MIN 100 m must be below RNG_MAX 5 m" in text for text in said)
    assert any("RNG_MATCHES" in text for text in said)


def test_a_stored_contradiction_is_told_once_and_the_defaults_are_used(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "kept"
    store(path, {"RNG_MIN": 100.0, "RNG_MAX": 5.0, "OUT_RATE": 5.0, "RNG_MATCHES": 500.0})
    settings = read_settings(argparse.Namespace(settings=None, parameters=path, changes=[]))
    assert settings == Settings().replace("OUT_RATE", 5.0)
    said = capsys.readouterr().err
    assert said.count("RNG_MIN 100 m must be below RNG_MAX 5 m") == 1
    assert said.count("RNG_MATCHES") == 1


def test_a_stored_value_gives_way_to_a_file_that_contradicts_it() -> None:
    values, problems = Settings().replace("RNG_MIN", 60.0).agreeing({"RNG_MAX": 50.0, "OUT_RATE": 5.0})
    assert values == {"OUT_RATE": 5.0}
    assert len(problems) == 1


def test_a_service_is_not_started_on_contradicting_settings() -> None:
    airframe = load_airframe("nadir-2m")
    for settings in (
        Settings().replace("RNG_MIN", 50.0).replace("RNG_MAX", 50.0),
        Settings().replace("SW_COMPID", float(airframe.left.source.component)),
    ):
        with pytest.raises(ConfigError, match=r"RNG_MIN|SW_COMPID"):
            Service(ServiceConfig(airframe, settings, ()))


def test_contradicting_options_end_in_one_sentence(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text("RNG_MIN = 50\nRNG_MAX = 40\n")
    with pytest.raises(ConfigError, match=r"settings.toml: RNG_MIN 50 m must be below RNG_MAX 40 m"):
        read_settings(argparse.Namespace(settings=file, changes=[]))
    with pytest.raises(ConfigError, match="must be below"):
        read_settings(argparse.Namespace(settings=None, changes=["RNG_MAX=5", "RNG_MIN=100"]))

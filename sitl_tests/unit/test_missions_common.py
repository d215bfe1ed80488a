"""The parts of the missions that need no vehicle: range monitor, guard, places, tap."""

from __future__ import annotations

import dataclasses
import itertools
import math
import time
from argparse import ArgumentTypeError
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from mission_scripts.common.flight import Flight
from mission_scripts.common.guard import Limits
from mission_scripts.common.legs import back_and_forth
from mission_scripts.common.monitor import RangeMonitor, Tolerance
from mission_scripts.common.options import limits_from, parser_for
from mission_scripts.common.outcome import Aborted, Exit, HandsOff, Response
from mission_scripts.common.places import Route, parse_place
from mission_scripts.common.recording import Tap
from mission_scripts.common.run import _fly, make_safe
from mission_scripts.common.vehicle import LOITER, RTL
from mission_scripts.common.watch import Range
from sitl_tests.unit.mission_cases import HERE, engaged, flying, guard, heard


def a_range(at_s: float, distance_m: float, height_m: float, *, trusted: bool = True, sigma_m: float = 0.1) -> Range:
    return Range(at_s, distance_m, sigma_m, trusted, height_m, HERE, 0.0)


def monitor() -> RangeMonitor:
    return RangeMonitor(lambda entry: entry.height_m, Tolerance())


# ------------------------------------------------------------------------------------------ range monitor


def test_a_good_descent_is_no_trouble() -> None:
    watched = monitor()
    for step in range(100):
        height_m = 60.0 - 0.4 * step
        watched.take(a_range(0.1 * step, height_m + 0.2 * math.sin(step), height_m))
        assert watched.trouble(0.1 * step + 0.05) == ""


def test_just_above_the_ground_ranges_may_end_but_not_fail() -> None:
    """From the least distance on nothing is trusted; a barometer that has drifted by 5 m says nothing there."""
    for height_m, ends in ((6.5, True), (15.0, False)):
        watched = monitor()
        near = dataclasses.replace(a_range(0.0, height_m, height_m + 5.0), least_m=4.0)
        watched.take(near)
        assert "is expected" in watched.trouble(0.1)
        assert watched.trouble(0.1, low=True) == ""
        for step in range(1, 20):
            watched.take(dataclasses.replace(near, at_s=0.1 * step, trusted=False))
        assert ("no trusted range" in watched.trouble(1.9, low=True)) is not ends
        assert "no trusted range" in watched.trouble(1.9)
        assert "stale" in watched.trouble(3.0, low=True)
        for at_s, distance_m in ((3.0, height_m), (3.1, height_m + 4.0)):
            watched.take(dataclasses.replace(near, at_s=at_s, distance_m=distance_m))
        assert "jumps" in watched.trouble(3.2, low=True)


def test_silence_distrust_jump_and_disagreement_are_told_apart() -> None:
    watched = monitor()
    assert "never" in watched.trouble(0.0)
    watched.take(a_range(0.0, 50.0, 50.0))
    assert watched.trouble(0.5) == ""
    assert "stale" in watched.trouble(0.7)
    for step in range(1, 20):
        watched.take(a_range(0.1 * step, 200.0, 50.0, trusted=False))
    assert "no trusted range" in watched.trouble(1.9)
    watched.take(a_range(2.0, 50.0, 50.0))
    assert watched.trouble(2.0) == ""
    watched.take(a_range(2.1, 53.0, 50.0))
    assert "jumps by +3.0" in watched.trouble(2.1)
    assert "jumps" in watched.trouble(2.3), "one look may come after several ranges"
    for step in range(40):
        watched.take(a_range(2.2 + 0.1 * step, 58.0, 50.0))
    assert "58.0 m where 50.0 m" in watched.trouble(6.1)


@given(sink_mps=st.floats(0.0, 8.0), period_s=st.floats(0.05, 1.0))
def test_a_fast_descent_is_no_jump(sink_mps: float, period_s: float) -> None:
    watched = monitor()
    for step in range(5):
        height_m = 80.0 - sink_mps * period_s * step
        watched.take(a_range(period_s * step, height_m, height_m))
    assert watched.trouble(4 * period_s) == ""


def test_a_turn_is_not_compared() -> None:
    """40 m below a bank of 40 degrees are 52 m along the axis; an attitude that comes late makes a jump of it."""
    watched = monitor()
    watched.take(a_range(0.0, 40.0, 40.0))
    watched.take(dataclasses.replace(a_range(0.1, 52.0, 40.0), tilt_rad=0.6))
    watched.take(a_range(0.2, 40.0, 40.0))
    assert watched.trouble(0.2) == ""


def test_an_uncertain_range_is_given_its_own_sigma() -> None:
    watched = monitor()
    watched.take(a_range(0.0, 60.0, 60.0, sigma_m=2.0))
    watched.take(a_range(0.1, 67.0, 60.0, sigma_m=2.0))
    assert watched.trouble(0.1) == ""
    sure = monitor()
    sure.take(a_range(0.0, 60.0, 60.0))
    sure.take(a_range(0.1, 67.0, 60.0))
    assert sure.trouble(0.1) != ""


# ------------------------------------------------------------------------------------------ guard


def test_a_flight_in_order_passes() -> None:
    guard(flying()).check()


@pytest.mark.parametrize(
    ("state", "limits", "response"),
    [
        ({"battery": 20}, {}, Response.RETURN),
        ({"height_m": 10.0}, {}, Response.RETURN),
        ({"height_m": 200.0}, {}, None),
        ({"status": 5}, {}, Response.RETURN),
        ({}, {"link_s": -1.0}, Response.RETURN),
    ],
    ids=["battery", "floor", "ceiling", "failsafe", "link"],
)
def test_each_limit_has_its_answer(state: dict[str, Any], limits: dict[str, float], response: Response | None) -> None:
    with pytest.raises(Aborted) as caught:
        guard(flying(**state), **limits).check()
    assert caught.value.response is response
    assert caught.value.code is Exit.ABORTED


@pytest.mark.parametrize("state", [{"mode": 5}, {"base": 89}], ids=["mode", "disarmed"])
def test_who_takes_over_is_left_alone(state: dict[str, Any]) -> None:
    with pytest.raises(HandsOff):
        guard(flying(**state)).check()


def test_an_unknown_battery_is_no_empty_one() -> None:
    guard(flying(battery=-1)).check()


def test_far_away_ends_it() -> None:
    watch = flying()
    heard(watch, "GLOBAL_POSITION_INT", lat=470200000, lon=80000000, relative_alt=60000, time_boot_ms=0)
    with pytest.raises(Aborted, match="from where the mission began"):
        guard(watch).check()


# ------------------------------------------------------------------------------------------ what is heard


def test_ranges_are_the_companion_s_own_and_of_the_right_orientation() -> None:
    watch = flying()
    fields = {"min_distance": 400, "max_distance": 20000, "current_distance": 6000, "covariance": 100,
              "signal_quality": 90, "time_boot_ms": 0}  # fmt: skip
    heard(watch, "DISTANCE_SENSOR", 1, orientation=25, **fields)
    heard(watch, "DISTANCE_SENSOR", 191, orientation=0, **fields)
    assert watch.newest_range() is None
    heard(watch, "DISTANCE_SENSOR", 191, orientation=25, **fields)
    newest = watch.newest_range()
    assert newest is not None
    assert (newest.distance_m, newest.sigma_m, newest.trusted) == (60.0, pytest.approx(0.1), True)
    for wrong in ({"signal_quality": 1}, {"current_distance": 20001}, {"current_distance": 300}):
        heard(watch, "DISTANCE_SENSOR", 191, orientation=25, **{**fields, **wrong})
        assert not watch.ranges[-1].trusted


@pytest.mark.parametrize(
    ("covariance", "quality", "named_m", "sigma_m"),
    [(100, 99, 6.0, 0.1), (255, 98, 1.1, 1.1), (255, 98, 6.0, 1.25), (255, 98, None, math.nan)],
)
def test_the_sigma_of_a_range_is_its_own(covariance: int, quality: int, named_m: float | None, sigma_m: float) -> None:
    """The value for graphs may be of a range that was not trusted; at 50 m a quality of 98 leaves 1 m, rounded."""
    watch = flying()
    if named_m is not None:
        watch.named["rng_sig_m"] = (time.monotonic(), named_m)
    heard(watch, "DISTANCE_SENSOR", 191, orientation=25, min_distance=400, max_distance=20000, current_distance=5000,
          covariance=covariance, signal_quality=quality, time_boot_ms=0)  # fmt: skip
    newest = watch.newest_range()
    assert newest is not None
    assert newest.sigma_m == pytest.approx(sigma_m, nan_ok=True)


def test_a_range_is_compared_at_its_own_instant() -> None:
    """Half a second at 2 m/s of sink and 20 m/s eastward is 1 m of height and 10 m of way."""
    watch = flying()
    heard(watch, "GLOBAL_POSITION_INT", lat=470000000, lon=80000000, relative_alt=50000, time_boot_ms=10_000,
          vx=0, vy=2000, vz=200)  # fmt: skip
    fields = {"min_distance": 400, "max_distance": 20000, "current_distance": 5000, "covariance": 100,
              "signal_quality": 90, "orientation": 25}  # fmt: skip
    heard(watch, "DISTANCE_SENSOR", 191, time_boot_ms=9_500, **fields)
    entry = watch.ranges[-1]
    assert entry.height_m == pytest.approx(51.0)
    assert entry.place.to(HERE) == pytest.approx((0.0, 10.0), abs=0.01)
    heard(watch, "DISTANCE_SENSOR", 191, time_boot_ms=900_000, **fields)
    assert watch.ranges[-1].height_m == pytest.approx(50.0), "a clock that is not the autopilot's carries nothing"


# ------------------------------------------------------------------------------------------ places and recordings


@given(north=st.floats(-2000, 2000), east=st.floats(-2000, 2000))
def test_a_place_and_back(north: float, east: float) -> None:
    assert HERE.to(HERE.offset(north, east)) == pytest.approx((north, east), abs=1e-6)


@given(bearing=st.floats(0, 360), ahead=st.floats(1, 1000), right=st.floats(-300, 300))
def test_right_of_the_bearing_is_right(bearing: float, ahead: float, right: float) -> None:
    north, east = HERE.to(HERE.toward(bearing, ahead, right))
    turned = math.radians(bearing)
    assert north * math.cos(turned) + east * math.sin(turned) == pytest.approx(ahead, abs=1e-6)
    assert east * math.cos(turned) - north * math.sin(turned) == pytest.approx(right, abs=1e-6)


def test_the_distance_from_a_leg_is_that_from_the_segment() -> None:
    route = Route()
    route.add(16, HERE, 50.0)
    number = route.add(16, HERE.offset(100.0, 0.0), 50.0)
    assert route.off_track_m(number, HERE.offset(50.0, 30.0)) == pytest.approx(30.0, abs=1e-6)
    assert route.off_track_m(number, HERE.offset(-40.0, 30.0)) == pytest.approx(50.0, abs=1e-3)
    assert route.off_track_m(1, HERE) is None, "nothing leads to the first item"


def test_legs_go_there_and_back_at_their_heights_and_end_in_a_circle() -> None:
    route, legs = back_and_forth(HERE, 90.0, 200.0, (40.0, 60.0, 80.0))
    assert [leg.height_m for leg in legs] == [40.0, 60.0, 80.0]
    ends = [(HERE.to(route.places[leg.item - 1]), HERE.to(route.places[leg.item])) for leg in legs]  # type: ignore[arg-type]
    for (start, end), way in zip(ends, (200.0, -200.0, 200.0), strict=True):
        assert end[1] - start[1] == pytest.approx(way, abs=1e-3)
        assert end[0] - start[0] == pytest.approx(0.0, abs=1e-3)
    assert route.items[-1].command == 17
    assert [item.seq for item in route.items] == list(range(len(route.items)))


@pytest.mark.parametrize("text", ["", "47", "47;8", "91,8", "47,190", "a,b", "nan,8"])
def test_a_place_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="is no place"):
        parse_place(text)


@pytest.mark.parametrize(
    "words",
    [
        *itertools.product(("--floor", "--ceiling", "--radius", "--off-track"), ("nan", "inf")),
        ("--ceiling", "-1"),
        ("--radius", "0"),
        ("--battery", "30"),
        ("--battery", "nan"),
        ("--link-loss", "nan"),
        ("--link-loss", "0"),
        ("--take-off", "nan"),
    ],
)
def test_a_limit_that_nothing_could_leave_is_refused(
    words: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        parser_for("climb_sweep", "").parse_args(["--connect", "udpin:127.0.0.1:0", *words])
    assert f"argument {words[0]}" in capsys.readouterr().err


def test_the_limits_of_a_usual_flight_are_taken() -> None:
    words = ["--floor=-20", "--ceiling=120", "--radius=800", "--off-track=40", "--battery=0.25", "--link-loss=1.5"]
    options = parser_for("climb_sweep", "").parse_args(["--connect", "udpin:127.0.0.1:0", *words])
    assert limits_from(options) == Limits(-20.0, 120.0, 800.0, 0.25, 1.5, 40.0)


def test_the_tap_s_file_is_a_tlog(tmp_path: Path) -> None:
    """Written by us, read by pymavlink."""
    packer = mavlink.MAVLink(None, 1, 1)
    tap = Tap(tmp_path / "flight.tlog")
    for number in range(50):
        tap.take(bytes(mavlink.MAVLink_raw_imu_message(number, 1, 2, 3, 4, 5, 6, 7, 8, 9).pack(packer)))
    tap.close()
    tap.take(b"too late")
    tap.close()
    log = mavutil.mavlink_connection(str(tmp_path / "flight.tlog"))
    stamps = []
    while (message := log.recv_match()) is not None:
        assert message.get_type() == "RAW_IMU"
        stamps.append(message._timestamp)
    log.close()
    assert len(stamps) == 50
    assert stamps == sorted(stamps)
    assert tap.counts == {(1, 27): 50}
    assert abs(stamps[0] - (tmp_path / "flight.tlog").stat().st_mtime) < 60.0


@pytest.mark.parametrize("frames", [1, 1000])
def test_a_full_disk_ends_the_tap_and_not_the_flight(frames: int) -> None:
    """As the buffer is written, or as late as the file is closed."""
    tap = Tap(Path("/dev/full"))
    for _ in range(frames):
        tap.take(b"\xfd" + bytes(80))
    tap.close()
    tap.close()
    assert tap.trouble == "No space left on device"


def test_a_mode_that_nobody_ordered_is_someone_elses_while_the_mode_is_being_changed() -> None:
    watching = guard(flying(mode=0))
    watching.mode, watching.changing = None, (10, 15)
    with pytest.raises(HandsOff, match="mode 0"):
        watching.check()
    for mode in (10, 15):
        changing = guard(flying(mode=mode))
        changing.mode, changing.changing = None, (10, 15)
        changing.check()


@pytest.mark.parametrize(("height_m", "mode"), [(60.0, LOITER), (4.0, RTL)])
def test_below_the_floor_an_aircraft_that_was_commanded_returns(height_m: float, mode: int) -> None:
    """A circle at four metres may meet the ground."""
    flight, orders = engaged(flying(height_m=height_m))
    assert _fly(flight, _broken) is Exit.ABORTED
    assert orders == [mode]
    assert any("OSError" in sentence for sentence in flight.said), "whatever the mission raises, the vehicle is safe"


def test_what_the_pilot_took_while_a_mode_was_changed_is_left_alone() -> None:
    flight, orders = engaged(flying(mode=0))
    flight.guard.mode, flight.guard.changing = None, (10, 15)
    assert make_safe(flight, Response.HOLD, Exit.ABORTED) is Exit.HANDS_OFF
    assert orders == []


def _broken(flight: Flight) -> Exit:
    raise OSError(28, "No space left on device")

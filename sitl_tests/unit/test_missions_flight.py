"""Take-off, ways and approach of the missions, without a link: what is refused, and how low they go."""

from __future__ import annotations

import math
import time
import types
from typing import Any

import pytest

from companion.params.files import load_airframe
from mission_scripts import calibrate_target, excite_wing, landing_approach, obstacle_pass
from mission_scripts.common.flight import Flight, Track
from mission_scripts.common.outcome import Aborted, Exit, Refused, Response
from mission_scripts.common.places import Place, Route
from mission_scripts.common.run import make_safe
from mission_scripts.common.vehicle import RTL
from mission_scripts.common.watch import Watch
from sitl_tests.unit.mission_cases import DISARM, HERE, engaged, flying, guard, heard

# ------------------------------------------------------------------------------------------ take-off


@pytest.mark.parametrize("height_m", [-5.0, 15.0, 22.0, 150.0])
def test_a_take_off_that_ends_outside_the_limits_is_refused(height_m: float) -> None:
    """At 0.9 of a height below 1.1 floors the mission would abort itself."""
    flight = _grounded(height_m)
    with pytest.raises(Refused, match="--take-off"):
        flight.be_airborne()
    assert not flight.engaged


def test_a_take_off_ends_above_the_floor() -> None:
    flight, (_, last) = _taken_off(23.0)
    assert not last(21.0)
    assert last(21.6)
    assert flight.guard.floor_m == 20.0


@pytest.mark.parametrize(
    ("height_m", "airspeed_mps", "finishes"), [(2.0, 15.0, True), (0.0, 0.0, False), (21.0, 15.0, False)]
)
def test_a_signal_in_a_low_take_off_aborts_it_at_its_end(height_m: float, airspeed_mps: float, finishes: bool) -> None:
    waits: list[str] = []

    def wait(what: str, until: Any, timeout_s: float, tell: Any = None) -> None:
        waits.append(what)
        if what == "take-off":
            heard(flight.watch, "GLOBAL_POSITION_INT", lat=470000000, lon=80000000, relative_alt=round(1e3 * height_m))
            heard(flight.watch, "VFR_HUD", airspeed=airspeed_mps)
            flight.guard.interrupted.set()
        flight.guard.check()

    flight = _grounded(40.0, wait)
    with pytest.raises(Aborted) as caught:
        flight.be_airborne()
    assert caught.value.code is Exit.INTERRUPTED
    assert ("take-off, then the abort" in waits) is finishes
    assert flight.guard.interrupted.is_set(), "the guard has its own signal back"


def test_a_low_battery_does_not_wait_for_the_end_of_a_take_off() -> None:
    waits: list[str] = []

    def wait(what: str, until: Any, timeout_s: float, tell: Any = None) -> None:
        waits.append(what)
        if what == "take-off":
            heard(flight.watch, "VFR_HUD", airspeed=15.0)
            heard(flight.watch, "SYS_STATUS", battery_remaining=10)
            flight.guard.check()

    flight = _grounded(40.0, wait)
    with pytest.raises(Aborted, match="battery") as caught:
        flight.be_airborne()
    assert caught.value.response is Response.RETURN
    assert waits[-1] == "take-off"


def _taken_off(height_m: float) -> tuple[Flight, list[Any]]:
    """A flight that has taken off, and for each of its last two waits whether it ends at a height."""
    ends: list[Any] = []

    def wait(what: str, until: Any, timeout_s: float, tell: Any = None) -> None:
        def at(above_m: float) -> bool:
            heard(flight.watch, "GLOBAL_POSITION_INT", lat=470000000, lon=80000000, relative_alt=round(1e3 * above_m))
            return bool(until())

        ends.append(at)

    flight = _grounded(height_m, wait)
    flight.be_airborne()
    return flight, ends[-2:]


def _grounded(height_m: float, wait: Any = None) -> Flight:
    """A flight that stands, and is to take off; what it waits for is the test's."""
    watch = flying(height_m=0.0)
    options: Any = types.SimpleNamespace(take_off=height_m)
    vehicle: Any = types.SimpleNamespace(**dict.fromkeys(("upload", "start"), lambda _: None), arm=lambda: None)
    nothing: Any = types.SimpleNamespace(say=lambda _: None)
    flight = Flight(options, nothing, watch, vehicle, guard(watch), nothing)
    flight.wait = wait  # type: ignore[method-assign]
    return flight


# ------------------------------------------------------------------------------------------ past an obstacle


@pytest.mark.parametrize(("north_m", "east_m"), [(900.0, 30.0), (460.0, 80.0), (400.0, 0.0)])
def test_a_way_to_the_start_that_passes_the_obstacle_is_refused(north_m: float, east_m: float) -> None:
    """From beyond the obstacle, from beside it, and from right before it."""
    flight = _ahead(HERE.offset(north_m, east_m))
    with pytest.raises(Refused, match="other side"):
        obstacle_pass.fly_past(flight)
    with pytest.raises(Refused, match="other side"):
        calibrate_target._mark(flight)
    assert not flight.engaged


def test_a_way_to_the_start_on_the_near_side_is_flown() -> None:
    flight = _ahead(HERE.offset(-200.0, 300.0))
    flight.need_clear_way(HERE, flight.options.obstacle, 30.0)


@pytest.mark.parametrize("item", [1, 2, 3])
def test_something_near_ahead_ends_the_flight_on_every_item(item: int) -> None:
    flight = _ahead(HERE)
    ahead = obstacle_pass.Ahead(flight, 3)
    heard(flight.watch, "MISSION_CURRENT", seq=item)
    _range_ahead(flight.watch, 40.0)
    ahead.check()
    _range_ahead(flight.watch, 8.0)
    with pytest.raises(Aborted, match="least 30 m") as caught:
        ahead.check()
    assert caught.value.response is Response.RETURN


@pytest.mark.parametrize(("name", "options"), [("forward-2m", {"ground": 0.0}), ("nadir-2m", {"mark": HERE})])
def test_a_target_that_the_pair_does_not_look_at_is_refused(name: str, options: dict[str, object]) -> None:
    """Ranges ahead held against the height over ground would write a mounting that the cameras do not have."""
    watch: Any = types.SimpleNamespace(newest_range=lambda: pytest.fail("no range is waited for"))
    chosen = types.SimpleNamespace(**{"ground": None, "still": None, "mark": None, **options})
    flight: Any = types.SimpleNamespace(airframe=load_airframe(name), options=chosen, watch=watch)
    with pytest.raises(Refused, match=rf"--{next(iter(options))} needs a pair that looks .* '{name}'"):
        calibrate_target.calibrate(flight)


def test_a_turn_needs_room_before_the_mark() -> None:
    with pytest.raises(SystemExit):
        calibrate_target.main(["--connect=udpin:127.0.0.1:1", "--mark=47,8", "--turn-off=49"])


def _ahead(place: Place) -> Any:
    """An aircraft in the air at a place, 450 m and more from an obstacle to the north of HERE."""
    watch = Watch(191, 0)
    fields = {"lat": round(place.latitude_deg * 1e7), "lon": round(place.longitude_deg * 1e7)}
    heard(watch, "GLOBAL_POSITION_INT", relative_alt=60_000, time_boot_ms=0, **fields)
    mark = HERE.offset(450.0, 0.0)
    options: Any = types.SimpleNamespace(
        obstacle=mark, mark=mark, bearing=0.0, aside=30.0, length=200.0, height=60.0, heights=[60.0], least=30.0,
        turn_off=60.0,
    )  # fmt: skip
    airframe: Any = types.SimpleNamespace(orientation=0)
    nothing: Any = types.SimpleNamespace(say=lambda _: None)
    flight = Flight(options, airframe, watch, nothing, guard(watch), nothing)
    for name in ("need_ranges", "be_airborne"):
        setattr(flight, name, lambda: None)
    return flight


def _range_ahead(watch: Watch, distance_m: float) -> None:
    heard(watch, "DISTANCE_SENSOR", 191, min_distance=400, max_distance=20000, current_distance=round(100 * distance_m),
          covariance=100, signal_quality=90, time_boot_ms=0, orientation=0)  # fmt: skip


# ------------------------------------------------------------------------------------------ on the track


@pytest.mark.parametrize(("east_m", "off_m"), [(100.0, None), (300.0, 300.0)])
def test_a_wide_circle_at_the_end_of_a_leg_is_on_the_track(east_m: float, off_m: float | None) -> None:
    """WP_LOITER_RAD 100 against a limit of 80; far from the circle's place it is off the track as ever."""
    watch, route = flying(), Route()
    route.add(16, HERE, 50.0)
    climbing = route.add(31, HERE.offset(400.0, 0.0), 70.0, 1.0)
    track = Track(route, watch, 80.0)
    heard(watch, "MISSION_CURRENT", seq=climbing)
    assert track.off_m() == pytest.approx(0.0, abs=0.1), "on the way there the leg counts"
    beside = HERE.offset(400.0, east_m)
    heard(watch, "GLOBAL_POSITION_INT", lat=round(beside.latitude_deg * 1e7), lon=round(beside.longitude_deg * 1e7))
    assert track.off_m() == pytest.approx(off_m, abs=0.1)


# ------------------------------------------------------------------------------------------ approach


def _lander(flight: Any, **options: Any) -> landing_approach.Lander:
    flight.options = types.SimpleNamespace(**{
        "aim": HERE, "bearing": 0.0, "slope": 5.0, "height": 80.0, "gate": 55.0, "decision": 20.0, "ground": 30.0,
        "terrain": False, "land": False, "stale": 0.6, "blind": 1.5, "jump": 2.0, "apart": 3.0, **options,
    })  # fmt: skip
    return landing_approach.Lander(flight)


def test_an_approach_is_flown_above_the_ground_and_not_above_home() -> None:
    flight, _ = engaged(flying())
    low, land, level = (_lander(flight, **options) for options in ({}, {"land": True}, {"ground": 0.0}))
    assert [item.z for item in low.route.items[1:]] == [110.0, 110.0, 50.0, 110.0, 110.0]
    assert low.floor_m == 42.0
    assert land.route.items[3].z == 30.0, "the field, 30 m above home"
    assert land.floor_m == 10.0
    assert low.route.places == level.route.places, "the same slope wherever the ground is"


def test_a_go_around_ends_at_the_gate_above_the_ground() -> None:
    flight, waits = engaged(flying(height_m=60.0))[0], {}
    lander = _lander(flight)
    flight.wait = lambda what, until, timeout_s: waits.update({what: until})
    flight.vehicle.fly_item = lambda item: None
    lander.go_around("no range")
    assert not waits["climb-out"](), "30 m above the ground, the gate is at 55 m"
    heard(flight.watch, "GLOBAL_POSITION_INT", lat=470000000, lon=80000000, relative_alt=86_000)
    assert waits["climb-out"]()


def test_heights_of_an_approach_are_held_to_the_ceiling_with_the_ground_below_them() -> None:
    with pytest.raises(SystemExit):
        landing_approach.main(["--connect=udpin:127.0.0.1:1", "--ground=80", "--height=80"])


@pytest.mark.parametrize(
    ("height_m", "airspeed_mps", "expected"), [(0.5, 0.0, [DISARM]), (0.5, 12.0, [RTL]), (8.0, 12.0, [RTL])]
)
def test_an_aircraft_that_stands_where_it_was_armed_is_disarmed(
    height_m: float, airspeed_mps: float, expected: list[int]
) -> None:
    """In RTL its motor would run as soon as somebody carries it."""
    watch = flying(height_m=height_m)
    heard(watch, "VFR_HUD", airspeed=airspeed_mps)
    flight, orders = engaged(watch)
    armed_here: Any = types.SimpleNamespace(armed_here=True, watch=watch)
    flight.stands = Flight.stands.fget(armed_here)  # type: ignore[attr-defined]
    assert make_safe(flight, Response.HOLD, Exit.INTERRUPTED) is Exit.INTERRUPTED
    assert orders == expected


@pytest.mark.parametrize(("item", "silent", "land", "hands_off"), [
    (3, True, True, True), (3, False, True, False), (2, True, True, False), (3, True, False, False),
])  # fmt: skip
def test_nothing_is_ordered_of_an_aircraft_that_lands_unseen(
    monkeypatch: pytest.MonkeyPatch, item: int, silent: bool, land: bool, hands_off: bool
) -> None:
    """It may stand when the link is back, and RTL would start its motor."""
    flight, _ = engaged(flying(height_m=40.0))
    lander = _lander(flight, land=land)
    heard(flight.watch, "MISSION_CURRENT", seq=item)
    if silent:
        monkeypatch.setattr(Watch, "age_s", lambda *_: 4.5)
    assert lander.lands_unseen is hands_off


def test_a_landing_is_over_where_the_autopilot_says_that_it_stands() -> None:
    """The barometer is 4 m off after the flight."""
    flight, _ = engaged(flying(height_m=34.0))
    lander, looked = _lander(flight, land=True), []
    heard(flight.watch, "MISSION_CURRENT", seq=3)

    def wait(what: str, until: Any, timeout_s: float) -> None:
        looked.append((until(), lander.committed))
        heard(flight.watch, "EXTENDED_SYS_STATE", landed_state=1)
        looked.append((until(), lander.committed))

    flight.wait = wait
    lander._look = lambda item: None  # type: ignore[method-assign]
    lander._until_landed({1: "to the initial point"})
    assert looked == [(False, False), (False, True)], "it still is armed"


@pytest.mark.parametrize(("height_m", "land", "ends"), [
    (45.0, True, True), (35.0, True, True), (32.0, True, False), (45.0, False, False),
])  # fmt: skip
def test_a_landing_is_watched_below_the_decision_height_until_it_is_committed(
    height_m: float, land: bool, ends: bool
) -> None:
    """The field is 30 m above home, the decision 20 m above the field: until there all was well."""
    flight, _ = engaged(flying(height_m=height_m))
    lander = _lander(flight, land=land)
    heard(flight.watch, "MISSION_CURRENT", seq=3)
    lander._decided = True
    flight.wait = lambda what, until, timeout_s: until()  # its ranges have fallen silent
    if ends:
        with pytest.raises(Aborted, match="range stale"):
            lander._until_landed({1: "to the initial point"})
    elif land:
        lander._until_landed({1: "to the initial point"})
    else:
        lander._look(3)
    assert lander.committed is (height_m < 33.0)


@pytest.mark.parametrize(("hdg", "heading_deg"), [(9_000, 90.0), (0, 0.0), (65_535, 270.0)])
def test_an_unknown_heading_is_that_of_the_attitude(hdg: int, heading_deg: float) -> None:
    """655.35 degrees were flown as a bearing of 295."""
    watch = flying()
    heard(watch, "GLOBAL_POSITION_INT", lat=470000000, lon=80000000, relative_alt=60_000, hdg=hdg)
    heard(watch, "ATTITUDE", roll=0.0, pitch=0.0, yaw=-math.pi / 2)
    assert watch.heading_deg == pytest.approx(heading_deg)


def test_terrain_is_carried_to_the_height_of_the_range() -> None:
    """A report at 60 m says 45 m; the range came 3 m lower."""
    watch = flying(height_m=60.0)
    heard(watch, "TERRAIN_REPORT", current_height=45.0, loaded=100, pending=0)
    assert watch.terrain_m(57.0) == pytest.approx(42.0)


# ------------------------------------------------------------------------------------------ the wing, watched


def _wing(bends_mm: list[float], silent_s: float = 0.0) -> excite_wing.Wing:
    """A wing that was heard to bend so after a doublet, and not since."""
    watch = flying()
    flight: Any = types.SimpleNamespace(watch=watch, options=types.SimpleNamespace(bend_limit=60.0))
    wing = excite_wing.Wing(flight)
    for bend_mm in bends_mm:
        for name, value in (("q_sym_mm", bend_mm), ("q_anti_mm", 0.0)):
            watch.named[name] = (time.monotonic(), value)
        wing.check()
    watch.named = {name: (at_s - silent_s, value) for name, (at_s, value) in watch.named.items()}
    return wing


def test_a_wing_that_is_watched_is_flown_no_faster_on_too_few_bends() -> None:
    growing = [5.0, 9.0, 13.0, 17.0, 21.0, 25.0, 30.0, 35.0, 40.0]
    assert _wing([]).decayed(18.0) == "recorded", "without the service nothing is known"
    assert _wing(growing).wants_more
    with pytest.raises(Aborted, match="9 bends were heard"):
        _wing(growing).decayed(18.0)
    with pytest.raises(Aborted, match="motion grows"):
        _wing([*growing, 45.0]).decayed(18.0)
    assert _wing([*growing[::-1], 4.0]).decayed(18.0).startswith("swings")


def test_a_service_that_ends_in_flight_ends_the_flight() -> None:
    _wing([5.0, 6.0], silent_s=1.5).check()
    with pytest.raises(Aborted, match="nobody watches the wing"):
        _wing([5.0, 6.0], silent_s=2.5).check()

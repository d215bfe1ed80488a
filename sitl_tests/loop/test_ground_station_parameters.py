"""Ground stations list, read, set and watch our parameters, over an air that loses a tenth of all frames."""

from __future__ import annotations

import math
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.decoder import Decoder
from companion.core.pipeline import start, step
from companion.params.files import load_airframe
from companion.params.persist import Keeper, load_stored
from companion.params.settings import Settings, Tunable, tunables
from companion.records import Notice, ParameterChange, RawChunk
from sitl_tests.loop.ground_stations import COMPANION, SYSTEM, Air, MavProxy, QGroundControl, Station

ROWS = list(tunables())
INT32 = mavlink.MAV_PARAM_TYPE_INT32


def of_kind(records: list, kind: type) -> list:
    return [record for record in records if isinstance(record, kind)]


@pytest.mark.parametrize("seed", range(8))
def test_a_station_that_never_asks_is_greeted_and_then_fetches_all_under_loss(seed: int) -> None:
    station = QGroundControl()
    air = Air(station, loss=0.1, seed=seed)
    air.until(station.complete, 40.0)
    assert station.values.keys() == {row.name for row in ROWS}
    assert [station.indices[index] for index in range(len(ROWS))] == [row.name for row in ROWS]
    assert station.types == {mavlink.MAV_PARAM_TYPE_REAL32}
    for row in ROWS:
        assert station.values[row.name] == np.float32(row.default)
    assert air.lost > 0


@pytest.mark.parametrize("seed", range(8))
def test_a_list_is_completed_under_loss(seed: int) -> None:
    station = MavProxy()
    air = Air(station, loss=0.1, seed=seed)
    station.greets = False
    air.run(1.0)
    station.fetch(air.clock.now)
    assert air.until(station.complete, 20.0) < 10.0
    assert station.values.keys() == {row.name for row in ROWS}


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("habit", [QGroundControl, MavProxy])
def test_every_live_parameter_can_be_set_to_both_ends_of_its_range_under_loss(habit: type, seed: int) -> None:
    station = habit()
    air = Air(station, loss=0.1, seed=seed)
    air.run(2.0)
    write = station.write if habit is QGroundControl else station.put
    below = {"RNG_MIN": next(row.minimum for row in ROWS if row.name == "RNG_MAX") - 0.5}  # or the two would contradict
    for value_of in (lambda row: row.minimum, lambda row: below.get(row.name, row.maximum)):
        for row in ROWS:
            write(row.name, value_of(row))
        air.run(6.0)
        in_force = air.pilot.component.parameters
        for row in [row for row in ROWS if row.live]:
            # a station that gave up after three lost tries knows it; nobody believes in a value that is not there
            if row.name in [entry[0] for entry in getattr(station, "writing", [])] + getattr(station, "failed", []):
                continue
            assert getattr(in_force.settings, row.attribute) == value_of(row), row.name
            assert station.values[row.name] == np.float32(value_of(row)), row.name


def test_without_loss_the_list_is_paced_and_complete_and_each_value_comes_once() -> None:
    station = Station()
    station.greets = False
    air = Air(station)
    air.run(1.0)
    station.ask_list()
    station.ask_list()
    took = air.until(station.complete, 5.0)
    assert took >= 0.8 * len(ROWS) * 0.025
    air.run(2.0)
    assert station.arrived == len(ROWS)


def test_a_flood_of_requests_is_answered_at_the_same_pace() -> None:
    station = Station()
    station.greets = False
    air = Air(station)
    air.run(1.0)
    for _ in range(50):
        for index in range(len(ROWS)):
            station.ask_index(index)
        station.ask_list()
        air.run(0.02)
    assert station.arrived <= 1.1 / 0.025
    air.run(3.0)
    assert station.complete()


def test_reading_by_name_and_by_index_for_us_or_for_all() -> None:
    station = Station()
    station.greets = False
    air = Air(station)
    air.run(1.0)
    station.ask_name("TRG_RATE")
    station.ask_index(3)
    station.ask_name("RNG_MAX", component=0)
    air.run(0.5)
    assert set(station.values) == {"TRG_RATE", ROWS[3].name, "RNG_MAX"}
    station.ask_name("RNG_MIN", component=1)
    station.say(mavlink.MAVLink_param_request_read_message(SYSTEM + 1, COMPANION, b"RNG_MIN", -1))
    station.say(mavlink.MAVLink_param_request_list_message(SYSTEM, 1))
    air.run(0.5)
    assert station.arrived == 3, "what is addressed to others is theirs"


def test_unknown_ids_are_refused_by_name_and_index_and_only_when_meant_for_us() -> None:
    station = Station()
    air = Air(station)
    air.run(1.0)
    station.greets = False
    before = station.arrived
    station.ask_name("NO_SUCH_THING")
    station.ask_index(len(ROWS))
    station.set("NO_SUCH_THING", 1.0)
    station.ask_name("NO_SUCH_THING", component=0)
    station.set("NO_SUCH_THING", 1.0, component=0)
    records = air.run(0.5)
    assert len(station.errors) == 3
    assert {error.error for error in station.errors} == {mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST}
    assert station.arrived == before
    assert [notice.text for notice in of_kind(records, Notice)] == ["no parameter 'NO_SUCH_THING'"]


@pytest.mark.parametrize("value", [500.1, -1.0, math.nan, math.inf, -math.inf, 3.0e38])
def test_a_value_out_of_range_is_answered_with_the_value_in_force_and_the_reason(value: float) -> None:
    station = Station()
    air = Air(station)
    air.run(1.0)
    station.set("RNG_MAX", value)
    records = air.run(0.2)
    assert station.values["RNG_MAX"] == 200.0
    assert not of_kind(records, ParameterChange)
    assert "RNG_MAX" in of_kind(records, Notice)[0].text
    assert air.pilot.component.parameters.refused == 1


def test_a_fraction_for_a_whole_number_and_a_foreign_type_are_refused() -> None:
    station = Station()
    air = Air(station)
    air.run(1.0)
    station.set("TRG_POLICY", 0.5)
    station.set("RNG_MATCHES", 2.8e-44, INT32)  # the integer 20, byte-wise
    records = air.run(0.3)
    assert (station.values["TRG_POLICY"], station.values["RNG_MATCHES"]) == (0.0, 12.0)
    assert not of_kind(records, ParameterChange)
    texts = " ".join(notice.text for notice in of_kind(records, Notice))
    assert "whole number" in texts
    assert "REAL32" in texts
    type_mismatch = 7  # MAVLink common.xml; pymavlink 2.4.50 ends at 5
    assert {error.error for error in station.errors} == {mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE, type_mismatch}


def test_a_live_change_acts_at_once_in_the_adapter_and_through_a_record_in_the_pipeline() -> None:
    station = Station()
    air = Air(station)
    air.run(1.0)
    station.set("RNG_TRUST", 0.05)
    records = air.run(0.1)
    (change,) = of_kind(records, ParameterChange)
    assert (change.name, change.value) == ("RNG_TRUST", 0.05)
    assert station.values["RNG_TRUST"] == np.float32(0.05)
    assert air.pilot.component.parameters.settings.trust_ratio == 0.05
    state = start(load_airframe("nadir-2m"), Settings())
    for record in records:
        state, _ = step(state, record)
    assert state.settings.trust_ratio == 0.05
    # the raw bytes alone do not make the change a second time when a recording is replayed
    decoder = Decoder(load_airframe("nadir-2m"), COMPANION)
    replayed = [again for chunk in of_kind(records, RawChunk) for again in decoder.decode_chunk(chunk)]
    assert not of_kind(replayed, ParameterChange)


@pytest.mark.parametrize("row", [row for row in ROWS if row.live], ids=lambda row: row.name)
def test_a_live_change_reaches_everyone_who_uses_settings(row: Tunable) -> None:
    state = start(load_airframe("nadir-2m"), Settings())
    value = row.minimum if row.minimum != row.default else row.maximum
    state, _ = step(state, ParameterChange(row.name, value, 0))
    assert state.scheduling is not None
    assert state.correction is not None
    users = (state, state.scheduling.planner, state.correction)
    assert {getattr(user.settings, row.attribute) for user in users} == {value}
    assert getattr(state.tracker._settings, row.attribute) == value


def test_a_repeated_set_is_answered_again_but_changes_once() -> None:
    station = Station()
    station.greets = False
    air = Air(station)
    air.run(1.0)
    for _ in range(4):
        station.set("OUT_RATE", 20.0)
        air.run(0.1)
    assert len(of_kind(air.records, ParameterChange)) == 1
    answers = [m for m in station.heard if m.get_type() == "PARAM_VALUE" and m.param_id == "OUT_RATE"]
    assert [m.param_value for m in answers] == [20.0] * 4


def test_a_value_that_needs_a_restart_says_so_and_does_not_act() -> None:
    station = Station()
    air = Air(station)
    air.run(1.0)
    station.set("TRK_LAG", 0.75)
    records = air.run(0.2)
    assert station.values["TRK_LAG"] == 0.75, "the station sees that it was taken"
    assert not of_kind(records, ParameterChange)
    assert [notice.text for notice in of_kind(records, Notice)] == ["TRK_LAG 0.75: restart needed"]
    assert air.pilot.component.parameters.settings.smoother_lag_s == Settings().smoother_lag_s


def test_a_station_that_comes_back_after_silence_is_greeted_again() -> None:
    station = Station()
    air = Air(station)
    air.run(5.0)
    first = station.arrived
    assert station.complete()
    assert first == len(ROWS) + 2
    air.run(5.0)
    assert station.arrived == first
    station.greets = False
    air.run(12.0)
    station.greets = True
    air.run(2.0)
    assert station.arrived >= first + len(ROWS)


def _flood(air: Air, components: range) -> int:
    """Make 249 invented systems with each of these components say hello; give the memory that is in use afterwards."""
    for component in components:
        for system in range(1, 250):
            packer = mavlink.MAVLink(None, system, component)
            hello = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
            air.wire.inbox += bytes(hello.pack(packer))
        air.run(0.01)
    air.records.clear()  # of the test's own
    for station in air.stations:
        station.heard.clear()
    # what is compiled gives its arrays back behind the back of the tracer, which keeps them on its list
    snapshot = tracemalloc.take_snapshot().filter_traces(
        [tracemalloc.Filter(False, "*bulk.py"), tracemalloc.Filter(False, tracemalloc.__file__)]
    )
    return sum(trace.size for trace in snapshot.traces)


@pytest.mark.slow
def test_many_invented_stations_take_no_memory_and_do_not_stop_the_real_one() -> None:
    station = Station()
    air = Air(station)
    air.run(0.5)
    tracemalloc.start()
    try:
        # some tables are emptied when they are full, so that levels are compared, not single readings
        levels = [_flood(air, range(first, first + 3)) for first in range(1, 31, 3)]
    finally:
        tracemalloc.stop()
    assert max(levels[5:]) < 1.3 * max(levels[:5]), "twice as many stations, the same memory"
    station.values.clear()
    station.indices.clear()
    station.ask_list()
    air.until(station.complete, 5.0)
    assert station.values.keys() == {row.name for row in ROWS}


def test_what_was_set_is_there_after_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "parameters"
    station = Station()
    air = Air(station, store=Keeper(path))
    air.run(1.0)
    station.set("TRG_RATE", 7.3)
    station.set("TRK_LAG", 0.6)
    air.run(0.2)
    air.pilot.close()
    stored = load_stored(path)
    assert stored.values == {"TRG_RATE": 7.3, "TRK_LAG": 0.6}
    settings = Settings().with_values(stored.values)
    again = Station()
    second = Air(again, settings=settings, store=Keeper(path), stored_values=stored.values)
    again.ask_list()
    second.until(again.complete, 5.0)
    assert again.values["TRK_LAG"] == np.float32(0.6)
    again.set("OUT_RATE", 5.0)
    second.run(0.2)
    second.pilot.close()
    assert load_stored(path).values == {"TRG_RATE": 7.3, "TRK_LAG": 0.6, "OUT_RATE": 5.0}


def test_a_store_that_cannot_be_written_is_told_and_the_value_still_acts(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    station = Station()
    keeper = Keeper(tmp_path / "file" / "parameters")
    air = Air(station, store=keeper)
    air.run(1.0)
    station.set("OUT_RATE", 5.0)
    air.run(0.1)
    keeper.close()  # now its thread has tried
    air.run(0.1)
    assert any("cannot keep parameters" in notice.text for notice in of_kind(air.records, Notice))
    assert air.pilot.component.parameters.settings.publish_rate_hz == 5.0


def test_what_leaves_unasked_is_little() -> None:
    station = Station()
    air = Air(station)
    air.run(10.0)
    unasked = [m for m in station.heard if m.get_type() in ("PARAM_VALUE", "STATUSTEXT")]
    assert len(unasked) <= len(ROWS) + 2

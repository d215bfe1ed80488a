"""One id, one speaker; few texts; and the computer's own state, told as the message wants it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.component.onboard_computer_status import OnboardComputerStatus
from companion.adapters.mavlink.component.statustext import TextLimiter
from companion.records import Notice
from sitl_tests.loop.ground_stations import COMPANION, SYSTEM, Air, S, Station

TWICE = "used twice"


def twice(air: Air) -> list[Notice]:
    return [record for record in air.records if isinstance(record, Notice) and TWICE in record.text]


def frames_of_another(air: Air, seconds: int, message: Any) -> None:
    packer = mavlink.MAVLink(None, SYSTEM, COMPANION)
    for k in range(seconds):
        air.wire.inbox += bytes(message(k).pack(packer))
        air.run(1.0)


def test_our_own_frames_sent_back_by_a_router_are_no_other_speaker() -> None:
    air = Air(Station())
    for _ in range(2000):
        air.run(0.005)
        # a routing loop brings everything back, twice
        air.wire.inbox += 2 * b"".join(air.wire.sent)
    assert air.pilot.decoder.echoes > 100
    assert air.pilot.component.identity.foreign == 0
    assert not twice(air)


def test_another_spanwise_with_our_id_is_told_with_the_parameter_to_change() -> None:
    air = Air(Station())
    air.run(1.0)
    frames_of_another(air, 5, lambda k: mavlink.MAVLink_timesync_message(0, 987_654_321 + k))
    (notice,) = twice(air)
    assert f"{SYSTEM}/{COMPANION}" in notice.text
    assert "SW_COMPID" in notice.text
    assert len(notice.text) <= 50 * 2
    frames_of_another(air, 40, lambda k: mavlink.MAVLink_timesync_message(0, 987_654_321 + 100 * k))
    assert len(twice(air)) == 2, "told again every half minute, not every second"


def test_another_kind_of_component_with_our_id_is_told() -> None:
    air = Air(Station())
    air.run(1.0)
    beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_CAMERA, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    frames_of_another(air, 4, lambda _: beat)
    assert len(twice(air)) == 1


def test_one_late_frame_of_our_own_past_is_not_called_another() -> None:
    air = Air(Station())
    air.run(1.0)
    frames_of_another(air, 2, lambda k: mavlink.MAVLink_timesync_message(0, 55 + k))
    air.run(20.0)
    frames_of_another(air, 1, lambda k: mavlink.MAVLink_timesync_message(0, 77 + k))
    assert not twice(air)


# ------------------------------------------------------------------------------------------ texts


def test_a_text_is_not_repeated_at_once_and_then_comes_with_its_count() -> None:
    limiter = TextLimiter()
    said = [limiter.admit(Notice(4, "left node silent", k * S // 10)) for k in range(101)]
    assert said[0] == "left node silent"
    assert said[1:100] == [None] * 99
    assert said[100] == "left node silent (x100)"


def test_errors_get_through_chatter() -> None:
    limiter = TextLimiter()
    for k in range(100):
        limiter.admit(Notice(6, f"chatter {k}", 0))
    assert limiter.admit(Notice(3, "another component has our id", 1)) == "another component has our id"


@given(st.lists(st.tuples(st.integers(0, 7), st.integers(0, 30), st.integers(0, 3 * S)), max_size=300))
def test_never_more_than_a_burst_and_one_a_second(events: list[tuple[int, int, int]]) -> None:
    limiter, now, sent = TextLimiter(), 0, []
    for severity, number, pause_ns in events:
        now += pause_ns
        if limiter.admit(Notice(severity, f"text {number}", now)) is not None:
            sent.append(now)
    for first in range(len(sent)):
        for last in range(first, len(sent)):
            assert last - first + 1 <= 8 + (sent[last] - sent[first]) / S + 1


# ------------------------------------------------------------------------------------------ computer


def machine(folder: Path, busy: int, idle: int) -> None:
    (folder / "proc").mkdir(exist_ok=True)
    thermal = folder / "sys/class/thermal/thermal_zone0"
    thermal.mkdir(parents=True, exist_ok=True)
    (folder / "proc/stat").write_text(
        f"cpu  {2 * busy} 0 0 {2 * idle} 0 0 0 0\ncpu0 {busy} 0 0 {idle} 0 0 0 0\ncpu1 0 0 0 {idle + busy} 0 0 0 0\n"
    )
    (folder / "proc/meminfo").write_text("MemTotal: 4194304 kB\nMemFree: 1 kB\nMemAvailable: 1048576 kB\n")
    (thermal / "temp").write_text("61800\n")


def test_load_memory_and_temperature_are_what_the_machine_says(tmp_path: Path) -> None:
    status = OnboardComputerStatus(tmp_path)
    machine(tmp_path, 100, 900)
    assert status.due(S) is not None
    assert status.due(S + S // 2) is None
    machine(tmp_path, 175, 925)
    message = status.due(2 * S)
    assert message is not None
    assert message.cpu_cores[:3] == [75, 0, 255]
    assert (message.ram_usage, message.ram_total) == (3072, 4096)
    assert message.temperature_core[0] == 62
    back = mavlink.MAVLink(None).parse_buffer(message.pack(mavlink.MAVLink(None, 1, 191)))[0]
    assert back.uptime == 2000
    assert back.storage_total[0] >= back.storage_usage[0] > 0


@pytest.mark.parametrize("simulated", [False, True])
def test_a_machine_that_tells_nothing_gives_unknowns(tmp_path: Path, *, simulated: bool) -> None:
    message = OnboardComputerStatus(None if simulated else tmp_path / "nothing").due(S)
    assert message is not None
    assert set(message.cpu_cores) == {255}
    assert (message.ram_usage, message.ram_total) == (0xFFFFFFFF, 0xFFFFFFFF)
    assert message.temperature_core == [127] * 8
    assert message.storage_usage[0] == 0xFFFFFFFF
    assert message.pack(mavlink.MAVLink(None, 1, 191))


def test_it_goes_out_once_a_second() -> None:
    station = Station()
    air = Air(station)
    air.run(5.0)
    assert len([m for m in station.heard if m.get_type() == "ONBOARD_COMPUTER_STATUS"]) in (4, 5)

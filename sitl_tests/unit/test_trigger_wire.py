"""Messages to and from the trigger process: exact round trips, and nothing else is believed."""

from __future__ import annotations

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.adapters.clocks import MonotonicClock
from companion.adapters.triggers.mavlink import CAMERAS, LinkFiring, MavlinkTrigger
from companion.adapters.triggers.wire import LARGEST, Realtime, pack_plan, pack_report, unpack_plan, unpack_report
from companion.errors import DeviceError
from companion.records import Firing, Reject, Rejected, Shot, TriggerPlan

int64 = st.integers(-(2**63), 2**63 - 1)
plans = st.builds(
    TriggerPlan,
    plan_id=int64,
    firing=st.sampled_from(Firing),
    command_host_ns=int64,
    exposure_host_ns=int64,
    sigma_ns=int64,
    blur_px=st.floats(allow_nan=False),
    expires_host_ns=int64,
    planned_host_ns=int64,
    reject=st.none() | st.sampled_from(Reject),
)
reports = st.one_of(
    st.builds(Shot, int64, int64, int64),
    st.builds(Realtime, st.booleans(), st.booleans(), st.booleans()),
    st.builds(Rejected, st.sampled_from(Reject), st.text(max_size=40), int64, st.integers(1, 2**40)),
)


@given(plans)
def test_a_plan_arrives_as_it_was_sent(plan: TriggerPlan) -> None:
    assert unpack_plan(pack_plan(plan)) == plan


@given(reports)
def test_a_report_arrives_as_it_was_sent(report: Shot | Realtime | Rejected) -> None:
    assert unpack_report(pack_report(report)) == report


@given(plans, st.data())
def test_one_wrong_byte_is_refused(plan: TriggerPlan, data: st.DataObject) -> None:
    message = bytearray(pack_plan(plan))
    at = data.draw(st.integers(0, len(message) - 1))
    message[at] ^= data.draw(st.integers(1, 255))
    assert unpack_plan(bytes(message)) is None


@given(st.binary(max_size=LARGEST))
def test_garbage_is_neither_plan_nor_report(garbage: bytes) -> None:
    assert unpack_plan(garbage) is None
    assert unpack_report(garbage) is None


def test_a_report_is_no_plan_and_a_long_reason_still_fits() -> None:
    assert unpack_plan(pack_report(Shot(1, 2, 3))) is None
    message = pack_report(Rejected(Reject.DEVICE_FAILED, "x" * 4000, 5))
    assert len(message) <= LARGEST
    report = unpack_report(message)
    assert isinstance(report, Rejected)
    assert report.what.startswith("xxx")


def test_what_the_system_refused_is_said() -> None:
    assert "no real-time priority" in Realtime(False, True, True).sentence()
    assert "no locked memory" in Realtime(True, False, True).sentence()
    assert "no " not in Realtime(True, True, True).sentence()


def test_a_mavlink_shot_asks_for_one_picture_of_every_camera() -> None:
    plan = TriggerPlan(7, Firing.PEAK, 100, 200, 0, 0.1, 300, 50)
    before = time.monotonic_ns()
    shot = MavlinkTrigger().fire(plan)
    assert before <= shot.fired_host_ns <= time.monotonic_ns()
    assert (shot.plan_id, shot.planned_host_ns) == (7, 100)
    request = CAMERAS.command(shot)
    assert request.command == 2000
    assert request.parameters[:4] == (0.0, 0.0, 1.0, 7.0)
    assert len(request.parameters) == 7


@pytest.mark.parametrize("kind", ["relay", "servo"])
def test_a_relay_that_may_still_be_on_is_not_told_to_go_on(kind: str) -> None:
    """ArduPilot toggles it: a command between the two edges would leave the line high, and shots would be its falls."""
    plan = TriggerPlan(7, Firing.PEAK, 100, 200, 0, 0.1, 300, 50)
    trigger = MavlinkTrigger(LinkFiring(kind, 2))
    first_ns = trigger.fire(plan).fired_host_ns
    with pytest.raises(DeviceError, match=f"{kind} 2 may still be on.*TRG_RATE"):
        trigger.fire(plan)
    while time.monotonic_ns() < first_ns + 60_000_000:
        time.sleep(0.005)
    assert trigger.fire(plan).fired_host_ns >= first_ns + 60_000_000


def test_clocks() -> None:
    clock = MonotonicClock()
    target = clock.now_ns() + 3_000_000
    clock.sleep_until(target)
    assert clock.now_ns() >= target
    clock.sleep_until(target - 1)


@pytest.mark.parametrize("size", [0, 1, 4, 5])
def test_short_messages_are_refused(size: int) -> None:
    assert unpack_plan(b"\x01" * size) is None
    assert unpack_report(b"\x02" * size) is None

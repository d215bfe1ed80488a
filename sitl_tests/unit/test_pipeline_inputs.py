"""The pipeline under inputs that are not as they should be: refused by name, counted, and never guessed around."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator

import numpy as np
import pytest

from companion.core.pipeline import _motion, start, step
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import (
    AutopilotParameter,
    ClockName,
    ClockRestart,
    CorrectedRange,
    Deflection,
    Firing,
    Health,
    ImuBatch,
    MatchSet,
    ModeState,
    NoRange,
    Notice,
    ParameterChange,
    Record,
    Reject,
    Rejected,
    ServiceStatus,
    Shot,
    Station,
    Tick,
    TimesyncReply,
    TriggerPlan,
    Validity,
    VehicleState,
)
from companion.sim.flight.offline import HOST_EPOCH_NS
from sitl_tests.unit.pipeline_flight import GROUND_M, MS, Run, S, at_s, flight, inputs, run, without_samples

STALE_S = 0.4
LEARNED_S = 15.0  # no range is trusted in the tracker's first ten seconds
SIDES = (Station.LEFT, Station.RIGHT)


@pytest.fixture(scope="module")
def good() -> Run:
    return run(inputs())


@pytest.mark.slow
def test_a_good_flight_gives_true_ranges() -> None:
    """Without this, silence in the other tests would prove nothing."""
    trusted = [measured for measured in run(inputs(LEARNED_S)).of(CorrectedRange) if measured.trusted]
    assert len(trusted) > 8
    assert all(abs(measured.range_m - GROUND_M) < 5 * measured.sigma_m for measured in trusted)
    assert all(measured.sigma_m <= 0.03 * measured.range_m for measured in trusted)


@pytest.mark.slow
def test_two_runs_over_the_same_inputs_are_equal(good: Run) -> None:
    again = run(inputs())
    assert [repr(output) for output in again.outputs] == [repr(output) for output in good.outputs]


# ------------------------------------------------------------------------------------------ clocks


def test_without_sync_nothing_is_estimated_and_the_reason_goes_out() -> None:
    unsynced = run(record for record in inputs(3.0) if not isinstance(record, TimesyncReply))
    refused = unsynced.of(Rejected)
    sent = sum(len(record.t_ns) for record in inputs(3.0) if isinstance(record, ImuBatch))
    in_time = sum(entry.count for entry in refused if entry.what.endswith("samples"))
    assert {entry.reason for entry in refused} <= {Reject.CLOCK_UNSYNCED, Reject.NOT_SETTLED}
    assert in_time >= 0.98 * sent, "every sample but those of the last turn is refused and counted"
    assert unsynced.of(ModeState) == unsynced.of(CorrectedRange) == unsynced.of(TriggerPlan) == []
    assert {silent.reject for silent in unsynced.of(NoRange)} == {Reject.CLOCK_UNSYNCED}
    status = unsynced.of(ServiceStatus)[-1]
    assert status.health is Health.BOOT
    assert all(name in status.reason for name in ("boot", "node_left", "node_right"))


@pytest.mark.slow
def test_one_node_without_sync_is_left_out_and_the_heartbeat_says_which() -> None:
    half = run(
        record
        for record in inputs()
        if not (isinstance(record, TimesyncReply) and record.clock is ClockName.NODE_RIGHT)
    )
    assert half.of(ModeState, since_s=4.0)
    assert all(Station.RIGHT not in mode.stations for mode in half.of(ModeState))
    status = half.of(ServiceStatus)[-1]
    assert status.health is Health.CRITICAL
    assert "node_right" in status.reason
    assert "node_left" not in status.reason


def rebooted(at: float, silence_s: float) -> Iterator[Record]:
    """The autopilot restarts: silence, then its stamps and its TIMESYNC answers count from zero again."""
    lost_ns = round((at + silence_s) * S)
    announced = False
    for record in inputs(20.0):
        arrival = at_s(record)
        is_root = isinstance(record, ImuBatch) and record.station is Station.ROOT
        is_boot = isinstance(record, TimesyncReply) and record.clock is ClockName.BOOT
        if arrival < at or not (is_root or is_boot):
            yield record
        elif arrival >= at + silence_s:
            if not announced:
                announced = True
                yield ClockRestart(ClockName.BOOT, HOST_EPOCH_NS + round(arrival * S))
            if isinstance(record, ImuBatch):
                keep = record.t_ns >= lost_ns
                if keep.any():
                    yield dataclasses.replace(record, t_ns=record.t_ns[keep] - lost_ns, values=record.values[keep])
            elif isinstance(record, TimesyncReply) and record.remote_ns >= lost_ns:
                yield dataclasses.replace(record, remote_ns=record.remote_ns - lost_ns)


@pytest.mark.slow
def test_a_restarted_autopilot_is_locked_again_and_no_stamp_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    state = start(load_airframe("nadir-2m"), Settings())
    stamped: list[tuple[Station, np.ndarray, int]] = []
    tracker = type(state.tracker)
    add = tracker.add

    def watched(self: object, batch: ImuBatch) -> list[Rejected]:
        stamped.append((batch.station, batch.t_ns, batch.received_host_ns))
        return add(self, batch)  # type: ignore[arg-type]

    monkeypatch.setattr(tracker, "add", watched)
    again = run(rebooted(4.0, 0.8))
    # a sample reaches us some milliseconds after its stamp; one of the old life would be 4.8 s off
    for station, t_ns, received_ns in stamped:
        assert t_ns.max() < received_ns + 2 * MS, station
        assert t_ns.min() > received_ns - 60 * MS, station
    assert any("boot clock restarted" in notice.text for notice in again.of(Notice))
    roots = [received_ns for station, _, received_ns in stamped if station is Station.ROOT]
    gap_s = np.diff(np.array(roots)).max() / S
    assert 0.8 <= gap_s < 0.8 + 2.5, "locked again after eight answers or 1.5 s"
    assert any(mode.validity is Validity.STALE for mode in again.of(ModeState, 4.3, 5.0))
    assert any(measured.trusted for measured in again.of(CorrectedRange, since_s=17.0)), "learned anew"
    assert not [measured for measured in again.of(CorrectedRange, 4.6, 5.0) if measured.trusted]


# ------------------------------------------------------------------------------------------ samples


@pytest.mark.slow
def test_values_that_are_not_finite_are_counted_and_do_no_harm(good: Run) -> None:
    def poisoned() -> Iterator[Record]:
        for record in inputs():
            if isinstance(record, ImuBatch) and record.station is Station.LEFT and 3.0 <= at_s(record) < 3.1:
                values = record.values.copy()
                values[::2, 2] = np.nan
                record = dataclasses.replace(record, values=values)
            yield record

    hurt = run(poisoned())
    bad = [entry for entry in hurt.of(Rejected) if entry.reason is Reject.NOT_FINITE]
    assert sum(entry.count for entry in bad) == pytest.approx(50, abs=8)
    assert {entry.what for entry in bad} == {"left inertial sample"}
    assert hurt.state.counters[str(Reject.NOT_FINITE)] == sum(entry.count for entry in bad)
    for after, before in zip(hurt.of(ModeState, since_s=3.2), good.of(ModeState, since_s=3.2), strict=True):
        assert np.isfinite(after.q_m).all()
        assert np.isfinite(after.q_sigma_m).all()
        assert np.abs(after.q_m - before.q_m).max() < 5 * (after.q_sigma_m + before.q_sigma_m).max()


@pytest.mark.slow
@pytest.mark.parametrize("stations", [(Station.ROOT,), SIDES])
def test_a_stream_that_stops_is_stale_and_no_old_range_stands(stations: tuple[Station, ...]) -> None:
    stopped = run(without_samples(inputs(), stations, since_s=3.5))
    assert [mode.validity for mode in stopped.of(ModeState, since_s=4.0)][-1] is Validity.STALE
    assert stopped.of(CorrectedRange, until_s=3.5)
    assert stopped.of(CorrectedRange, since_s=3.5 + 0.3) == []
    assert stopped.of(Deflection, since_s=3.5 + 0.3) == []
    silent = stopped.of(NoRange, since_s=3.5 + 0.3 + STALE_S)
    assert len(silent) > 10
    assert {entry.reject for entry in silent} == {Reject.STALE}
    assert stopped.of(ServiceStatus)[-1].health is Health.CRITICAL
    assert "stale" in stopped.of(ServiceStatus)[-1].reason


@pytest.mark.slow
def test_one_tip_alone_goes_on_and_says_so() -> None:
    single = run(without_samples(inputs(), (Station.RIGHT,), since_s=3.5))
    last = single.of(ModeState)[-1]
    assert last.validity is not Validity.STALE
    assert last.stations == (Station.ROOT, Station.LEFT)


# ------------------------------------------------------------------------------------------ parameters


@pytest.mark.slow
def test_shots_that_bring_no_images_are_told_until_one_comes() -> None:
    """A camera's process died or its trigger line came off: critical, and a sentence for the operator."""
    fired_ns = HOST_EPOCH_NS - 9 * S  # ten seconds of patience are over soon after the start

    def unseen() -> Iterator[Record]:
        yield from (Shot(-number, fired_ns, fired_ns) for number in range(1, 6))
        for record in inputs():
            if not (isinstance(record, MatchSet) and at_s(record) < 4.0):
                yield record

    driven = run(unseen())
    complaint = "shots bring no image pairs"
    blind = driven.of(ServiceStatus, 2.0, 4.0)
    assert blind
    assert all(status.health is Health.CRITICAL and complaint in status.reason for status in blind)
    assert any(complaint in notice.text for notice in driven.of(Notice, 2.0, 4.0))
    assert not any(complaint in status.reason for status in driven.of(ServiceStatus, 4.2))
    assert not any(complaint in notice.text for notice in driven.of(Notice, 4.2))


@pytest.mark.slow
def test_a_changed_parameter_is_in_force_from_that_instant() -> None:
    def changed() -> Iterator[Record]:
        announced = False
        for record in inputs(LEARNED_S):
            if at_s(record) >= 12.5 and not announced:
                announced = True
                yield ParameterChange("RNG_MAX", 20.0, HOST_EPOCH_NS + 12_500 * MS)
                yield ParameterChange("OUT_DEBUG", 0.0, HOST_EPOCH_NS + 12_500 * MS)
                yield ParameterChange("TRG_POLICY", 2.0, HOST_EPOCH_NS + 12_500 * MS)
            yield record

    driven = run(changed())
    assert any(measured.trusted for measured in driven.of(CorrectedRange, until_s=12.5))
    after = driven.of(CorrectedRange, since_s=12.501)
    assert len(after) > 5
    assert {measured.reject for measured in after} == {Reject.OUT_OF_RANGE}
    assert driven.of(ModeState, until_s=12.5)
    assert driven.of(ModeState, since_s=12.501) == []
    assert {plan.firing for plan in driven.of(TriggerPlan, since_s=12.501)} <= {Firing.SKIP}


def test_the_vehicles_own_filter_replaces_the_believed_one_and_restarts_the_tracker() -> None:
    state = start(load_airframe("nadir-2m"), Settings())
    before = state.tracker
    state, outputs = step(state, AutopilotParameter("INS_ACCEL_FILTER", 20.0, 1))
    assert outputs == []
    assert state.tracker is before, "what was believed already changes nothing"
    state, outputs = step(state, AutopilotParameter("INS_ACCEL_FILTER", 30.0, 2))
    (notice,) = outputs
    assert isinstance(notice, Notice)
    assert "INS_ACCEL_FILTER is 30 Hz" in notice.text
    assert state.tracker is not before
    assert state.airframe.root.lowpass_accel_hz == 30.0
    assert state.airframe.left.lowpass_accel_hz == load_airframe("nadir-2m").left.lowpass_accel_hz
    state, outputs = step(state, AutopilotParameter("RNGFND1_TYPE", 10.0, 3))
    assert outputs == []


# ------------------------------------------------------------------------------------------ less than everything


def test_an_airframe_without_cameras_is_tracked_and_neither_fires_nor_ranges() -> None:
    blind = dataclasses.replace(load_airframe("nadir-2m"), left_camera=None, right_camera=None)
    driven = run(inputs(), blind)
    assert any(mode.validity is Validity.TRACKING for mode in driven.of(ModeState))
    assert driven.of(TriggerPlan) == driven.of(CorrectedRange) == []


def test_camera_stamps_that_were_never_converted_are_refused() -> None:
    def on_camera_time() -> Iterator[Record]:
        for record in inputs(3.0):
            yield (
                dataclasses.replace(record, clocks=(ClockName.CAM_LEFT, ClockName.CAM_RIGHT))
                if hasattr(record, "clocks")
                else record
            )

    driven = run(on_camera_time())
    assert driven.of(CorrectedRange) == []
    frames = [entry for entry in driven.of(Rejected) if entry.what == "camera frames"]
    assert frames
    assert {entry.reason for entry in frames} == {Reject.CLOCK_UNSYNCED}


def test_more_pairs_than_can_wait_drop_the_oldest_by_name() -> None:
    some = next(record for record in inputs(3.0) if hasattr(record, "left_px"))
    state = start(load_airframe("nadir-2m"), Settings())
    refused: list[Record] = []
    for number in range(70):
        state, outputs = step(state, dataclasses.replace(some, pair_id=number))
        refused += outputs
    assert [entry.what for entry in refused if isinstance(entry, Rejected)] == [f"pair {number}" for number in range(6)]
    assert state.counters[str(Reject.QUEUE_FULL)] == 6


def test_ticks_alone_say_that_samples_are_awaited() -> None:
    silent = run(Tick(HOST_EPOCH_NS + number * 10 * MS) for number in range(200))
    statuses = silent.of(ServiceStatus)
    assert len(statuses) == 2
    assert {status.health for status in statuses} == {Health.BOOT}
    assert flight(3.0).airframe.orientation == silent.of(NoRange)[0].orientation


@pytest.mark.parametrize(
    ("reported", "starts"),
    [
        ((True, False), 1),
        ((True, True, False, False), 1),
        ((True, None, None, False), 1),
        ((None, False), 0),
        ((False, True), 0),
        ((True, None), 0),
        ((True, False, None, False), 1),
    ],
)
def test_the_tracker_starts_again_when_the_autopilot_says_that_it_lifted_off(
    reported: tuple[bool | None, ...], starts: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    state, lifted = start(load_airframe("nadir-2m"), Settings()), []
    monkeypatch.setattr(state.tracker, "lifted_off", lambda: lifted.append(True))
    for k, on_ground in enumerate(reported):
        state, _ = step(state, VehicleState(k, HOST_EPOCH_NS + k * S, 0.0, 0.0, 0.0, 15.0, 0.0, 0.5, True, on_ground))
    assert len(lifted) == starts
    for k in range(5 * 50):
        state, _ = step(state, Tick(HOST_EPOCH_NS + 5 * S + k * 20 * MS))
    assert len(lifted) == 2 * starts, "once more when the wing has stopped ringing from the wheels, and never again"


@pytest.mark.parametrize(("age_s", "range_m"), [(0.7, 10.0), (3.0, math.inf)])
def test_a_low_range_of_some_time_ago_does_not_smear_the_view_of_now(age_s: float, range_m: float) -> None:
    """After a go-around it would forbid every shot, and so every newer range."""
    state = start(load_airframe("nadir-2m"), Settings())
    step(state, VehicleState(0, 0, 0.0, 0.0, 0.0, 20.0, 0.0, 0.5, True))
    assert state.correction is not None
    state.correction.last_trusted = CorrectedRange(1, 1, 5 * S, 25, 10.0, 0.1, 0.0, 1e-4, 0.0, 50, True, None)
    assert _motion(state, 5 * S + round(age_s * S)).range_m == range_m

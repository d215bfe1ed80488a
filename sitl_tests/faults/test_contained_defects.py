"""A handler that raises: the record is refused, counted and told, the process goes on, and a replay repeats it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.decoder import Decoder
from companion.adapters.mavlink.decode.message_records import Translator
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.cli.main import main
from companion.core import pipeline
from companion.core.containment import contained
from companion.core.pipeline import start, step
from companion.core.tracking.tracker import WingTracker
from companion.params.airframe import NamedEffect
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import (
    AutopilotParameter,
    ClockName,
    CorrectedRange,
    Health,
    ImuBatch,
    Notice,
    RawChunk,
    Reject,
    Rejected,
    ServiceStatus,
    Shot,
    Tick,
    TimesyncReply,
)
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.simulated_service import EPOCH_NS, SimulatedService

pytestmark = pytest.mark.defect
AIRFRAME = load_airframe("nadir-2m")
S = 1_000_000_000


def raise_between(monkeypatch: pytest.MonkeyPatch, from_s: float, until_s: float, most: int = 1000) -> list[int]:
    """Make the tracker raise at every step between two instants of the flight, so often at most; give when it did."""
    process_until, raised = WingTracker.process_until, []

    def raising(tracker: WingTracker, now_host_ns: int) -> Any:
        if from_s <= (now_host_ns - EPOCH_NS) * 1e-9 < until_s and len(raised) < most:
            raised.append(now_host_ns)
            raise ZeroDivisionError("a defect\nmade on purpose")
        return process_until(tracker, now_host_ns)

    monkeypatch.setattr(WingTracker, "process_until", raising)
    return raised


def internal(tape: Any) -> int:
    return sum(entry.count for entry in tape.of(Rejected) if entry.reason is Reject.INTERNAL_ERROR)


@pytest.mark.long
def test_a_tick_that_raises_costs_seconds_and_a_replay_repeats_it(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raised = raise_between(monkeypatch, 4.0, 5.0, most=1)
    path = tmp_path / "flight.mcap"
    run = SimulatedService(build_flight(AIRFRAME, 1, 19.0), recording=path)
    tape = run.fly(18.0)
    run.close()
    assert len(raised) == 1
    assert internal(tape) == 1
    (notice,) = (entry for entry in tape.of(Notice) if "internal error" in entry.text)
    assert "ZeroDivisionError: a defect made on purpose (test_contained_defects.py:" in notice.text
    assert notice.text in "".join(run.world.report()["statustexts"])
    last = tape.of(ServiceStatus)[-1]
    assert last.counters[str(Reject.INTERNAL_ERROR)] == 1
    assert last.counters["samples root"] > 17 * 300, "what was counted before is counted on"
    assert last.health is Health.ACTIVE
    assert not any(entry.trusted for entry in tape.of(CorrectedRange, 4.0, 6.0)), "a tracker that has learned nothing"
    assert sum(entry.trusted for entry in tape.of(CorrectedRange, 15.0)) > 5
    capsys.readouterr()
    raised.clear()
    assert main(["replay", str(path), "--json"]) == 0
    replay_report = json.loads(capsys.readouterr().out)
    assert replay_report["reproduced"] is True
    assert replay_report["rejected"][str(Reject.INTERNAL_ERROR)] == 1


@pytest.mark.slow
def test_ticks_that_go_on_raising_are_told_once_a_second_and_not_called_active(monkeypatch: pytest.MonkeyPatch) -> None:
    raised = raise_between(monkeypatch, 2.0, 3.5)
    run = SimulatedService(build_flight(AIRFRAME, 1, 6.0))
    tape = run.fly(5.5)
    run.close()
    assert internal(tape) == len(raised) > 25
    assert len([entry for entry in tape.of(Notice) if "internal error" in entry.text]) == 2
    during = {entry.health for entry in tape.of(ServiceStatus, 2.1, 3.5)}
    assert during == {Health.CRITICAL}
    assert tape.of(ServiceStatus)[-1].counters[str(Reject.INTERNAL_ERROR)] == len(raised)
    assert tape.of(ServiceStatus)[-1].health is not Health.CRITICAL


@pytest.mark.parametrize("record", [Tick(7 * S), Shot(1, 1, 2), TimesyncReply(ClockName.BOOT, 1, 2, 3)])
def test_the_estimation_begins_anew_and_keeps_what_was_told(
    monkeypatch: pytest.MonkeyPatch, record: Tick | Shot | TimesyncReply
) -> None:
    late = NamedEffect("stream-delay", {"delay_s": 0.01})
    state = start(dataclasses.replace(AIRFRAME, effects=(late,)), Settings())
    state, _ = step(state, AutopilotParameter("INS_GYRO_FILTER", 55.0, 1))
    state.airborne_ns = 9 * S
    for k in range(100):
        sent_ns = 6 * S + k * S // 100
        state, _ = step(state, TimesyncReply(ClockName.BOOT, sent_ns, sent_ns, sent_ns + 200_000))
    assert state.clocks.synced(ClockName.BOOT)
    before = (state.airframe, state.counters, state.filters, state.clocks)

    def raising(_state: Any, _record: Any) -> Any:
        raise ValueError("made on purpose")

    monkeypatch.setitem(pipeline._HANDLERS, type(record), raising)
    after, outputs = contained(state, record)
    assert (after.airframe, after.counters, after.filters) == before[:3]
    assert after.corrections == state.corrections
    assert set(after.corrections.shift_ns.values()) == {-10_000_000}
    assert after.airborne_ns == 9 * S
    assert after.tracker is not state.tracker
    assert after.correction is not state.correction
    assert (after.clocks is state.clocks) == (not isinstance(record, TimesyncReply))
    assert [entry.reason for entry in outputs if isinstance(entry, Rejected)] == [Reject.INTERNAL_ERROR]
    assert sum(isinstance(entry, Notice) for entry in outputs) == 1
    with pytest.raises(ValueError, match="made"):
        step(state, record)


def test_bytes_that_raise_in_the_decoder_are_refused_and_the_next_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    records = Translator.records

    def raising(self: Translator, heard: Any) -> Any:
        if heard.name == "VFR_HUD":
            raise IndexError("no such field")
        return records(self, heard)

    monkeypatch.setattr(Translator, "records", raising)
    packer = mavlink.MAVLink(None, 1, 1)
    bad = mavlink.MAVLink_vfr_hud_message(17, 18, 90, 55, 120, 0).pack(packer)
    beat = mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(packer)
    sample = mavlink.MAVLink_highres_imu_message(5000, *(0.0,) * 6, *[0] * 7, 63).pack(packer)
    decoder = Decoder(AIRFRAME, 191)
    decoder.decode_chunk(RawChunk(0, S, beat))
    first = decoder.decode_chunk(RawChunk(0, S, bad + b"\xfd\x09"))
    assert [type(entry) for entry in first] == [Rejected, Notice]
    assert first[0].reason is Reject.INTERNAL_ERROR
    assert "IndexError: no such field" in first[1].text
    assert decoder.decode_chunk(RawChunk(0, S + 1, bad)) == [], "told once a second"
    assert any(isinstance(entry, ImuBatch) for entry in decoder.decode_chunk(RawChunk(0, S + 2, sample)))


def test_what_cannot_be_sent_is_told_and_the_rest_goes_out(monkeypatch: pytest.MonkeyPatch) -> None:
    publish = MavlinkAutopilot.publish

    def raising(self: MavlinkAutopilot, record: Any) -> None:
        if isinstance(record, ServiceStatus):
            raise OverflowError("does not fit")
        publish(self, record)

    monkeypatch.setattr(MavlinkAutopilot, "publish", raising)
    run = SimulatedService(build_flight(AIRFRAME, 1, 4.0))
    tape = run.fly(3.5)
    run.close()
    said = [entry.text for entry in tape.of(Notice) if "not sent: OverflowError: does not fit" in entry.text]
    assert 2 <= len(said) <= 4
    assert said[0] in "".join(run.world.report()["statustexts"])

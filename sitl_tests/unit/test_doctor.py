"""Advice and command of the doctor: what is offered can be set, what a log cannot hold is unknown, codes are true."""

from __future__ import annotations

import dataclasses
import json
import struct
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.cli import doctor
from companion.cli.main import main
from companion.doctor.evidence import Beat, Evidence, Finding, FindingLevel, Fix
from companion.doctor.ranging import check_ranging
from companion.doctor.timing import check_filters, check_rates
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import AutopilotParameter, ClockName, Station
from sitl_tests.unit.test_recordings_bin import flight, write

AIRFRAME = load_airframe("nadir-2m")
PX4, ARDUPILOT = mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
NODES_IN_A_LOG = ("left: component 200 is not in", "right: component 201 is not in")


def evidence_of(parameters: dict[str, float] | None = None, autopilot: int = ARDUPILOT, **changes: Any) -> Evidence:
    beats = {(1, 1): Beat(mavlink.MAV_TYPE_FIXED_WING, autopilot, 10)}
    base = Evidence(AIRFRAME, Settings(), live=True, seconds=10.0, system=1, beats=beats, parameters=parameters or {})
    return dataclasses.replace(base, **changes)


def fixes(findings: Iterator[Finding]) -> list[str]:
    return [str(fix) for entry in findings for fix in entry.fixes]


def stiff(frequency_hz: float) -> Airframe:
    wing = AIRFRAME.wing.with_modes(
        lambda _, mode: dataclasses.replace(mode, frequency_hz=Uncertain(frequency_hz, 1.0))
    )
    return dataclasses.replace(AIRFRAME, wing=wing)


def float32(value: float) -> float:
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def test_a_range_finder_is_not_offered_for_our_ranges_and_then_switched_off() -> None:
    """A lidar on the first of range finders whose others are not told: the second fix undid the first."""
    evidence = evidence_of({"RNGFND1_TYPE": 8.0, "RNGFND1_ORIENT": 25.0})
    assert fixes(check_ranging(evidence)) == ["set RNGFND1_TYPE 10, reboot"]


@pytest.mark.parametrize(("low_m", "high_m"), [(0.6, 120.1), (4.1, 99.9), (4.0, 200.0)])
def test_a_limit_that_was_set_as_advised_is_not_advised_again(low_m: float, high_m: float) -> None:
    """An autopilot holds 32-bit floats: its 0.6 is 0.60000002."""
    limits = {"RNGFND1_MIN": float32(low_m), "RNGFND1_MAX": float32(high_m)}
    settings = Settings(min_range_m=low_m, max_range_m=high_m)
    evidence = evidence_of({"RNGFND1_TYPE": 10.0, "RNGFND1_ORIENT": 25.0} | limits, settings=settings)
    assert fixes(check_ranging(evidence)) == []


@pytest.mark.parametrize(("cutoff_hz", "advised"), [(100.0, ["256"] * 2), (256.0, [])])
def test_a_filter_is_raised_to_what_is_believed_at_most(cutoff_hz: float, advised: list[str]) -> None:
    """360 Hz was advised for a 90 Hz mode, and then not believed."""
    evidence = evidence_of({"INS_ACCEL_FILTER": cutoff_hz, "INS_GYRO_FILTER": cutoff_hz}, airframe=stiff(90.0))
    said = list(check_filters(evidence))
    assert [fix.rpartition(" ")[2] for fix in fixes(iter(said))] == advised
    evidence.airframe = stiff(180.0)
    assert [fix.rpartition(" ")[2] for fix in fixes(check_filters(evidence))] == advised


@pytest.mark.parametrize(("autopilot", "expected"), [(ARDUPILOT, True), (PX4, False)])
def test_a_small_board_is_blamed_where_it_is_ardupilots(autopilot: int, *, expected: bool) -> None:
    said = " ".join(entry.text for entry in check_rates(evidence_of(autopilot=autopilot)))
    assert "root: no HIGHRES_IMU arrives" in said
    assert ("1 MB of flash" in said) is expected


# ------------------------------------------------------------------------------------------ logs


def test_an_autopilots_own_log_is_not_blamed_for_nodes_that_it_cannot_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = write(tmp_path, flight(1000).data)
    assert main(["doctor", "--log", str(log), "--airframe", "nadir-2m"]) == 0
    said = capsys.readouterr().out
    assert all(sentence in said for sentence in NODES_IN_A_LOG)
    assert "FIX" not in said


def test_the_rate_of_a_log_of_its_own_is_no_fault_of_a_line() -> None:
    slow = evidence_of({"SCHED_LOOP_RATE": 400.0}, live=False, rate_hz={Station.ROOT: 25.0})
    (live,) = [entry for entry in check_rates(slow) if entry.subject == "rate"]
    assert (live.level, "raise the baud rate" in live.text) == (FindingLevel.FIX, True)
    slow.onboard = True
    (logged,) = [entry for entry in check_rates(slow) if entry.subject == "rate"]
    assert (logged.level, "raise the baud rate" in logged.text) == (FindingLevel.UNKNOWN, False)


def test_a_recording_of_ours_is_judged_by_the_settings_that_flew_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "flight.mcap"
    writer = McapWriter(path, About.of(AIRFRAME, Settings(max_range_m=80.0), ClockName.HOST))
    for name, value in (("RNGFND1_TYPE", 10.0), ("RNGFND1_ORIENT", 25.0), ("RNGFND1_MAX", 100.0)):
        writer.write(AutopilotParameter(name, value, 1))
    writer.close()
    command = ["doctor", "--log", str(path), "--airframe", "nadir-2m"]
    main(command)
    assert "RNGFND1_MAX 200" not in capsys.readouterr().out
    main([*command, "--set", "RNG_MIN=5"])
    assert "RNGFND1_MAX 200" not in capsys.readouterr().out
    main([*command, "--set", "RNG_MAX=150"])
    assert "set RNGFND1_MAX 150" in capsys.readouterr().out


# ------------------------------------------------------------------------------------------ the command


class StubExamination:
    """An examination that is over, of an autopilot that takes what is set."""

    def __init__(self, evidence: Evidence) -> None:
        self.over = True
        self._evidence = evidence
        self.pilot = SimpleNamespace(set_parameter=evidence.parameters.__setitem__, close=lambda: None)

    def evidence(self) -> Evidence:
        return self._evidence

    def run_once(self) -> None:
        raise AssertionError("the answer is there already")


@pytest.fixture
def examined(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Run the command on an autopilot that sends these findings alone."""

    def run(findings: list[Finding], *words: str) -> int:
        monkeypatch.setattr(doctor, "open_link", lambda *_: None)
        monkeypatch.setattr(doctor, "Examination", lambda *_, **__: StubExamination(evidence_of()))
        monkeypatch.setattr(doctor, "diagnose", lambda _: iter(findings))
        return main(["doctor", "--connect", "udpin:127.0.0.1:1", "--airframe", "nadir-2m", *words])

    return run


OPTIONAL = Finding.note("range", "steer no landing", Fix("RNGFND_LANDING", 1.0))
NEEDED = Finding.fix("range", "not used", Fix("RNGFND1_TYPE", 10.0, reboot=True))


@pytest.mark.parametrize(
    ("findings", "answers", "code"),
    [
        ([OPTIONAL], ["n"], 0),
        ([NEEDED], ["n"], 4),
        ([OPTIONAL, NEEDED], ["n", "y"], 0),
        ([OPTIONAL, NEEDED], ["y", "n"], 4),
    ],
)
def test_what_was_declined_and_need_not_be_is_nothing_to_fix(
    findings: list[Finding],
    answers: list[str],
    code: int,
    examined: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("builtins.input", lambda *_: answers.pop(0))
    assert examined(findings, "--fix") == code


def test_findings_as_json_stay_json_while_fixes_are_set(
    examined: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert examined([NEEDED], "--fix", "--yes", "--json") == 0
    said = capsys.readouterr()
    assert json.loads(said.out)[0]["text"] == "not used"
    assert "RNGFND1_TYPE is now 10" in said.err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--log", "flight.BIN", "--fix"], "of --connect"),
        (["--log", "flight.BIN", "--sign-key", "wing.key"], "of --connect"),
        (["--connect", "udpin:127.0.0.1:0", "--yes"], "--yes is of --fix"),
    ],
)
def test_options_that_would_do_nothing_are_refused(
    words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["doctor", "--airframe", "nadir-2m", *words]) == 1
    assert sentence in capsys.readouterr().err

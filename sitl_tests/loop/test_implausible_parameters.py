"""Implausible parameters of a vehicle: told once, with the range, and not used; the ranges go on."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.vehicle.periodic_requests import NEEDED_PARAMETERS
from companion.cli.doctor import diagnose
from companion.core.autopilot_filters import NAMES
from companion.core.pipeline import start, step
from companion.doctor.evidence import Evidence, FindingLevel
from companion.doctor.parameters import check_parameters
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.params.vehicle import VEHICLE_PARAMETERS, implausible
from companion.records import AutopilotParameter, CorrectedRange, Notice, Reject, Rejected
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.simulated_service import SimulatedService

WILD = (
    ("IMU_INTEG_RATE", 1.0), ("IMU_INTEG_RATE", -5.0), ("IMU_INTEG_RATE", 1e30),
    ("INS_GYRO_FILTER", 0.001), ("INS_ACCEL_FILTER", 0.001), ("INS_ACCEL_FILTER", -20.0), ("INS_GYRO_FILTER", 1e20),
    ("INS_HNTCH_BW", 1e-30), ("INS_HNTCH_ATT", 1e-30), ("INS_HNTCH_ATT", -1e6), ("INS_HNTCH_FREQ", 1e-3),
    ("INS_HNTCH_HMNCS", 1e30), ("INS_HNTC2_BW", math.inf), ("INS_GYRO_FILTER", math.nan),
    ("SCHED_LOOP_RATE", 0.0), ("SCHED_LOOP_RATE", 1e-3), ("SCHED_LOOP_RATE", math.inf),
)  # fmt: skip


def frame(name: str, value: float, packer: Any) -> bytes:
    kind = mavlink.MAV_PARAM_TYPE_REAL32
    return bytes(mavlink.MAVLink_param_value_message(name.encode(), value, kind, 900, 7).pack(packer))


@pytest.mark.slow
def test_no_parameter_of_the_vehicle_stops_the_ranges_and_each_is_said_once() -> None:
    run = SimulatedService(build_flight(load_airframe("nadir-2m"), 1, 15.0))
    packer = mavlink.MAVLink(None, 1, 1)
    run.fly(3.0)
    before = run.loop.state.airframe
    tracker = run.loop.state.tracker
    # a narrow notch that is switched on, so that its width and depth matter
    for name, value in (("INS_HNTCH_ENABLE", 1.0), ("INS_HNTCH_FREQ", 80.0), ("INS_HNTCH_BW", 5.0)):
        run.wire.to_companion.append(frame(name, value, packer))
    run.fly(3.1)
    delay_s = run.loop.state.filters.gyro_delay_s
    run.wire.to_companion.append(frame("IMU_INTEG_RATE", 1e-38, packer))
    run.fly(3.2)
    assert "IMU_INTEG_RATE 1e-38 on the vehicle is not 50 to 1000 Hz" in "".join(run.world.report()["statustexts"])
    for _ in range(2):
        for name, value in WILD:
            run.wire.to_companion.append(frame(name, value, packer))
        run.fly(run.flown_s + 0.3)
    tape = run.fly(14.0)
    run.close()
    said = [notice.text for notice in tape.of(Notice) if "on the vehicle is not" in notice.text]
    assert {text.split()[0] for text in said} == {name for name, _ in WILD}
    assert len(said) == len({name for name, _ in WILD}), "once each, though told again"
    refused = sum(entry.count for entry in tape.of(Rejected) if entry.reason is Reject.IMPLAUSIBLE)
    assert refused == 1 + 2 * len(WILD)
    assert run.loop.state.airframe == before
    assert run.loop.state.tracker is tracker
    assert run.loop.state.filters.gyro_delay_s == delay_s > 0.0
    assert run.loop.state.filters.stamp_shift_ns == 0
    trusted = [entry for entry in tape.of(CorrectedRange, 12.0) if entry.trusted]
    assert len(trusted) > 5, len(tape.of(CorrectedRange, 12.0))


def test_a_good_value_is_taken_again_and_the_next_wild_one_said_again() -> None:
    state = start(load_airframe("nadir-2m"), Settings())

    def outputs_for(value: float) -> list[Any]:
        return step(state, AutopilotParameter("INS_GYRO_FILTER", value, 1))[1]

    assert [type(entry) for entry in outputs_for(0.001)] == [Rejected, Notice]
    assert [type(entry) for entry in outputs_for(math.nan)] == [Rejected]
    assert state.airframe.root.lowpass_gyro_hz == load_airframe("nadir-2m").root.lowpass_gyro_hz
    outputs_for(40.0)
    assert state.airframe.root.lowpass_gyro_hz == 40.0
    assert [type(entry) for entry in outputs_for(0.001)] == [Rejected, Notice]
    assert state.airframe.root.lowpass_gyro_hz == 40.0, "what it told last that can be"
    outputs_for(0.0)
    assert state.airframe.root.lowpass_gyro_hz == 0.0, "0 switches the filter off"


def test_every_parameter_that_is_asked_for_is_in_the_table() -> None:
    assert {*NAMES, *NEEDED_PARAMETERS} <= VEHICLE_PARAMETERS.keys()


@pytest.mark.parametrize("name", sorted(VEHICLE_PARAMETERS))
def test_each_row_says_its_range_and_refuses_what_is_no_number(name: str) -> None:
    row = VEHICLE_PARAMETERS[name]
    assert row.low < row.high
    assert row.purpose
    assert implausible(name, row.low) is implausible(name, row.high) is None
    for wild in (math.nan, math.inf, -math.inf, row.low - 1e-3 * (1 + abs(row.low)) - 1.0, 1.01 * row.high + 1.0):
        text = implausible(name, wild)
        assert text is not None
        assert name in text
        assert f"{row.low:g} to {row.high:g}" in text


@pytest.mark.parametrize(("name", "value"), WILD)
def test_the_doctor_goes_by_no_value_that_cannot_be(name: str, value: float) -> None:
    px4 = {"IMU_ACCEL_CUTOFF": 30.0, "IMU_GYRO_CUTOFF": 30.0} if name.startswith("IMU_") else {}
    evidence = Evidence(load_airframe("nadir-2m"), Settings(), live=True, parameters={**px4, name: value})
    (finding,) = check_parameters(evidence)
    assert finding.level is FindingLevel.FIX
    assert name in finding.text
    assert evidence.parameter(name) is None
    for entry in diagnose(evidence):
        assert "nan" not in entry.text.replace(finding.text, "")

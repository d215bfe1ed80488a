"""The doctor against the simulated vehicle, stepped by hand: each thing set wrong is found, with its exact fix."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.message_records import Heard
from companion.adapters.mavlink.link.link import Link
from companion.adapters.recordings.recording import Recording
from companion.adapters.recordings.recording_factory import open_recording
from companion.cli import doctor
from companion.cli.doctor import apply, diagnose
from companion.doctor.evidence import Beat, Evidence, Finding, FindingLevel, Fix
from companion.doctor.examine import Examination, note, read_log
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.params.vehicle import VEHICLE_PARAMETERS
from companion.records import Axis, ClockName, ImuBatch, Station
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.vehicle.faults import Faults
from companion.sim.vehicle.world import World, WorldOptions
from sitl_tests.loop.ground_stations import TurnedClock
from sitl_tests.loop.simulated_service import SimulatedService

MS = 1_000_000
SECONDS = 5.0
AIRFRAME = load_airframe("nadir-2m")


class Pipe:
    """Both ends of a link in memory: the world's and ours."""

    def __init__(self) -> None:
        self.inward = b""
        self.outward = b""
        self.ours: list[bytes] = []

    def send(self, frames: list[bytes]) -> None:
        self.outward += b"".join(frames)

    def drain(self) -> bytes:
        data, self.inward = self.inward, b""
        return data

    def close(self) -> None:
        pass


class OurEnd:
    def __init__(self, pipe: Pipe) -> None:
        self.pipe = pipe

    def fileno(self) -> int:
        return -1

    def receive(self, limit: int, now_host_ns: int) -> bytes:
        data, self.pipe.outward = self.pipe.outward, b""
        return data

    def send(self, data: bytes) -> bool:
        self.pipe.inward += data
        return True

    def close(self) -> None:
        pass


class Ward:
    """A simulated vehicle and the doctor listening to it, on one clock that the test turns."""

    def __init__(self, flight: Flight, settings: Settings | None = None, **options: Any) -> None:
        self.pipe, self.clock = Pipe(), TurnedClock()
        self.world = World(flight, WorldOptions(**options), self.pipe)  # type: ignore[arg-type]
        self.began = self.clock.now
        self.examination = Examination(
            [Link(0, "memory", OurEnd(self.pipe), self.clock)], self.clock, AIRFRAME, settings or Settings(), SECONDS
        )
        # whoever waits for time to pass lets the vehicle fly
        self.examination.run_once = self.run_once  # type: ignore[method-assign]
        self._poll = Examination.run_once

    def run_once(self, timeout_s: float = 0.0) -> None:
        self.clock.now += 2 * MS
        self.world.run_once(self.clock.now - self.began, self.clock.now)
        self._poll(self.examination, 0.0)

    def listen(self, extra: Any = None) -> list[Finding]:
        count = 0
        while not self.examination.over:
            count += 1
            if extra is not None and count % 100 == 0:
                self.pipe.outward += extra(count)
            self.run_once()
        return list(diagnose(self.examination.evidence()))


@pytest.fixture(scope="module")
def flight() -> Flight:
    return build_flight(AIRFRAME, 4, 12.0)


def wrong(findings: list[Finding]) -> dict[str, list[str]]:
    return {entry.text: [str(fix) for fix in entry.fixes] for entry in findings if entry.level is FindingLevel.FIX}


def fixes(findings: list[Finding]) -> set[str]:
    return {str(fix) for entry in findings for fix in entry.fixes}


def test_a_vehicle_that_is_set_up_well_has_nothing_to_fix(flight: Flight) -> None:
    findings = Ward(flight).listen()
    assert wrong(findings) == {}
    subjects = {entry.subject for entry in findings if entry.level is FindingLevel.OK}
    assert {"heartbeat", "wire", "routing", "ids", "loop", "rate", "filter", "clock", "wing", "range"} <= subjects
    assert any("0.24 mrad" in entry.text for entry in findings)


@pytest.mark.parametrize(
    ("parameters", "fix"),
    [
        ({"RNGFND1_MAX": 7.0}, "set RNGFND1_MAX 200"),
        ({"RNGFND1_MIN": 10.0}, "set RNGFND1_MIN 4"),
        ({"RNGFND1_TYPE": 0.0}, "set RNGFND1_TYPE 10, reboot"),
        ({"RNGFND1_ORIENT": 0.0}, "set RNGFND1_ORIENT 25"),
        ({"INS_ACCEL_FILTER": 10.0}, "set INS_ACCEL_FILTER 30"),
        ({"INS_GYRO_FILTER": 8.0}, "set INS_GYRO_FILTER 30"),
        ({"SCHED_LOOP_RATE": 50.0}, "set SCHED_LOOP_RATE 400, reboot"),
        ({"RNGFND2_TYPE": 20.0, "RNGFND2_ORIENT": 25.0}, "set RNGFND2_TYPE 0, reboot"),
        ({"RNGFND4_TYPE": 20.0, "RNGFND4_ORIENT": 25.0}, "set RNGFND4_TYPE 0, reboot"),
    ],
)
def test_each_wrong_parameter_is_found_and_its_fix_named(
    flight: Flight, parameters: dict[str, float], fix: str
) -> None:
    findings = Ward(flight, parameters=parameters).listen()
    assert fix in fixes(findings)
    assert len(wrong(findings)) in (1, 2) if "SCHED_LOOP_RATE" in parameters else len(wrong(findings)) == 1


@pytest.mark.parametrize("autopilot", [mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, mavlink.MAV_AUTOPILOT_PX4])
@pytest.mark.parametrize("kind", [mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_TYPE_QUADROTOR])
def test_the_autopilot_is_asked_for_every_parameter_that_a_check_reads(
    monkeypatch: pytest.MonkeyPatch, autopilot: int, kind: int
) -> None:
    """One that is not asked for is 'not answered by the autopilot'; one without a range is believed at any value."""
    read: set[str] = set()

    def noted(evidence: Evidence, *names: str) -> tuple[str, float] | None:
        read.update(names)
        return as_it_is(evidence, *names)

    as_it_is = Evidence.parameter
    monkeypatch.setattr(Evidence, "parameter", noted)
    list(diagnose(evidence_of(beats={(1, 1): Beat(kind, autopilot, 10)})))
    assert read
    assert read <= set(VEHICLE_PARAMETERS), "the rows of companion/params/vehicle.py"


def test_a_landing_that_takes_no_ranges_is_a_warning_with_its_fix(flight: Flight) -> None:
    findings = Ward(flight, parameters={"RNGFND_LANDING": 0.0}).listen()
    assert fixes(findings) == {"set RNGFND_LANDING 1"}
    assert wrong(findings) == {}


def test_agreed_fixes_are_set_and_the_rest_is_left(flight: Flight) -> None:
    ward = Ward(flight, parameters={"RNGFND1_MAX": 7.0, "RNGFND1_MIN": 10.0, "SCHED_LOOP_RATE": 50.0})
    asked = [fix for entry in ward.listen() for fix in entry.fixes]
    said: list[str] = []
    left = apply(asked, ward.examination, ward.clock, lambda fix: fix.name != "RNGFND1_MIN", said.append)
    assert [fix.name for fix in left] == ["RNGFND1_MIN"]
    autopilot = ward.world.autopilot.parameters
    assert autopilot.get("RNGFND1_MAX") == 200.0
    assert autopilot.get("RNGFND1_MIN") == 10.0
    assert any("reboot" in text and "SCHED_LOOP_RATE" in text for text in said)


@pytest.mark.slow
def test_a_parameter_that_the_vehicle_does_not_take_is_said(flight: Flight) -> None:
    ward = Ward(flight)
    ward.listen()
    said: list[str] = []
    fix = Fix("NO_SUCH_THING", 1.0)
    assert apply([fix], ward.examination, ward.clock, lambda _: True, said.append) == [fix]
    assert "did not take" in said[0]


@pytest.mark.slow
def test_a_silent_node_a_stopped_one_and_a_dead_vehicle(flight: Flight) -> None:
    findings = Ward(flight, faults=Faults(silences=((200, 0.0, 99.0),))).listen()
    text = " ".join(wrong(findings))
    assert "left: component 200 is silent" in text
    assert "only the right tip" in text
    assert "node_left: TIMESYNC is not answered" in text
    stopped = Faults(stops=((200, 0.0, 99.0), (201, 0.0, 99.0)))
    text = " ".join(wrong(Ward(flight, faults=stopped).listen()))
    assert "component 201 beats but sends no HIGHRES_IMU" in text
    assert "no wingtip is measured" in text
    dead = Ward(flight, faults=Faults(silences=((1, 0.0, 99.0), (200, 0.0, 99.0), (201, 0.0, 99.0)))).listen()
    assert len(dead) == 1
    assert "nothing arrives" in dead[0].text


def test_a_lossy_link_is_not_mistaken_for_a_broken_vehicle_but_rates_tell(flight: Flight) -> None:
    findings = Ward(flight, faults=Faults(loss=0.4)).listen()
    assert any("not 1000" in text for text in wrong(findings))
    assert not [fix for fix in fixes(findings) if fix.startswith(("RNGFND", "INS"))]


def test_another_component_with_our_id_and_a_rival_rangefinder_are_named(flight: Flight) -> None:
    twin, rival = mavlink.MAVLink(None, 1, 191), mavlink.MAVLink(None, 1, 192)

    def extra(count: int) -> bytes:
        strange = mavlink.MAVLink_timesync_message(0, 1_000_000 + count).pack(twin)
        ranging = mavlink.MAVLink_distance_sensor_message(count, 20, 4000, 1000, 0, 0, 25, 1).pack(rival)
        sideways = mavlink.MAVLink_distance_sensor_message(count, 20, 4000, 1000, 0, 1, 2, 1).pack(rival)
        return bytes(strange + ranging + sideways)

    problems = wrong(Ward(flight).listen(extra))
    assert len(problems) == 2
    text = " ".join(problems)
    assert "another component speaks as 1/191" in text
    assert "1/192 also sends DISTANCE_SENSOR of orientation 25" in text


def test_our_own_ranges_repeated_by_the_autopilot_are_no_rival(flight: Flight) -> None:
    pilot = mavlink.MAVLink(None, 1, 1)
    report = mavlink.MAVLink_distance_sensor_message(1, 20, 4000, 1000, 10, 0, 25, 1)
    assert wrong(Ward(flight).listen(lambda _: bytes(report.pack(pilot)))) == {}


# ------------------------------------------------------------------------------------------ without a flight


def evidence_of(**changes: Any) -> Evidence:
    base = Evidence(AIRFRAME, Settings(), live=True, seconds=10.0, system=1)
    return dataclasses.replace(base, **changes)


def texts(evidence: Evidence, check: Any) -> str:
    return " ".join(f"{entry.level} {entry.text} {' '.join(map(str, entry.fixes))}" for entry in check(evidence))


@pytest.mark.parametrize(("name", "value", "fix"), [("RNGFND1_MAX_CM", 700.0, "set RNGFND1_MAX_CM 20000")])
def test_limits_of_older_versions_are_in_centimetres(name: str, value: float, fix: str) -> None:
    evidence = evidence_of(parameters={"RNGFND1_TYPE": 10.0, name: value})
    assert fix in texts(evidence, doctor.check_ranging)
    evidence.parameters[name] = 30000.0
    assert "FIX" not in texts(evidence, doctor.check_ranging)


LIDAR_AHEAD = {"RNGFND1_TYPE": 20.0, "RNGFND1_ORIENT": 0.0, "RNGFND1_MAX": 20.0}


@pytest.mark.parametrize(
    ("second", "fix"),
    [
        ({"RNGFND2_TYPE": 10.0, "RNGFND2_ORIENT": 25.0, "RNGFND2_MAX": 250.0}, ""),
        ({"RNGFND2_TYPE": 10.0, "RNGFND2_ORIENT": 25.0, "RNGFND2_MAX": 20.0}, "set RNGFND2_MAX 200"),
        ({"RNGFND2_TYPE": 10.0, "RNGFND2_ORIENT": 0.0, "RNGFND2_MAX": 250.0}, "set RNGFND2_ORIENT 25"),
        ({"RNGFND2_TYPE": 20.0, "RNGFND3_TYPE": 0.0}, "set RNGFND3_TYPE 10, reboot"),
    ],
)
def test_a_lidar_that_looks_elsewhere_keeps_its_place(second: dict[str, float], fix: str) -> None:
    evidence = evidence_of(parameters=LIDAR_AHEAD | second)
    assert fixes(doctor.check_ranging(evidence)) == ({fix} if fix else set())


@pytest.mark.parametrize(("kind", "is_rival"), [(10.0, False), (20.0, True)])
def test_the_autopilots_copy_of_our_ranges_is_no_second_sender(kind: float, is_rival: bool) -> None:
    """A lidar ahead on RNGFND1, and ours, or a second lidar, on RNGFND2: the autopilot reports both."""
    second = {"RNGFND2_TYPE": kind, "RNGFND2_ORIENT": 25.0, "RNGFND2_MAX": 250.0}
    evidence = evidence_of(parameters=LIDAR_AHEAD | second, range_senders=Counter({(1, 1, 25): 40, (1, 1, 0): 40}))
    assert ("1/1 also sends DISTANCE_SENSOR" in texts(evidence, doctor.check_ranging)) is is_rival


@pytest.mark.parametrize(
    ("axes", "expected_mrad"), [(Axis.Z, 0.47), (Axis.Z | Axis.Y, 0.26), (Axis.Z | Axis.P, 0.33), (Axis.ALL, 0.24)]
)
def test_the_axes_that_arrive_say_what_accuracy_they_allow(axes: Axis, expected_mrad: float) -> None:
    both = {Station.LEFT: axes, Station.RIGHT: Axis.ALL}
    said = texts(evidence_of(axes=both, rate_hz={Station.LEFT: 1000.0, Station.RIGHT: 1000.0}), doctor.check_nodes)
    assert f"about {expected_mrad:.2f} mrad" in said
    assert ("axes" in said and "never come" in said) is (axes is not Axis.ALL)


@pytest.mark.parametrize("begins_s", [(0.0,), (0.0, 1.0), (7.0, 0.2), (7.0, 0.2, 0.1)])
def test_the_rate_of_a_log_is_that_between_restarts_of_the_clock(begins_s: tuple[float, ...]) -> None:
    """A station whose clock began anew, and did not reach its first stamp again, was silent."""
    values = np.tile([0.0, 0.0, -9.8, 0.0, 0.0, 0.0], (250, 1))
    stamps = [round(begin_s * 1e9) + MS * np.arange(1000, dtype=np.int64) for begin_s in begins_s]
    batches = [
        ImuBatch(Station.LEFT, ClockName.BOOT, part_ns, values, Axis.ALL, 0)
        for t_ns in stamps
        for part_ns in np.split(t_ns, 4)
    ]
    recording = argparse.Namespace(records=lambda: iter(batches))
    evidence = read_log(cast("Recording", recording), AIRFRAME, Settings())
    assert evidence.rate_hz == pytest.approx({Station.LEFT: 1000.0})


def test_an_autopilot_of_another_make_is_named_by_its_ids() -> None:
    strange = evidence_of(beats={(1, 1): Beat(mavlink.MAV_TYPE_FIXED_WING, mavlink.MAV_AUTOPILOT_GENERIC, 10)})
    assert "autopilot 1/1 beats at 1.0 Hz" in texts(strange, doctor.check_link)


@pytest.mark.parametrize(("every", "level"), [(0, None), (50, "note"), (4, "FIX"), (1, "FIX")])
def test_samples_at_the_limit_are_told_by_station_with_the_remedy(every: int, level: str | None) -> None:
    values = np.zeros((1000, 6))
    values[:, 2] = -9.8
    if every:
        values[::every, 2] = -AIRFRAME.left.accel_range_mps2
    evidence = evidence_of()
    t_ns = np.arange(1000, dtype=np.int64)
    for station in (Station.LEFT, Station.LEFT, Station.RIGHT):
        calm = np.tile([0.0, 0.0, -9.8, 0.0, 0.0, 0.0], (1000, 1))
        evidence.count_samples(
            ImuBatch(station, ClockName.HOST, t_ns, values if station is Station.LEFT else calm, Axis.ALL, 0)
        )
    said = texts(evidence, doctor.check_clipping)
    assert evidence.axes == {Station.LEFT: Axis.ALL, Station.RIGHT: Axis.ALL}
    if level is None:
        assert said == ""
    else:
        assert said.startswith(f"{level} left: {100 / every:g} % of the samples are at the sensor's limit")
        assert ("no range is trusted" in said) is (level == "FIX")
        assert "right" not in said


def test_clips_that_the_autopilot_counts_are_told_and_those_before_are_not(flight: Flight) -> None:
    pilot = mavlink.MAVLink(None, 1, 1)

    def counts(*clips: int) -> Callable[[int], bytes]:
        answers = iter(clips)
        return lambda _: bytes(
            mavlink.MAVLink_vibration_message(0, 1.0, 1.0, 1.0, next(answers, clips[-1]), 0, 0).pack(pilot)
        )

    assert "clipped 7 times" in " ".join(wrong(Ward(flight).listen(counts(10, 12, 17))))
    assert wrong(Ward(flight).listen(counts(10))) == {}


def test_a_serial_line_too_slow_for_a_node_is_named_with_what_it_needs() -> None:
    rates = {Station.LEFT: 400.0, Station.RIGHT: 1000.0}
    full = dict.fromkeys((Station.LEFT, Station.RIGHT), Axis.ALL)
    said = texts(
        evidence_of(axes=full, rate_hz=rates, serial_baud={"/dev/ttyAMA0,460800": 460_800}), doctor.check_nodes
    )
    assert "460800 baud" in said
    assert "750000" in said


def test_a_serial_line_is_held_against_a_nodes_stream_before_it_is_slow() -> None:
    full, rates = dict.fromkeys((Station.LEFT, Station.RIGHT), Axis.ALL), {Station.LEFT: 1000.0, Station.RIGHT: 1000.0}
    for baud, components, expected in (
        (921_600, {200}, "ok /dev/ttyS1: a node's stream needs 750000 baud of 921600"),
        (57_600, {200}, "FIX /dev/ttyS1: a node's stream needs 750000 baud of 57600"),
        (921_600, {1, 200, 201}, "FIX /dev/ttyS1: the streams of two nodes need 1500000 baud of 921600"),
        (1_500_000, {200, 201}, "ok /dev/ttyS1: the streams of two nodes need 1500000 baud"),
        (460_800, {1}, ""),
    ):
        lines = {"serial_baud": {"/dev/ttyS1": baud}, "link_components": {"/dev/ttyS1": components}}
        said = texts(evidence_of(axes=full, rate_hz=rates, **lines), doctor.check_nodes)
        assert expected in said
        assert ("/dev/ttyS1" in said) is bool(expected), "a line with the autopilot alone carries no node's stream"


def test_the_line_that_slows_a_node_is_one_on_which_it_was_heard() -> None:
    rates = {Station.LEFT: 400.0, Station.RIGHT: 1000.0}
    lines = {"serial_baud": {"/dev/ttyS0": 460_800, "/dev/ttyS1": 57_600}, "link_components": {"/dev/ttyS1": {200}}}
    full = dict.fromkeys((Station.LEFT, Station.RIGHT), Axis.ALL)
    said = texts(evidence_of(axes=full, rate_hz=rates, **lines), doctor.check_nodes)
    assert "not 1000: /dev/ttyS1 has 57600 baud" in said


def test_components_are_known_by_the_link_on_which_they_were_heard(flight: Flight) -> None:
    ward = Ward(flight)
    ward.listen()
    assert ward.examination.evidence().link_components == {"memory": {1, 200, 201}}


@pytest.mark.parametrize("notch", ["HNTCH", "HNTC2"])
def test_a_gyro_notch_on_the_modes_is_named(notch: str) -> None:
    for centre_hz, level in ((10.0, "FIX"), (80.0, "ok")):
        parameters = {f"INS_{notch}_ENABLE": 1.0, f"INS_{notch}_FREQ": centre_hz}
        said = texts(evidence_of(parameters=parameters), doctor.check_filters)
        assert f"{level} gyro notch at {centre_hz:g} Hz" in said
        assert (f"raise INS_{notch}_FREQ" in said) is (level == "FIX")


def test_what_a_node_says_that_it_lost_is_told_with_the_cause() -> None:
    full, rates = dict.fromkeys((Station.LEFT, Station.RIGHT), Axis.ALL), {Station.LEFT: 1000.0, Station.RIGHT: 1000.0}
    losses = {(200, "loop_lost"): 12, (201, "line_lost"): 7, (201, "line_bad"): 0, (158, "other"): 5}
    said = texts(evidence_of(axes=full, rate_hz=rates, node_losses=Counter(losses)), doctor.check_nodes)
    assert "FIX node 200: 12 readings lost because its loop came too late" in said
    assert "FIX node 201: 7 readings lost because its line is too slow" in said
    assert "damaged" not in said
    assert "158" not in said


def test_what_a_node_lost_before_it_was_heard_is_no_fault() -> None:
    """A USB port that no program reads fills up: 2,617 readings were lost before the doctor looked, and then three."""
    evidence = evidence_of()
    for count, lost in ((2617, 0), (2617, 0), (2620, 3), (1, 4)):  # the last after a new start of the node
        message = mavlink.MAVLink_named_value_int_message(0, b"line_lost", count)
        note(evidence, Heard(0, 1, 200, message, 0), 1)
        said = texts(evidence, doctor.check_nodes)
        assert (f"node 200: {lost} readings lost" in said) is (lost > 0)


def test_zero_one_and_two_nodes_each_have_a_stated_behaviour() -> None:
    said = [
        texts(
            evidence_of(axes=dict.fromkeys(alive, Axis.ALL), rate_hz=dict.fromkeys(alive, 1000.0)), doctor.check_nodes
        )
        for alive in ([], [Station.LEFT], [Station.LEFT, Station.RIGHT])
    ]
    assert "only 'alive, no range' goes out" in said[0]
    assert "larger sigma" in said[1]
    assert "both tips send xyzpqr" in said[2]


def test_a_deaf_node_will_be_aligned_by_what_it_measures_and_one_that_measures_nothing_of_use_cannot_be_used() -> None:
    said = texts(evidence_of(axes={Station.LEFT: Axis.ALL}), doctor.check_clocks)
    assert "note node_left: TIMESYNC is not answered; it will be aligned by its gyro" in said
    said = texts(evidence_of(axes={Station.LEFT: Axis.ACCEL, Station.RIGHT: Axis.X | Axis.Y}), doctor.check_clocks)
    assert "note node_left: TIMESYNC is not answered; it will be aligned by its vertical accelerometer" in said
    assert "FIX node_right: TIMESYNC is not answered; its samples cannot be used" in said


def test_a_computer_that_grants_no_priority_is_told_what_to_set() -> None:
    assert "rmem_max" in texts(evidence_of(buffer_shortfall=(212_992, 1 << 20)), doctor.check_computer)
    assert "LimitRTPRIO" in texts(evidence_of(realtime=False), doctor.check_computer)
    assert "ok" in texts(evidence_of(realtime=True), doctor.check_computer)
    assert texts(evidence_of(), doctor.check_computer) == ""


def test_copters_need_proximity_and_planes_have_none() -> None:
    forward = load_airframe("forward-2m")
    good = {"RNGFND1_TYPE": 10.0, "RNGFND1_ORIENT": 0.0, "PRX1_TYPE": 0.0}
    copter = evidence_of(airframe=forward, parameters=good, beats={(1, 1): Beat(mavlink.MAV_TYPE_QUADROTOR, 3, 10)})
    assert "set PRX1_TYPE 2, reboot" in texts(copter, doctor.check_ranging)
    plane = evidence_of(airframe=forward, parameters=good, beats={(1, 1): Beat(mavlink.MAV_TYPE_FIXED_WING, 3, 10)})
    said = texts(plane, doctor.check_ranging)
    assert "PRX1_TYPE" not in said
    assert "no proximity library" in said


@pytest.mark.parametrize(
    ("name", "autopilot", "used"),
    [("RNGFND_LANDING", mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 1.0), ("EKF2_RNG_CTRL", mavlink.MAV_AUTOPILOT_PX4, 2.0)],
)
def test_ranges_to_the_ground_that_the_autopilot_does_not_use_are_told(name: str, autopilot: int, used: float) -> None:
    def said(airframe: str, parameters: dict[str, float]) -> str:
        beats = {(1, 1): Beat(mavlink.MAV_TYPE_FIXED_WING, autopilot, 10)}
        evidence = evidence_of(airframe=load_airframe(airframe), beats=beats, parameters=parameters)
        return texts(evidence, doctor.check_ranging)

    assert f"set {name} 1" in said("nadir-2m", {name: 0.0})
    for airframe, parameters in (("nadir-2m", {name: used}), ("nadir-2m", {}), ("forward-2m", {name: 0.0})):
        assert name not in said(airframe, parameters)


def pictures(left: int, right: int = 0) -> dict[int, set[int]]:
    """Image numbers of cameras 0 and 1, as ArduPilot numbers these."""
    return {0: set(range(left)), **({1: set(range(right))} if right else {})}


def test_cameras_that_do_not_pair() -> None:
    assert "one camera only" in texts(evidence_of(feedback=pictures(10)), doctor.check_cameras)
    assert "does not pair" in texts(evidence_of(feedback=pictures(10, 7)), doctor.check_cameras)
    assert "ok" in texts(evidence_of(feedback=pictures(10, 10)), doctor.check_cameras)


def test_feedback_that_comes_twice_is_one_picture() -> None:
    """With two cameras ArduPilot repeats the first one's last feedback."""
    evidence = evidence_of()
    for camera, image in ((0, 1), (0, 1), (1, 1), (0, 2), (0, 2), (1, 2)):
        message = mavlink.MAVLink_camera_feedback_message(0, 0, camera, image, 0, 0, 0, 0, 0, 0, 0, 0, 0)
        note(evidence, Heard(0, 1, 1, message, 0), 1)
    assert "pairs: 2 and 2" in texts(evidence, doctor.check_cameras)


def test_a_camera_that_is_busy_longer_than_the_shots_are_apart() -> None:
    busy = evidence_of(feedback=pictures(9, 9), parameters={"CAM1_DURATION": 0.1, "CAM2_DURATION": 0.02})
    said = texts(busy, doctor.check_cameras)
    assert busy.settings.trigger_rate_hz == 10.0
    assert "set CAM1_DURATION 0.05" in said
    assert "CAM2" not in said


@pytest.mark.parametrize(
    ("shots", "pairs", "unpaired", "lost", "expected"),
    [
        (100, 98, 2, 2, "ok"),
        (100, 0, 0, 0, "check the trigger line"),
        (100, 60, 40, 0, "misses shots"),
        (100, 60, 0, 80, "80 that never came: the cameras, their link or this computer are too slow"),
        (0, 0, 0, 0, ""),
    ],
)
def test_a_recording_tells_what_became_of_its_shots(
    shots: int, pairs: int, unpaired: int, lost: int, expected: str
) -> None:
    evidence = evidence_of(live=False, shots=shots, pairs=pairs, unpaired=unpaired, lost=lost)
    said = texts(evidence, doctor.check_cameras)
    assert expected in said
    assert bool(said) is bool(expected)


# ------------------------------------------------------------------------------------------ logs


@pytest.mark.slow
def test_a_recording_of_ours_tells_rates_clocks_and_pairs(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    service = SimulatedService(build_flight(AIRFRAME, 4, 8.0), recording=path)
    service.fly(6.0)
    service.close()
    evidence = read_log(open_recording(path, AIRFRAME), AIRFRAME, Settings())
    said = texts(evidence, doctor.check_clocks) + texts(evidence, doctor.check_cameras)
    assert said.count("known to") == 3
    assert evidence.shots >= evidence.pairs > 10
    assert evidence.shots == service.cameras.made
    assert "FIX" not in said
    assert evidence.rate_hz[Station.LEFT] == pytest.approx(1000.0, rel=0.02)


DATA = Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[2].parent / "shared"))


@pytest.mark.long
@pytest.mark.parametrize("name", ["flight.tlog", "flight.BIN"])
def test_a_recorded_flight_is_examined(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = DATA / "recordings" / name
    if not path.is_file():
        pytest.skip(f"no {path.name} here")
    parser = argparse.ArgumentParser()
    doctor.add_arguments(parser)
    code = doctor.execute(parser.parse_args(["--log", str(path), "--airframe", "sitl-plane", "--json"]))
    findings = json.loads(capsys.readouterr().out)
    assert code in (0, 4)
    rates = [entry["text"] for entry in findings if entry["subject"] == "rate"]
    assert len(rates) == 3
    assert all("Hz" in text for text in rates)

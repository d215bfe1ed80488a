"""The simulated vehicle on the link: ArduPlane's habits, driven in simulated time, and once for real over UDP."""

from __future__ import annotations

import errno
import math
import multiprocessing
import socket
import struct
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.errors import LinkError
from companion.params.files import load_airframe
from companion.records import ClockName, Station
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.worlds import IDEAL
from companion.sim.vehicle.faults import Faults
from companion.sim.vehicle.mission_protocol import from_wire, to_wire
from companion.sim.vehicle.world import VehicleLink, World, WorldOptions, serve, serve_new
from tools import simulated_vehicle

COMPANION = 191
MS = 1_000_000


class FakeLink:
    """A link in memory; the peer is this test."""

    def __init__(self) -> None:
        self.inward = b""
        self.outward = b""

    def send(self, frames: list[bytes]) -> None:
        self.outward += b"".join(frames)

    def drain(self) -> bytes:
        data, self.inward = self.inward, b""
        return data


class Peer:
    """The companion's side: sends messages, collects what comes, in simulated time of 1 ms steps."""

    def __init__(self, flight: Flight, shots: list[int] | None = None, **options: Any) -> None:
        self.link = FakeLink()
        on_trigger = shots.append if shots is not None else None
        self.world = World(flight, WorldOptions(**options), self.link, on_trigger)  # type: ignore[arg-type]
        self.mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=COMPANION)
        self.parser = mavlink.MAVLink(None)
        self.parser.robust_parsing = True
        self.now_ns = 0
        self.messages: list[tuple[int, Any]] = []

    def send(self, message: Any, component: int = COMPANION) -> None:
        self.mav.srcComponent = component
        self.link.inward += message.pack(self.mav)

    def command(self, number: int, *params: float, target: int = 1) -> None:
        values = [*params, *([0.0] * (7 - len(params)))]
        self.send(mavlink.MAVLink_command_long_message(1, target, number, 0, *values))

    def run(self, seconds: float) -> list[Any]:
        start = len(self.messages)
        for _ in range(round(seconds * 1000)):
            self.now_ns += MS
            self.world.run_once(self.now_ns, 10**12 + self.now_ns)
            for message in self.parser.parse_buffer(self.link.outward) or []:
                self.messages.append((self.now_ns, message))
            self.link.outward = b""
        return [message for _, message in self.messages[start:]]

    def of(self, kind: str, component: int | None = None) -> list[tuple[int, Any]]:
        return [
            (t, m)
            for t, m in self.messages
            if m.get_type() == kind and (component is None or m.get_srcComponent() == component)
        ]

    def request(self, number: int, interval_us: int) -> tuple[int, list[str]]:
        self.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, number, interval_us)
        came = self.run(0.05)
        (result,) = [m.result for m in came if m.get_type() == "COMMAND_ACK"]
        return result, [m.text for m in came if m.get_type() == "STATUSTEXT"]


@pytest.fixture(scope="module")
def flight() -> Flight:
    return build_flight(load_airframe("nadir-2m"), 4, 12.0)


# ------------------------------------------------------------------------------------------ streams and rates


def test_every_component_says_hello_once_a_second(flight: Flight) -> None:
    peer = Peer(flight)
    peer.run(4.01)
    for component, kind in ((1, mavlink.MAV_TYPE_FIXED_WING), (200, mavlink.MAV_TYPE_IMU), (201, mavlink.MAV_TYPE_IMU)):
        beats = peer.of("HEARTBEAT", component)
        assert len(beats) in (4, 5)
        assert {beat.type for _, beat in beats} == {kind}
    assert not any(m.get_type() == "BAD_DATA" for _, m in peer.messages)


def test_rates_are_limited_by_the_loop_and_truncated_to_milliseconds(flight: Flight) -> None:
    peer = Peer(flight)
    result, texts = peer.request(105, 2000)
    assert result == mavlink.MAV_RESULT_DENIED
    assert texts
    assert peer.request(105, 3900)[0] == mavlink.MAV_RESULT_ACCEPTED
    peer.run(3.0)
    stamps = np.array([m.time_usec for _, m in peer.of("HIGHRES_IMU", 1)])
    assert np.mean(np.diff(stamps)) == pytest.approx(3000, rel=0.01), "3.9 ms is granted as 3 ms"
    # a stamp is the instant of sending: never later than the arrival, and at most a turn of this loop earlier
    for arrival_ns, message in peer.of("HIGHRES_IMU", 1):
        assert 0 <= arrival_ns - message.time_usec * 1000 <= 1.1 * MS
    assert peer.request(105, -1)[0] == mavlink.MAV_RESULT_ACCEPTED
    assert not [m for m in peer.run(0.5) if m.get_type() == "HIGHRES_IMU" and m.get_srcComponent() == 1]


def test_the_default_loop_of_a_plane_gives_forty_hertz_at_most(flight: Flight) -> None:
    peer = Peer(flight, parameters={"SCHED_LOOP_RATE": 50.0})
    assert peer.request(105, 24_000)[0] == mavlink.MAV_RESULT_DENIED
    assert peer.request(105, 25_000)[0] == mavlink.MAV_RESULT_ACCEPTED


def test_unknown_messages_and_commands_are_refused(flight: Flight) -> None:
    peer = Peer(flight)
    assert peer.request(99_999, 10_000)[0] == mavlink.MAV_RESULT_FAILED
    peer.command(mavlink.MAV_CMD_DO_SET_HOME)
    (answer,) = [m for m in peer.run(0.02) if m.get_type() == "COMMAND_ACK"]
    assert answer.result == mavlink.MAV_RESULT_UNSUPPORTED
    assert (answer.target_system, answer.target_component) == (1, COMPANION)


def test_nodes_send_what_their_sensors_read(flight: Flight) -> None:
    peer = Peer(flight)
    peer.run(2.0)
    for station, component in ((Station.LEFT, 200), (Station.RIGHT, 201)):
        stream = flight.streams()[station]
        frames = [m for _, m in peer.of("HIGHRES_IMU", component)]
        assert len(frames) == np.count_nonzero(stream.sent_boot_ns <= 2_000 * MS)
        values = np.array([[m.xacc, m.yacc, m.zacc, m.xgyro, m.ygyro, m.zgyro] for m in frames])
        np.testing.assert_allclose(values, stream.values[: len(frames)], rtol=1e-6)
        assert [m.time_usec * 1000 for m in frames] == stream.stamp_ns[: len(frames)].tolist()


def test_a_live_change_of_the_filter_changes_the_stream(flight: Flight) -> None:
    peer = Peer(flight)
    peer.request(105, 3000)
    peer.run(1.0)
    peer.send(mavlink.MAVLink_param_set_message(1, 1, b"INS_ACCEL_FILTER", 200.0, 9))
    (value,) = [m for m in peer.run(0.02) if m.get_type() == "PARAM_VALUE"]
    assert (value.param_id, value.param_value) == ("INS_ACCEL_FILTER", 200.0)
    peer.run(1.0)
    rows = [(t, m.xacc) for t, m in peer.of("HIGHRES_IMU", 1)]
    before = np.array([x for t, x in rows if t < 1000 * MS])
    after = np.array([x for t, x in rows if t > 1030 * MS])
    # ten times the bandwidth lets ten times the noise power through, and second differences show nothing else
    ratio = np.std(np.diff(after, 2)) / np.std(np.diff(before, 2))
    assert ratio > 3


def test_wing_sensors_wired_to_the_autopilot_are_sent_by_it() -> None:
    flight = build_flight(load_airframe("sitl-plane"), 1, 3.0)
    peer = Peer(flight)
    assert peer.world.nodes == []
    assert peer.request(116, 3000)[0] == mavlink.MAV_RESULT_ACCEPTED
    peer.run(2.0)
    rows = peer.of("SCALED_IMU2", 1)
    assert len(rows) == pytest.approx(2.05 / 0.003, rel=0.01)
    raw = flight.backends[Station.LEFT].raw
    # body z of a level flight, in thousandths of g
    assert np.mean([m.zacc for _, m in rows]) == pytest.approx(np.mean(raw[:2000, 2]) / 9.80665e-3, abs=30)


# ------------------------------------------------------------------------------------------ time


def test_timesync_answers_are_causal_and_on_the_right_clock(flight: Flight) -> None:
    peer = Peer(flight)
    asked: dict[int, int] = {}
    for k in range(40):
        asked[k + 1] = peer.now_ns
        peer.send(mavlink.MAVLink_timesync_message(0, k + 1))
        peer.run(0.037)
    answers = [(t, m) for t, m in peer.of("TIMESYNC") if m.tc1]
    assert Counter(m.get_srcComponent() for _, m in answers) == {1: 40, 200: 40, 201: 40}
    clocks = {200: ClockName.NODE_LEFT, 201: ClockName.NODE_RIGHT}
    for arrival_ns, message in answers:
        asked_ns, component = asked[message.ts1], message.get_srcComponent()
        if component == 1:
            assert asked_ns <= message.tc1 <= arrival_ns
        else:
            clock = flight.real.clocks[clocks[component]]
            assert clock.from_boot(asked_ns) <= message.tc1 <= clock.from_boot(arrival_ns)


@pytest.mark.slow
def test_the_autopilot_asks_for_the_time_itself(flight: Flight) -> None:
    peer = Peer(flight)
    peer.run(11.5)
    asked = [m for _, m in peer.of("TIMESYNC", 1) if m.tc1 == 0]
    assert len(asked) == 2
    assert asked[1].ts1 - asked[0].ts1 == pytest.approx(10e9, rel=1e-3)


def test_a_reboot_takes_clock_and_settings_back(flight: Flight) -> None:
    peer = Peer(flight, faults=Faults(reboots=((1, 2.0, 1.5), (200, 2.0, 1.0))))
    peer.request(105, 3000)
    peer.run(5.0)
    rows = peer.of("HIGHRES_IMU", 1)
    assert max(t for t, _ in rows) <= 2_001 * MS, "the rate that was asked for is forgotten"
    stamps = [(t, m.time_usec) for t, m in peer.of("RAW_IMU", 1)]
    assert not [t for t, _ in stamps if 2_001 * MS < t < 3_500 * MS]
    first = next(stamp for t, stamp in stamps if t > 3_500 * MS)
    assert 0 <= first < 100_000
    node = [(t, m.time_usec) for t, m in peer.of("HIGHRES_IMU", 200)]
    assert not [t for t, _ in node if 2_001 * MS < t < 3_000 * MS]
    after = [stamp for t, stamp in node if t > 3_000 * MS]
    assert after[0] < 5_000
    assert after == sorted(after)


# ------------------------------------------------------------------------------------------ parameters


def test_parameters_are_listed_read_and_set(flight: Flight) -> None:
    peer = Peer(flight)
    peer.send(mavlink.MAVLink_param_request_list_message(1, 1))
    values = [m for m in peer.run(0.3) if m.get_type() == "PARAM_VALUE"]
    assert [m.param_index for m in values] == list(range(values[0].param_count))
    names = {m.param_id: m.param_value for m in values}
    assert names["INS_ACCEL_FILTER"] == 20.0
    assert names["RNGFND1_ORIENT"] == 25.0
    peer.send(mavlink.MAVLink_param_request_read_message(1, 1, b"SCHED_LOOP_RATE", -1))
    (value,) = [m for m in peer.run(0.02) if m.get_type() == "PARAM_VALUE"]
    assert value.param_value == 400.0
    peer.send(mavlink.MAVLink_param_request_read_message(1, 1, b"NO_SUCH_THING", -1))
    assert not [m for m in peer.run(0.02) if m.get_type() == "PARAM_VALUE"]


def test_a_loop_rate_acts_from_the_next_boot(flight: Flight) -> None:
    peer = Peer(flight, faults=Faults(reboots=((1, 1.0, 0.5),)))
    peer.send(mavlink.MAVLink_param_set_message(1, 1, b"SCHED_LOOP_RATE", 50.0, 9))
    peer.run(0.1)
    assert peer.request(105, 3000)[0] == mavlink.MAV_RESULT_ACCEPTED
    peer.run(1.5)
    assert peer.request(105, 3000)[0] == mavlink.MAV_RESULT_DENIED


# ------------------------------------------------------------------------------------------ what the companion sends


def distance(centimetres: int, quality: int, orientation: int = 25) -> Any:
    return mavlink.MAVLink_distance_sensor_message(
        1000, 400, 20000, centimetres, 0, 1, orientation, 20, signal_quality=quality
    )


def test_ranges_are_used_by_orientation_quality_and_limits(flight: Flight) -> None:
    peer = Peer(flight, parameters={"RNGFND1_MAX": 70.0})
    for message in (distance(6012, 90), distance(6012, 1), distance(6012, 90, 0), distance(9000, 90)):
        peer.send(message)
        peer.run(0.1)
    peer.send(distance(5000, 90), component=1)
    peer.run(0.01)
    report = peer.world.report()
    assert [entry["used"] for entry in report["ranges"]] == [True, False, False, False]
    assert report["ranges"][0]["distance_m"] == pytest.approx(60.12)
    assert report["range_alive"]
    assert any("autopilot itself" in problem for problem in report["problems"])
    peer.run(0.6)
    report = peer.world.report()
    assert report["range_timeouts"] == 1
    assert not report["range_alive"]


def test_the_rangefinder_is_repeated_to_everyone_while_it_is_alive(flight: Flight) -> None:
    peer = Peer(flight)
    peer.run(0.6)
    assert peer.of("RANGEFINDER") == []
    for metres in (30, 31, 32):
        peer.send(distance(100 * metres, 90))
        peer.run(0.3)
    distances_m = [message.distance for _, message in peer.of("RANGEFINDER", 1)]
    assert set(distances_m) == {30.0, 31.0, 32.0}
    echoed = [m for _, m in peer.of("DISTANCE_SENSOR", 1)]
    assert {m.current_distance for m in echoed} == {3000, 3100, 3200}
    assert {m.orientation for m in echoed} == {25}
    peer.run(1.0)
    count = len(peer.of("RANGEFINDER"))
    peer.run(1.0)
    assert len(peer.of("RANGEFINDER")) == count, "half a second of silence clears it"


def test_obstacles_are_used_by_a_vehicle_with_proximity_and_forgotten(flight: Flight) -> None:
    peer = Peer(flight, parameters={"PRX1_TYPE": 2})
    proximity = peer.world.autopilot.received.proximity
    assert proximity is not None
    distances = [65535] * 72
    distances[0], distances[18], distances[36], distances[54] = 1500, 0, 20001, 800
    peer.send(mavlink.MAVLink_obstacle_distance_message(1, 0, distances, 5, 400, 20000, 5.0, 0.0, 12))
    peer.run(0.1)
    assert proximity.nearest_m(peer.now_ns) == {0: 15.0, 270: 8.0}
    peer.run(0.6)
    assert proximity.nearest_m(peer.now_ns) == {}
    for stamp, x, y in ((10, 9.0, 0.0), (10, 0.0, 7.0), (20, 300.0, 0.0)):
        assert proximity.nearest_m(peer.now_ns) == {}, "a look acts when the next one begins"
        peer.send(mavlink.MAVLink_obstacle_distance_3d_message(stamp, 0, 12, 65535, x, y, 0.0, 4.0, 200.0))
        peer.run(0.05)
    assert proximity.nearest_m(peer.now_ns) == {0: 9.0, 90: 7.0}
    assert Peer(flight).world.autopilot.received.proximity is None


def test_nonsense_from_the_companion_is_noticed(flight: Flight) -> None:
    peer = Peer(flight)
    sectors = [65535] * 72
    peer.send(mavlink.MAVLink_obstacle_distance_message(0, 0, sectors, 5, 400, 20000, 5.0, 0.0, 12))
    peer.send(mavlink.MAVLink_named_value_float_message(1, b"toe", 0.04))
    peer.run(0.05)
    assert peer.world.report()["problems"] == []
    peer.send(mavlink.MAVLink_obstacle_distance_message(0, 0, sectors, 5, 400, 20000, 5.0, 0.0, 0))
    peer.send(mavlink.MAVLink_obstacle_distance_message(0, 0, [30000] * 72, 5, 400, 20000, 5.0, 0.0, 12))
    peer.send(mavlink.MAVLink_named_value_float_message(1, b"toe", math.nan))
    peer.send(mavlink.MAVLink_obstacle_distance_3d_message(1, 0, 12, 0, 1.0, math.nan, 0.0, 1.0, 50.0))
    peer.run(0.05)
    assert len(peer.world.report()["problems"]) == 4


def test_image_capture_raises_the_line_and_is_fed_back_for_both_cameras(flight: Flight) -> None:
    shots: list[int] = []
    peer = Peer(flight, shots)
    peer.run(0.1)
    asked = peer.now_ns
    peer.command(mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 1)
    came = peer.run(0.02)
    assert [m.result for m in came if m.get_type() == "COMMAND_ACK"] == [mavlink.MAV_RESULT_ACCEPTED]
    feedback = [m for m in came if m.get_type() == "CAMERA_FEEDBACK"]
    assert [m.cam_idx for m in feedback] == [0, 1]
    assert {m.img_idx for m in feedback} == {1}
    (shot,) = shots
    assert asked <= shot <= asked + 4 * MS
    assert feedback[0].time_usec * 1000 == shot


# ------------------------------------------------------------------------------------------ faults


@pytest.mark.slow
def test_loss_duplicates_and_reordering_have_their_share(flight: Flight) -> None:
    clean, lossy = Peer(flight), Peer(flight, faults=Faults(loss=0.2, duplicate=0.1, jitter_s=0.02, reorder=True))
    clean.run(4.0)
    lossy.run(4.1)
    sent, came = len(clean.of("HIGHRES_IMU", 200)), lossy.of("HIGHRES_IMU", 200)
    different = {m.time_usec for _, m in came}
    # 4000 frames: a share is known to 0.6 %
    assert len(different) / sent == pytest.approx(0.8 * 4.1 / 4.0, abs=0.04)
    assert len(came) / len(different) == pytest.approx(1.1, abs=0.02)
    stamps = [m.time_usec for _, m in came]
    assert stamps != sorted(stamps)


def test_a_stream_stops_and_a_nan_is_sent_where_asked(flight: Flight) -> None:
    peer = Peer(flight, faults=Faults(stops=((200, 1.0, 2.0),), nans=((201, 1.0, 1.5),)))
    peer.run(3.0)
    left = [t for t, _ in peer.of("HIGHRES_IMU", 200)]
    assert not [t for t in left if 1_001 * MS < t < 2_000 * MS]
    assert max(left) > 2_900 * MS
    broken = [t for t, m in peer.of("HIGHRES_IMU", 201) if math.isnan(m.zacc)]
    assert 1_000 * MS <= min(broken) <= max(broken) <= 1_500 * MS
    assert len(broken) == pytest.approx(500, abs=3)


# ------------------------------------------------------------------------------------------ orders


NAN = float("nan")


@pytest.mark.parametrize(
    ("command", "params"),
    [
        (mavlink.MAV_CMD_DO_SET_MODE, (1, NAN)),
        (mavlink.MAV_CMD_DO_SET_MISSION_CURRENT, (float("inf"),)),
        (mavlink.MAV_CMD_REQUEST_MESSAGE, (NAN,)),
        (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (105, NAN)),
        (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, (float("inf"), 1e4)),
    ],
)
def test_a_parameter_that_is_no_number_is_denied(flight: Flight, command: int, params: tuple[float, ...]) -> None:
    peer = Peer(flight, pilot_height_m=60.0)
    peer.command(command, *params)
    (answer,) = [m for m in peer.run(0.05) if m.get_type() == "COMMAND_ACK"]
    assert (answer.command, answer.result) == (command, mavlink.MAV_RESULT_DENIED)


def test_no_order_puts_the_pilot_where_no_number_is(flight: Flight) -> None:
    peer = Peer(flight, pilot_height_m=60.0)
    place = to_wire(100.0, 0.0)
    peer.send(mavlink.MAVLink_command_int_message(1, 1, 3, 192, 0, 0, 0, 1, 0, 0, *place, NAN))
    peer.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0, [NAN] * 4, 0, 0, 0, 0.5))
    peer.send(mavlink.MAVLink_mission_count_message(1, 1, 2))
    for number, height_m in enumerate((0.0, NAN)):
        peer.send(mavlink.MAVLink_mission_item_int_message(1, 1, number, 3, 16, 0, 1, 0, 0, 0, 0, *place, height_m))
    peer.run(1.0)
    assert [m.type for _, m in peer.of("MISSION_ACK")] == [mavlink.MAV_MISSION_UNSUPPORTED]
    assert peer.of("GLOBAL_POSITION_INT")[-1][1].relative_alt == pytest.approx(60_000, abs=2_000)


def test_a_mission_whose_home_is_nowhere_is_read_back_with_home(flight: Flight) -> None:
    peer = Peer(flight, pilot_height_m=60.0)
    peer.send(mavlink.MAVLink_mission_count_message(1, 1, 1))
    peer.send(mavlink.MAVLink_mission_item_int_message(1, 1, 0, 0, 16, 0, 1, 0, 0, 0, 0, 0, 0, 0.0))
    peer.send(mavlink.MAVLink_mission_request_int_message(1, 1, 0))
    peer.run(0.1)
    ((_, item),) = peer.of("MISSION_ITEM_INT")
    assert (item.x, item.y) == to_wire(0.0, 0.0)
    assert (item.param1, item.autocontinue) == (0.0, 1)


def test_the_place_that_is_told_is_where_the_flight_is(flight: Flight) -> None:
    """As :func:`from_wire` and every ground station read it: a degree of longitude is shorter than one of latitude."""
    peer = Peer(flight)
    peer.run(11.0)
    for kind, stamp_ns in (("GLOBAL_POSITION_INT", "time_boot_ms"), ("GPS_RAW_INT", "time_usec")):
        _, message = peer.of(kind)[-1]
        at_ns = getattr(message, stamp_ns) * (1000 if stamp_ns == "time_usec" else MS)
        true_m = flight.truth.series(np.array([at_ns], dtype=np.int64)).position_ned_m[0, :2]
        assert from_wire(message.lat, message.lon) == pytest.approx(true_m.tolist(), abs=0.1)
        assert np.abs(true_m).min() > 1.0, "else it says nothing"


def test_a_pilot_in_wind_tells_the_velocity_that_it_moves_with(flight: Flight) -> None:
    peer = Peer(flight, pilot_height_m=60.0)
    protocol = peer.world.autopilot.protocol
    assert protocol is not None
    protocol.pilot.wind_east_mps = 8.0
    peer.run(3.0)
    (_, first), (_, last) = peer.of("GLOBAL_POSITION_INT")[-2:]
    moved_m = np.subtract(from_wire(last.lat, last.lon), from_wire(first.lat, first.lon))
    moved_mps = moved_m / (last.time_boot_ms - first.time_boot_ms) * 1e3
    stated_mps = 0.005 * (first.vx + last.vx), 0.005 * (first.vy + last.vy)
    assert stated_mps == pytest.approx(moved_mps.tolist(), abs=1.5)  # of some 250 ms, in steps of 20
    assert peer.of("VFR_HUD")[-1][1].groundspeed == pytest.approx(0.01 * math.hypot(last.vx, last.vy), abs=1.5)
    receiver = peer.of("GPS_RAW_INT")[-1][1]
    assert 0.01 * receiver.vel == pytest.approx(0.01 * math.hypot(last.vx, last.vy), abs=3.0)
    assert 0.01 * receiver.cog == pytest.approx(math.degrees(math.atan2(last.vy, last.vx)) % 360.0, abs=15.0)


# ------------------------------------------------------------------------------------------ real time


@pytest.mark.parametrize("connection", ["tcp:127.0.0.1:5760", "udpout:127.0.0.1", "/dev/ttyUSB0"])
def test_a_connection_that_cannot_be_served_is_named(connection: str) -> None:
    with pytest.raises(LinkError, match=connection) as refused:
        VehicleLink(connection)
    assert "udpin:" in str(refused.value), "it shows how one is written"


@pytest.mark.parametrize("connection", ["udpout:no-such-host.invalid:14550", "udpout:a..b:14550"])
def test_a_host_that_nobody_knows_is_named_before_anything_is_built(
    connection: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(LinkError, match=f"cannot open {connection}"):
        VehicleLink(connection)
    for words in (["--link", connection], ["--link", "foo"], ["--airframe", "nope"]):
        monkeypatch.setattr("sys.argv", ["simulated_vehicle", *words])
        assert simulated_vehicle.main() == 2
        said = capsys.readouterr()
        assert words[1] in said.err
        assert said.err.count("\n") == 1
        assert said.out == ""


def test_a_network_that_is_gone_does_not_end_the_flight() -> None:
    class Unreachable:
        def sendto(self, *_: object) -> None:
            raise OSError(errno.ENETUNREACH, "Network is unreachable")

        def close(self) -> None: ...

    link = VehicleLink("udpout:127.0.0.1:9")
    link._socket.close()
    link._socket = Unreachable()  # type: ignore[assignment]
    link.send([b"a frame"])
    link.close()


@pytest.mark.realtime
@pytest.mark.slow
def test_a_process_of_its_own_serves_udp_in_real_time() -> None:
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind(("127.0.0.1", 0))
    listener.settimeout(0.2)
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    options = WorldOptions(f"udpout:127.0.0.1:{listener.getsockname()[1]}")
    process = context.Process(target=serve_new, args=(load_airframe("nadir-2m"), 1, 4.0, IDEAL, options, theirs))
    process.start()
    parser, lags = mavlink.MAVLink(None), []
    clock = build_flight(load_airframe("nadir-2m"), 1, 4.0).real.clocks[ClockName.NODE_LEFT]
    try:
        kind, start_ns = ours.recv()
        assert kind == "started"
        while not ours.poll():
            try:
                data = listener.recv(65535)
            except TimeoutError:
                continue
            now = time.monotonic_ns() - start_ns
            for message in parser.parse_buffer(data) or []:
                if message.get_type() == "HIGHRES_IMU" and message.get_srcComponent() == 200:
                    lags.append(clock.from_boot(now) - message.time_usec * 1000)
        kind, report = ours.recv()
    finally:
        process.join(30.0)
        listener.close()
    assert kind == "report"
    assert report["flown_s"] == pytest.approx(4.0)
    assert len(lags) > 3900
    # every sample arrives after it was taken, in the median within a few milliseconds
    assert min(lags) > 0
    assert np.median(lags) < 10 * MS


@pytest.mark.realtime
def test_a_capture_command_pulls_the_cameras_line(flight: Flight, tmp_path: Path) -> None:
    watched = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    watched.bind(str(tmp_path / "line"))
    watched.settimeout(0.0)
    companion = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    companion.bind(("127.0.0.1", 0))
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=COMPANION)
    start_ns = time.monotonic_ns() + 100 * MS
    port = companion.getsockname()[1]
    options = WorldOptions(f"udpout:127.0.0.1:{port}", start_host_ns=start_ns, trigger_line=tmp_path / "line")
    ours, theirs = multiprocessing.Pipe()
    flying = threading.Thread(target=serve, args=(flight, options, theirs))
    flying.start()
    _, vehicle = companion.recvfrom(65535)
    asked_ns = time.monotonic_ns()
    capture = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 0, 1, 0, 0, 0, 0)
    companion.sendto(capture.pack(mav), vehicle)
    time.sleep(0.5)
    ours.send("stop")
    flying.join()
    _, edge_ns = struct.unpack("<qq", watched.recv(100))
    assert ours.recv() == ("started", start_ns)
    assert asked_ns < edge_ns < asked_ns + 300 * MS
    companion.close()
    watched.close()


@pytest.mark.realtime
def test_the_control_ends_the_flight_early(flight: Flight) -> None:
    ours, theirs = multiprocessing.Pipe()
    ours.send("stop")
    report = serve(flight, WorldOptions("udpout:127.0.0.1:9"), theirs)
    assert report["flown_s"] < 3.0
    assert [ours.recv()[0], ours.recv()[0]] == ["started", "report"]

"""The vehicle's side of the service, against a small vehicle written with pymavlink, on a clock that tests turn."""

from __future__ import annotations

import dataclasses
import math
import struct
from typing import Any

import numpy as np
import pytest
from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.component import encode, message_outputs
from companion.adapters.mavlink.decode.decoder import OUTGOING, Decoder
from companion.adapters.mavlink.decode.message_records import Heard
from companion.adapters.mavlink.link.link import Link
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.adapters.mavlink.vehicle.periodic_requests import NEEDED_PARAMETERS
from companion.adapters.triggers.mavlink import CAMERAS, LinkFiring
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import (
    AutopilotParameter,
    ClockName,
    ClockRestart,
    ClockState,
    CorrectedRange,
    Health,
    ImuBatch,
    NoRange,
    Notice,
    RawChunk,
    Record,
    Reject,
    Rejected,
    ServiceStatus,
    Shot,
    TimesyncReply,
)

S, MS = 1_000_000_000, 1_000_000


class TurnedClock:
    """A monotonic clock that moves only when it is told, or slept on."""

    def __init__(self) -> None:
        self.now = 100 * S

    def now_ns(self) -> int:
        return self.now

    def sleep_until(self, target_host_ns: int) -> None:
        self.now = max(self.now, target_host_ns)


class Wire:
    """A transport in memory."""

    def __init__(self) -> None:
        self.inbox = b""
        self.sent: list[bytes] = []
        self.taken = b""
        self.full = False

    def fileno(self) -> int:
        return -1

    def receive(self, limit: int, now_host_ns: int) -> bytes:
        data, self.inbox = self.inbox[:limit], self.inbox[limit:]
        return data

    def send(self, data: bytes) -> bool:
        if not self.full:
            self.sent.append(data)
            self.taken += data
        return not self.full

    def close(self) -> None:
        self.inbox = b""


class Vehicle:
    """An autopilot of system 3 and two nodes: answers time, parameters and rates; streams what was granted."""

    def __init__(self, clock: TurnedClock, wire: Wire, boot_ns: int = 50 * S, loop_hz: float = 400) -> None:
        self.clock, self.wire, self.loop_hz = clock, wire, loop_hz
        self.offset_ns = boot_ns - clock.now
        self.parser = mavlink.MAVLink(None)
        self.packers = {component: mavlink.MAVLink(None, 3, component) for component in (1, 200, 201)}
        self.heard: list[Any] = []
        self.interval_ms: dict[int, int] = {}
        self.last_ms: dict[int, int] = {}

    def say(self, message: Any, component: int = 1) -> None:
        self.wire.inbox += bytes(message.pack(self.packers[component]))

    def heartbeat(self) -> None:
        self.say(mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3))

    def boot_ms(self) -> int:
        return (self.clock.now + self.offset_ns) // MS

    def run(self) -> None:
        frames, self.wire.sent = self.wire.sent, []
        for message in self.parser.parse_buffer(b"".join(frames)) or []:
            self.heard.append(message)
            self.answer(message)
        for message, interval_ms in self.interval_ms.items():
            if self.boot_ms() - self.last_ms.get(message, -1000) >= interval_ms:
                self.last_ms[message] = self.boot_ms()
                self.stream(message)

    def answer(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "TIMESYNC" and message.tc1 == 0:
            for component in (1, 200):
                self.say(mavlink.MAVLink_timesync_message(self.clock.now + self.offset_ns, message.ts1), component)
        elif kind == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            interval_ms = int(message.param2) // 1000
            granted = interval_ms >= int(1250 / self.loop_hz)
            if granted:
                self.interval_ms[int(message.param1)] = interval_ms
            self.say(mavlink.MAVLink_command_ack_message(511, 0 if granted else 2, 0, 0, 3, 191))
        elif kind == "PARAM_REQUEST_READ":
            value = self.loop_hz if message.param_id == "SCHED_LOOP_RATE" else 20.0
            self.say(mavlink.MAVLink_param_value_message(message.param_id.encode(), value, 9, 100, 1))

    def stream(self, message: int, component: int = 1) -> None:
        t_us = (self.clock.now + self.offset_ns) // 1000
        if message == mavlink.MAVLINK_MSG_ID_HIGHRES_IMU:
            values = (0, 0, -9.8, 0, 0, 0)
            self.say(mavlink.MAVLink_highres_imu_message(t_us, *values, 0, 0, 0, 0, 0, 0, 20, 63), component)

    def of(self, kind: str) -> list[Any]:
        return [message for message in self.heard if message.get_type() == kind]


class Bench:
    def __init__(self, loop_hz: float = 400, firing: LinkFiring = CAMERAS) -> None:
        self.clock, self.wire = TurnedClock(), Wire()
        self.vehicle = Vehicle(self.clock, self.wire, loop_hz=loop_hz)
        self.listened: list[Heard] = []
        self.pilot = MavlinkAutopilot(
            [Link(0, "memory", self.wire, self.clock)],
            load_airframe("nadir-2m"),
            Settings(),
            self.clock,
            listener=self.listened.append,
            firing=firing,
        )

    def fly(self, seconds: float, heartbeats: bool = True) -> list[Record]:
        records: list[Record] = []
        for step in range(round(seconds * 200)):
            if heartbeats and step % 200 == 0:
                self.vehicle.heartbeat()
            self.vehicle.run()
            self.clock.now += 5 * MS
            records += self.pilot.poll(0.0)
        return records


def kinds(records: list[Record], kind: type) -> list[Any]:
    return [record for record in records if isinstance(record, kind)]


def test_nothing_is_sent_before_the_vehicle_is_known_and_then_all_is_asked() -> None:
    bench = Bench()
    bench.fly(2, heartbeats=False)
    assert not bench.vehicle.heard
    records = bench.fly(3)
    ours = bench.vehicle.heard
    assert {(message.get_srcSystem(), message.get_srcComponent()) for message in ours} == {(3, 191)}
    sequence = [message.get_seq() for message in ours]
    assert sequence == [(sequence[0] + k) % 256 for k in range(len(sequence))]
    assert 2 <= len(bench.vehicle.of("HEARTBEAT")) <= 3
    names = {record.name for record in kinds(records, AutopilotParameter)}
    assert {"INS_ACCEL_FILTER", "INS_GYRO_FILTER", "SCHED_LOOP_RATE", "RNGFND1_MAX"} <= names
    assert set(bench.vehicle.interval_ms) == {105, 30, 33, 74}
    assert len(kinds(records, ImuBatch)) > 300


def test_time_is_exchanged_with_the_autopilot_and_each_node() -> None:
    bench = Bench()
    records = bench.fly(3)
    replies = kinds(records, TimesyncReply)
    for clock in (ClockName.BOOT, ClockName.NODE_LEFT):
        clock_replies = [reply for reply in replies if reply.clock == clock]
        assert 50 <= len(clock_replies) <= 62
        for reply in clock_replies:
            assert reply.sent_host_ns <= reply.remote_ns - bench.vehicle.offset_ns <= reply.received_host_ns


def test_requests_of_others_are_answered_with_our_time() -> None:
    bench = Bench()
    bench.fly(0.1)
    bench.vehicle.say(mavlink.MAVLink_timesync_message(0, 4711))
    before = bench.clock.now
    bench.fly(0.1)
    (answered,) = [message for message in bench.vehicle.of("TIMESYNC") if message.tc1]
    assert answered.ts1 == 4711
    assert before <= answered.tc1 <= bench.clock.now


@pytest.mark.parametrize(("system", "component", "answers"), [(3, 191, 1), (0, 0, 1), (3, 1, 0), (4, 191, 0)])
def test_a_request_that_names_somebody_is_answered_by_that_one_alone(system: int, component: int, answers: int) -> None:
    """The newer fields of TIMESYNC, which pymavlink does not have; our answer names who asked."""
    bench = Bench()
    bench.fly(0.1)
    asked = (
        bytes((18, 0, 0, 7, 3, 240)) + (111).to_bytes(3, "little") + struct.pack("<qqBB", 0, 4711, system, component)
    )
    bench.wire.inbox += b"\xfd" + asked + mcrf4xx(asked + bytes((34,))).to_bytes(2, "little")
    bench.fly(0.1)
    replies = [m for m in bench.vehicle.of("TIMESYNC") if m.tc1]
    assert [m.ts1 for m in replies] == [4711] * answers
    assert [m.get_msgbuf()[26:28] for m in replies] == [bytes((3, 240))] * answers


def test_another_vehicle_is_neither_answered_nor_believed() -> None:
    bench = Bench()
    bench.fly(0.05)
    other = mavlink.MAVLink(None, 4, 1)
    for name in NEEDED_PARAMETERS:
        bench.wire.inbox += mavlink.MAVLink_param_value_message(name.encode(), 1.0, 9, 100, 1).pack(other)
    bench.wire.inbox += mavlink.MAVLink_timesync_message(0, 4711).pack(other)
    bench.fly(2.0)
    assert {message.param_id for message in bench.vehicle.of("PARAM_REQUEST_READ")} == set(NEEDED_PARAMETERS)
    assert not [message for message in bench.vehicle.of("TIMESYNC") if message.tc1]


def test_an_autopilot_on_two_links_is_commanded_over_one_until_that_falls_silent() -> None:
    bench, second = Bench(), Wire()
    links = [Link(number, "memory", wire, bench.clock) for number, wire in enumerate((bench.wire, second))]
    bench.pilot = MavlinkAutopilot(links, load_airframe("nadir-2m"), Settings(), bench.clock)
    records: list[Record] = []
    for step in range(2000):
        if step % 200 == 0:
            bench.vehicle.heartbeat()
        bench.vehicle.run()
        second.inbox = bench.wire.inbox
        if step > 1000:
            bench.wire.inbox = b""
        bench.clock.now += 5 * MS
        records += bench.pilot.poll(0.0)
        if step == 1000:
            early = mavlink.MAVLink(None).parse_buffer(b"".join(second.sent)) or []
    bench.pilot.command(mavlink.MAV_CMD_IMAGE_START_CAPTURE)
    late = mavlink.MAVLink(None).parse_buffer(b"".join(second.sent)) or []
    sequence = [message.get_seq() for message in late]
    assert sequence == [k % 256 for k in range(len(sequence))], "who listens there alone counts no losses"
    recorded = b"".join(chunk.data for chunk in kinds(records, RawChunk) if chunk.link >= OUTGOING)
    beats = [m for m in mavlink.MAVLink(None).parse_buffer(recorded) or [] if m.get_type() == "HEARTBEAT"]
    assert len(beats) <= 11, "one a second, whatever the links"
    asked = {"COMMAND_LONG", "PARAM_REQUEST_READ"}
    assert {"COMMAND_LONG", "PARAM_REQUEST_READ"} <= {message.get_type() for message in bench.vehicle.heard}
    assert not asked & {message.get_type() for message in early}
    assert late[-1].get_type() == "COMMAND_LONG"
    assert [entry.text for entry in kinds(records, Notice) if "two links" in entry.text] == [
        "the autopilot comes over two links, and its samples twice: give only one of them (--connect)"
    ]


def time_requests(chunks: list[RawChunk]) -> list[RawChunk]:
    """Our TIMESYNC requests among chunks, each of which is one frame where we sent it."""
    requests = []
    for chunk in chunks:
        (message,) = (mavlink.MAVLink(None).parse_buffer(chunk.data) if chunk.link >= OUTGOING else None) or (None,)
        if message is not None and message.get_type() == "TIMESYNC" and message.tc1 == 0:
            requests.append(chunk)
    return requests


def test_all_that_was_sent_is_recorded_once_and_in_order_and_no_more() -> None:
    bench = Bench()
    records = bench.fly(1)
    for number in range(20):
        bench.wire.full = number in (10, 11)
        bench.pilot.publish(NoRange(bench.clock.now, 25, Reject.NO_MATCHES))
        records += bench.fly(0.1)
    recorded = [chunk for chunk in kinds(records, RawChunk) if chunk.link >= OUTGOING]
    assert b"".join(chunk.data for chunk in recorded) == bench.wire.taken
    assert [chunk.received_host_ns for chunk in recorded] == sorted(chunk.received_host_ns for chunk in recorded)
    messages = mavlink.MAVLink(None).parse_buffer(bench.wire.taken)
    assert {"HEARTBEAT", "TIMESYNC", "COMMAND_LONG", "DISTANCE_SENSOR"} <= {message.get_type() for message in messages}


def test_the_recorded_chunks_replay_to_the_same_records() -> None:
    bench = Bench()
    records = bench.fly(2)
    bench.vehicle.offset_ns -= 40 * S  # a reboot
    while not time_requests(kinds(records[-3:], RawChunk)):
        records += bench.fly(0.005)
    # refusals are reported once a second: first in the poll of our next request, then with a later one of its period
    records += bench.fly(0.095)
    bench.vehicle.packers[158] = mavlink.MAVLink(None, 3, 158)
    for _ in range(300):
        bench.vehicle.stream(105, component=158)
        records += bench.fly(0.005)
    assert Reject.FOREIGN_SOURCE in {record.reason for record in kinds(records, Rejected)}
    chunks = kinds(records, RawChunk)
    assert {chunk.link for chunk in chunks} == {0, OUTGOING}
    decoder = Decoder(load_airframe("nadir-2m"), Settings().component_id)
    replayed = [repr(record) for chunk in chunks for record in decoder.decode_chunk(chunk)]
    assert replayed == [repr(record) for record in records if not isinstance(record, RawChunk | Notice)]
    assert len(kinds(records, ClockRestart)) == 2  # the autopilot's clock, and the node's that went back with it


def test_after_a_reboot_rates_and_parameters_are_asked_for_again() -> None:
    bench = Bench()
    bench.fly(2)
    bench.vehicle.offset_ns -= 40 * S
    bench.vehicle.interval_ms.clear()
    bench.vehicle.last_ms.clear()
    bench.vehicle.heard.clear()
    bench.fly(2)
    assert 105 in bench.vehicle.interval_ms
    assert len(bench.vehicle.of("PARAM_REQUEST_READ")) >= 7


def test_a_slow_loop_is_told_to_the_operator() -> None:
    bench = Bench(loop_hz=50)
    texts = [notice.text for notice in kinds(bench.fly(4), Notice)]
    assert any("HIGHRES_IMU" in text and "SCHED_LOOP_RATE 400" in text for text in texts)
    assert 25 <= bench.vehicle.interval_ms[105] <= 32


def test_bytes_are_gathered_unless_the_time_is_being_asked() -> None:
    bench = Bench()
    bench.fly(5)
    chunks = []
    for _ in range(1000):
        bench.vehicle.run()
        bench.vehicle.stream(105)
        bench.clock.now += MS
        chunks += kinds(list(bench.pilot.poll(0.0)), RawChunk)
    incoming = [chunk for chunk in chunks if chunk.link < OUTGOING]
    assert 240 <= len(incoming) <= 350
    for asked in time_requests(chunks):
        answer = min(chunk.received_host_ns for chunk in incoming if chunk.received_host_ns > asked.received_host_ns)
        assert answer - asked.received_host_ns <= 2 * MS


def test_rare_messages_are_handed_to_the_listener() -> None:
    bench = Bench()
    bench.vehicle.say(mavlink.MAVLink_command_long_message(3, 191, 512, 0, 1, 0, 0, 0, 0, 0, 0))
    bench.fly(0.05)
    assert [heard.message.command for heard in bench.listened if heard.name == "COMMAND_LONG"] == [512]


def a_range(**changes: Any) -> CorrectedRange:
    base = CorrectedRange(1, 1, 200 * S, 25, 40.0, 0.1, 0.004, 1e-4, 35.0, 50, True, None)
    return dataclasses.replace(base, **changes)


def test_ranges_leave_with_the_autopilots_time_and_their_true_sigma_beside() -> None:
    bench = Bench()
    bench.fly(1)
    bench.pilot.publish(ClockState(ClockName.BOOT, bench.clock.now, -50 * S, 0.0, 1000, True))
    bench.pilot.publish(a_range())
    bench.vehicle.run()
    (sent,) = bench.vehicle.of("DISTANCE_SENSOR")
    assert (sent.time_boot_ms, sent.current_distance, sent.covariance) == (150_000, 4000, 100)
    values = {message.name: message.value for message in bench.vehicle.of("NAMED_VALUE_FLOAT")}
    assert values["rng_sig_m"] == np.float32(0.1)
    assert values["toe_mrad"] == np.float32(4.0)


def test_a_range_that_is_not_a_number_is_alive_without_range_and_no_graph_is_poisoned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    graphs = tuple(output for output in message_outputs.OUTPUTS if output.encode is encode.range_graphs)
    monkeypatch.setattr(message_outputs, "OUTPUTS", graphs)  # further rows may refuse values of their own
    bench = Bench()
    bench.fly(0.1)
    bench.pilot.publish(a_range(range_m=math.nan, sigma_m=math.inf, toe_rad=math.nan))
    bench.vehicle.run()
    (sent,) = bench.vehicle.of("DISTANCE_SENSOR")
    assert sent.signal_quality == 1
    assert bench.pilot.refused == 2, "sigma and toe"
    assert [message.name for message in bench.vehicle.of("NAMED_VALUE_FLOAT")] == ["rigid_m"]


def test_graphs_keep_their_rate() -> None:
    bench = Bench()
    bench.fly(0.1)
    for k in range(100):
        bench.pilot.publish(a_range(t_host_ns=200 * S + k * 20 * MS))
    bench.vehicle.run()
    sigmas = [message for message in bench.vehicle.of("NAMED_VALUE_FLOAT") if message.name == "rng_sig_m"]
    assert len(sigmas) in (7, 8)


@pytest.mark.parametrize(("chosen", "first"), [(0.0, 1), (7.0, 7)])
def test_a_calling_link_begins_with_the_system_that_is_set(chosen: float, first: int) -> None:
    """A router on the other side learns from the first heartbeats who we are."""
    clock, wire = TurnedClock(), Wire()
    settings = Settings().replace("SW_SYSID", chosen)
    link = Link(0, "udpout:memory", wire, clock, speaks_first=True)
    pilot = MavlinkAutopilot([link], load_airframe("nadir-2m"), settings, clock)
    list(pilot.poll(0.0))
    (beat,) = mavlink.MAVLink(None).parse_buffer(wire.taken)
    assert beat.get_type() == "HEARTBEAT"
    assert beat.get_srcSystem() == first


@pytest.mark.parametrize(("health", "state"), [(Health.ACTIVE, 4), (Health.CRITICAL, 5), (Health.STANDBY, 3)])
def test_the_heartbeat_follows_the_services_health(health: Health, state: int) -> None:
    bench = Bench()
    bench.fly(1)
    bench.pilot.publish(ServiceStatus(bench.clock.now, health, "because"))
    bench.vehicle.heard.clear()
    bench.fly(2)
    assert {message.system_status for message in bench.vehicle.of("HEARTBEAT")} == {state}


def test_a_shot_by_the_autopilots_cameras_is_commanded() -> None:
    bench = Bench()
    bench.fly(0.1)
    bench.pilot.publish(Shot(7, bench.clock.now, bench.clock.now))
    bench.vehicle.run()
    (command,) = [message for message in bench.vehicle.of("COMMAND_LONG") if message.command == 2000]
    assert (command.target_system, command.target_component, command.param1, command.param3) == (3, 1, 0.0, 1.0)


@pytest.mark.parametrize(("firing", "expected"), [
    (LinkFiring("relay", 2), (182, 2.0, 1.0)), (LinkFiring("servo", 9, 1750), (184, 9.0, 1750.0)),
])  # fmt: skip
def test_a_shot_by_relay_or_servo_pulses_it_once(firing: LinkFiring, expected: tuple[int, float, float]) -> None:
    bench = Bench(firing=firing)
    bench.fly(0.1)
    bench.pilot.publish(Shot(7, bench.clock.now, bench.clock.now))
    bench.vehicle.run()
    (command,) = [message for message in bench.vehicle.of("COMMAND_LONG") if message.command == expected[0]]
    assert (command.command, command.param1, command.param2) == expected
    count = command.param2 if firing.kind == "relay" else command.param3
    assert count == 1.0


def test_a_shot_that_the_autopilot_refuses_is_told_as_a_failed_device() -> None:
    bench = Bench()
    bench.fly(0.1)
    bench.vehicle.say(mavlink.MAVLink_command_ack_message(2000, 4, target_component=191))
    assert not [record for record in bench.fly(0.1) if isinstance(record, Rejected)], "nothing had been asked for"
    bench.pilot.publish(Shot(7, bench.clock.now, bench.clock.now))
    bench.vehicle.say(mavlink.MAVLink_command_ack_message(2000, mavlink.MAV_RESULT_ACCEPTED, target_component=191))
    bench.vehicle.say(mavlink.MAVLink_command_ack_message(2000, 4, target_component=191), component=200)
    assert not [record for record in bench.fly(0.1) if isinstance(record, Rejected)]
    for system, component in ((255, 190), (3, 100), (255, 191)):  # a ground station's picture, another companion's
        bench.vehicle.say(mavlink.MAVLink_command_ack_message(2000, 4, 0, 0, system, component))
    assert not [record for record in bench.fly(0.1) if isinstance(record, Rejected)]
    bench.vehicle.say(mavlink.MAVLink_command_ack_message(2000, mavlink.MAV_RESULT_FAILED, target_component=191))
    (refused,) = [record for record in bench.fly(0.1) if isinstance(record, Rejected)]
    assert refused.reason is Reject.DEVICE_FAILED
    assert "2000" in refused.what


def test_alive_without_range_says_so() -> None:
    bench = Bench()
    bench.fly(0.1)
    bench.pilot.publish(NoRange(bench.clock.now, 25, Reject.NO_MATCHES))
    bench.vehicle.run()
    (sent,) = bench.vehicle.of("DISTANCE_SENSOR")
    assert (sent.current_distance, sent.max_distance, sent.signal_quality, sent.orientation) == (20_001, 20_000, 1, 25)


def test_notices_become_texts() -> None:
    bench = Bench()
    bench.fly(0.1)
    bench.pilot.publish(Notice(4, "wing node left is silent", bench.clock.now))
    bench.vehicle.run()
    (text,) = bench.vehicle.of("STATUSTEXT")
    assert (text.severity, text.text) == (4, "wing node left is silent")

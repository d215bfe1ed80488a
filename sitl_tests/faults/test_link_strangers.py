"""Who may speak on a UDP port: peers are made by frames of the vehicle, and an id is one sender's while it lives."""

from __future__ import annotations

import socket
import time
from collections import Counter
from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.link.datagrams import GUARDED_FRAMES
from companion.adapters.mavlink.link.link import Link
from companion.adapters.mavlink.link.signing import Refusal, SignedTransport, Signing
from companion.adapters.mavlink.link.udp import UdpIn
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockRestart, ImuBatch, Notice, Record, Reject, Rejected
from sitl_tests.faults.test_signing_links import KEY, NOW
from sitl_tests.loop.ground_stations import TurnedClock, Wire

MS = 1_000_000
NODE, PILOT = 200, 1


class Talker:
    """A socket that sends MAVLink under some id and keeps what it hears."""

    def __init__(self, to: tuple[str, int], component: int, system: int = 1, key: bytes | None = None) -> None:
        self._to = to
        self.packer = mavlink.MAVLink(None, system, component)
        if key is not None:
            self.packer.signing.secret_key, self.packer.signing.timestamp = key, NOW
            self.packer.signing.sign_outgoing = True
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)

    @property
    def where(self) -> str:
        return f"127.0.0.1:{self.socket.getsockname()[1]}"

    def send(self, data: bytes) -> None:
        self.socket.sendto(data, self._to)

    def frame(self, message: mavlink.MAVLink_message) -> bytes:
        frame = bytes(message.pack(self.packer))
        self.packer.seq = (self.packer.seq + 1) % 256
        return frame

    def beat(self, kind: int = 1, autopilot: int = 3) -> None:
        self.send(self.frame(mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, 4, 3)))

    def sample(self, t_us: int, z_mps2: float = -9.8) -> None:
        self.send(self.sample_frame(t_us, z_mps2))

    def sample_frame(self, t_us: int, z_mps2: float = -9.8) -> bytes:
        return self.frame(mavlink.MAVLink_highres_imu_message(t_us, 0, 0, z_mps2, 0, 0, 0, *[0] * 7, 63))

    def heard(self) -> int:
        """Datagrams since the last call."""
        count = 0
        try:
            while self.socket.recv(2048):
                count += 1
        except BlockingIOError:
            return count
        return count


class Port:
    """Our adapter on a UDP port, on a clock that is turned by hand."""

    def __init__(self, signing: bool = False) -> None:
        self.clock = TurnedClock()
        self.udp = UdpIn("127.0.0.1", 0)
        self.at = ("127.0.0.1", self.udp.port)
        self.signing = Signing(KEY, self.clock, NOW) if signing else None
        transport = self.udp if self.signing is None else SignedTransport(self.udp, self.signing, 0)
        self.link = Link(0, "udpin", transport, self.clock)
        self.pilot = MavlinkAutopilot([self.link], load_airframe("nadir-2m"), Settings(), self.clock)
        self.records: list[Record] = []
        self.talkers: list[Talker] = []

    def talker(self, component: int, system: int = 1, key: bytes | None = None) -> Talker:
        self.talkers.append(Talker(self.at, component, system, key))
        return self.talkers[-1]

    def run(self, seconds: float = 0.02) -> None:
        """Poll every 10 ms of our clock; datagrams on this machine arrive at once."""
        for _ in range(round(seconds / 0.01)):
            self.clock.now += 10 * MS
            self.records += self.pilot.poll(0.0)

    def texts(self) -> list[str]:
        return [record.text for record in self.records if isinstance(record, Notice)]

    def samples(self) -> Counter[float]:
        batches = [record for record in self.records if isinstance(record, ImuBatch)]
        return Counter(round(float(row[2]), 1) for batch in batches for row in batch.values)

    def close(self) -> None:
        self.pilot.close()
        for talker in self.talkers:
            talker.socket.close()


@pytest.fixture(params=[False, True], ids=["unsigned", "signed"])
def signing(request: pytest.FixtureRequest) -> bool:
    return bool(request.param)


@pytest.fixture
def port(signing: bool) -> Iterator[Port]:
    made = Port(signing)
    yield made
    made.close()


@pytest.fixture
def key(signing: bool) -> bytes | None:
    return KEY if signing else None


def test_junk_from_seventeen_sockets_costs_the_autopilot_no_message(port: Port, key: bytes | None) -> None:
    pilot = port.talker(PILOT, key=key)
    junk = [port.talker(66) for _ in range(17)]
    heard = 0
    for _ in range(300):
        pilot.beat()
        for talker in junk:
            talker.send(b"x")
        port.run(0.01)
        heard += pilot.heard()
    assert port.udp.peers == [pilot.socket.getsockname()]
    assert port.pilot._links[0].unsent <= 1, "before anybody was there"
    assert heard >= 3 * 10, "TIMESYNC alone is asked ten times a second"
    assert not any(talker.heard() for talker in junk)


def test_whole_frames_of_another_system_make_no_peer_and_a_ground_station_does(port: Port, key: bytes | None) -> None:
    pilot, other, station = port.talker(PILOT, key=key), port.talker(1, 77, key), port.talker(190, 255, key)
    other.beat(autopilot=8)  # before the vehicle is known it might be anybody's
    pilot.beat()
    port.run()
    for _ in range(50):
        other.sample(1)
        station.beat(kind=6, autopilot=8)
        pilot.beat()
        port.run(0.01)
    other.heard()
    port.run(0.5)
    assert other.heard() == 0
    assert station.heard() > 0
    assert pilot.heard() > 0


def test_an_unsigned_frame_makes_no_peer_where_signing_is_on() -> None:
    port = Port(signing=True)
    try:
        pilot, stranger, thief = port.talker(PILOT, key=KEY), port.talker(PILOT), port.talker(PILOT, key=bytes(32))
        for _ in range(20):
            for talker in (stranger, thief, pilot):
                talker.beat()
            port.run(0.05)
        assert port.udp.peers == [pilot.socket.getsockname()]
        assert port.pilot.decoder.system_id == 1
    finally:
        port.close()


def test_a_second_sender_of_a_nodes_id_is_refused_and_told_by_name(port: Port, key: bytes | None) -> None:
    pilot, first = port.talker(PILOT, key=key), port.talker(NODE, key=key)
    second = port.talker(NODE, key=key)
    second.packer.signing.link_id = 7
    pilot.beat()
    port.run()
    for number in range(400):
        first.sample(1_000_000 + 5000 * number, -9.8)
        if number > 20:
            second.sample(90_000_000 + 5000 * number, -3.0)
        port.run(0.01)
    assert set(port.samples()) == {-9.8}
    assert port.samples()[-9.8] == 400
    warnings = [text for text in port.texts() if f"1/{NODE}" in text]
    assert len(warnings) == 1, "calmly"
    assert second.where in warnings[0]
    assert first.where in warnings[0]
    refused = [record for record in port.records if isinstance(record, Rejected) and str(NODE) in record.what]
    assert sum(record.count for record in refused) > 300
    assert {record.reason for record in refused} == {Reject.FOREIGN_SOURCE}


def test_a_second_autopilot_is_refused_and_the_first_keeps_its_place_while_it_lives() -> None:
    port = Port()
    try:
        first, second = port.talker(PILOT), port.talker(PILOT)
        for _ in range(30):
            first.beat()
            second.beat(autopilot=12)
            port.run(0.1)
        assert not port.pilot.decoder.px4
        assert [text for text in port.texts() if "1/1" in text and second.where in text]
        for _ in range(30):
            second.beat(autopilot=12)
            port.run(0.1)
        assert port.pilot.decoder.px4, "the first is gone"
    finally:
        port.close()


@pytest.mark.parametrize("ahead_us", [90_000_000, -90_000_000])
def test_two_senders_behind_one_address_are_told(ahead_us: int) -> None:
    """A router hides the addresses; the clocks differ."""
    port = Port()
    try:
        router = port.talker(PILOT)
        nodes = [mavlink.MAVLink(None, 1, NODE) for _ in range(2)]
        router.beat()
        port.run()
        for number in range(600):
            for node, begin_us, z_mps2 in zip(nodes, (100_000_000, 100_000_000 + ahead_us), (-9.8, -3.0), strict=True):
                message = mavlink.MAVLink_highres_imu_message(begin_us + 10_000 * number, 0, 0, z_mps2, *[0] * 10, 63)
                if number > 20 or node is nodes[0]:
                    router.send(bytes(message.pack(node)))
            port.run(0.01)
        warnings = [text for text in port.texts() if "two senders" in text]
        assert len(warnings) == 1
        assert f"component {NODE}" in warnings[0]
        assert port.samples() == {-9.8: 600}, "the first keeps its place"
    finally:
        port.close()


def test_a_sender_behind_the_same_address_takes_the_place_of_one_that_is_silent() -> None:
    port = Port()
    try:
        pilot, router = port.talker(PILOT), port.talker(NODE)
        pilot.beat()
        port.run()
        for begin_us, z_mps2 in ((100_000_000, -9.8), (900_000_000, -3.0)):
            for number in range(300):
                router.sample(begin_us + 10_000 * number, z_mps2)
                port.run(0.01)
        assert port.samples()[-9.8] == 300
        assert 195 <= port.samples()[-3.0] <= 201, "a second later"
    finally:
        port.close()


def test_one_stamp_far_ahead_costs_itself_alone() -> None:
    """It made every sample behind it late, until the clock was taken for one that restarted."""
    port = Port()
    try:
        pilot, node = port.talker(PILOT), port.talker(NODE)
        pilot.beat()
        port.run()
        for number in range(300):
            node.sample(10_000_000 + 10_000 * number + (500_000_000 if number == 100 else 0))
            port.run(0.01)
        assert port.samples() == {-9.8: 299}
        assert ClockRestart not in {type(record) for record in port.records}
    finally:
        port.close()


def test_a_node_that_restarts_once_is_no_second_sender() -> None:
    port = Port()
    try:
        pilot, node = port.talker(PILOT), port.talker(NODE)
        pilot.beat()
        port.run()
        for begin_us in (500_000_000, 1_000_000):
            for number in range(300):
                node.sample(begin_us + 10_000 * number)
                port.run(0.01)
        assert ClockRestart in {type(record) for record in port.records}
        assert not [text for text in port.texts() if "two senders" in text]
    finally:
        port.close()


def test_no_frame_is_lost_where_a_second_route_is_the_faster(port: Port, key: bytes | None) -> None:
    """Each frame comes by both routes; the holder's own arrives last, after a second in which it was the first."""
    pilot, other_route, came = port.talker(PILOT, key=key), port.talker(66), 0
    for number in range(200):
        frame = pilot.sample_frame(10_000 * number)
        for route in (pilot, other_route) if number < 100 else (other_route, pilot):
            route.send(frame)
            chunk = port.link.read()
            came += chunk is not None and chunk.data == frame
        port.clock.now += 10 * MS
    assert came == 200
    if port.signing is not None:
        assert not port.signing.refused
        pilot.send(frame)
        assert port.link.read() is None
        assert port.signing.refused == {Refusal.REPLAYED: 1}, "what the holder sends again is no copy by another route"


def test_a_routed_copy_is_refused_without_a_warning() -> None:
    port = Port()
    try:
        pilot, node, router = port.talker(PILOT), port.talker(NODE), port.talker(66)
        pilot.beat()
        port.run()
        for number in range(100):
            frame = node.sample_frame(1_000_000 + 5000 * number)
            node.send(frame)
            router.send(frame)
            port.run(0.02)
        assert port.samples()[-9.8] == 100
        assert not [text for text in port.texts() if "used twice" in text]
    finally:
        port.close()


def test_a_sender_that_comes_back_from_another_port_is_heard_again(port: Port, key: bytes | None) -> None:
    pilot = port.talker(PILOT, key=key)
    pilot.beat()
    port.run()
    for place in range(2):
        node = port.talker(NODE, key=key)
        node.packer.signing.timestamp = NOW + place * 400_000
        for number in range(100):
            node.sample(1_000_000 + 4_000_000 * place + 5000 * number, -9.0 - place)
            port.run(0.01)
        port.run(2.0)
    assert port.samples() == {-9.0: 100, -10.0: 100}


def test_a_frame_may_be_cut_by_a_datagram_while_others_speak(port: Port, key: bytes | None) -> None:
    """A bridge cuts its serial stream anywhere."""
    pilot, bridge, stranger = port.talker(PILOT, key=key), port.talker(NODE, key=key), port.talker(66)
    pilot.beat()
    port.run()
    for number in range(50):
        frame = bridge.sample_frame(1_000_000 + 5000 * number)
        bridge.send(frame[: 7 + number % 30])
        stranger.send(b"\xfd\x20")
        pilot.beat()
        bridge.send(frame[7 + number % 30 :])
        port.run(0.02)
    assert port.samples()[-9.8] == 50


def test_a_flood_of_frames_is_sifted_in_little_time() -> None:
    """A second of a 20-fold flood (some 50,000 frames) costs well under a second."""
    udp = UdpIn("127.0.0.1", 0)
    udp.senders.guarded = frozenset((1, NODE))
    node = Talker(("127.0.0.1", udp.port), NODE)
    frame = node.sample_frame(1)
    begun_s, passed_bytes = time.process_time(), 0
    for _ in range(500):
        passed_bytes += len(udp._sifted(("127.0.0.1", 9), frame * 100, GUARDED_FRAMES, 0))
    assert passed_bytes == 500 * 100 * len(frame)
    assert time.process_time() - begun_s < 0.5
    node.socket.close()
    udp.close()


# ------------------------------------------------------------------------------------------ which autopilot is served


class Choosing:
    """An adapter that hears several autopilots on one wire, each answering TIMESYNC or not."""

    def __init__(self, system: int = 0) -> None:
        self.clock, self.wire = TurnedClock(), Wire()
        settings = Settings().replace("SW_SYSID", float(system))
        self.pilot = MavlinkAutopilot(
            [Link(0, "wire", self.wire, self.clock)], load_airframe("nadir-2m"), settings, self.clock
        )
        self.records: list[Record] = []

    def run(self, seconds: float, beating: tuple[int, ...], answering: tuple[int, ...] = (), mode: int = 0) -> None:
        for tick in range(round(seconds / 0.05)):
            self.clock.now += 50 * MS
            self.records += self.pilot.poll(0.0)
            asked = [m for frame in self.wire.sent for m in mavlink.MAVLink(None).parse_buffer(frame) or []]
            self.wire.sent.clear()
            for system in beating:
                packer = mavlink.MAVLink(None, system, PILOT)
                if tick % 20 == 0:
                    self.wire.inbox += mavlink.MAVLink_heartbeat_message(1, 3, mode, 0, 4, 3).pack(packer)
                for message in asked:
                    if system in answering and message.get_type() == "TIMESYNC" and message.tc1 == 0:
                        answer = mavlink.MAVLink_timesync_message(self.clock.now + system * 1000 * MS, message.ts1)
                        self.wire.inbox += answer.pack(packer)
            self.records += self.pilot.poll(0.0)

    def texts(self) -> list[str]:
        return [record.text for record in self.records if isinstance(record, Notice)]

    @property
    def served(self) -> int | None:
        return self.pilot.decoder.system_id


def test_one_stray_heartbeat_does_not_own_the_service() -> None:
    choosing = Choosing()
    choosing.run(0.1, (77,))
    choosing.run(4.0, (1,))
    assert choosing.served == 77, "it might come back"
    choosing.run(6.0, (1,))
    assert choosing.served == 1
    assert "autopilot 77/1 is silent: serving 1/1 now" in choosing.texts()
    assert ClockRestart in {type(record) for record in choosing.records}


@pytest.mark.parametrize(("answering", "mode"), [((1,), 0), ((), mavlink.MAV_MODE_FLAG_SAFETY_ARMED)])
def test_an_autopilot_that_answered_or_was_armed_is_served_for_good(answering: tuple[int, ...], mode: int) -> None:
    choosing = Choosing()
    choosing.run(10.0, (1,), answering, mode)
    choosing.run(20.0, (2,), (2,), mode)
    assert choosing.served == 1, "it reboots"
    sentence = "autopilot 1/1 is silent; 2/1 is not served: set SW_SYSID or restart Spanwise"
    assert choosing.texts().count(sentence) == 1
    choosing.run(10.0, (1, 2), (1, 2), mode)
    choosing.run(20.0, (2,), (2,), mode)
    assert choosing.served == 1
    assert choosing.texts().count(sentence) == 2, "each time"
    assert ClockRestart not in {type(record) for record in choosing.records}


def test_one_armed_heartbeat_of_a_stranger_does_not_own_the_service() -> None:
    choosing = Choosing()
    choosing.run(0.1, (77,), (), mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    choosing.run(12.0, (1,), (1,), mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
    assert choosing.served == 1


def test_a_second_autopilot_is_told_and_changes_nothing_while_the_first_lives() -> None:
    choosing = Choosing()
    choosing.run(1.0, (1,))
    choosing.run(30.0, (1, 77), (1, 77))
    assert choosing.served == 1
    assert sum("autopilot 77/1 is heard too" in text for text in choosing.texts()) == 1


def test_who_answers_takes_the_place_of_who_only_beats() -> None:
    choosing = Choosing()
    choosing.run(1.0, (77,))
    choosing.run(10.0, (77, 1), (1,))
    assert choosing.served == 1


def test_a_pause_of_all_moves_nothing() -> None:
    choosing = Choosing()
    choosing.run(3.0, (1, 77), (1, 77))
    choosing.run(30.0, ())
    choosing.run(3.0, (77, 1), (1, 77))
    assert choosing.served == 1


def test_the_configured_system_is_served_and_no_other() -> None:
    choosing = Choosing(system=1)
    choosing.run(20.0, (77,), (77,))
    assert choosing.served is None
    assert any("only 77/1 beat" in text for text in choosing.texts())
    choosing.run(2.0, (77, 1), (77, 1))
    assert choosing.served == 1
    choosing.run(20.0, (77,), (77,))
    assert choosing.served == 1

"""Signed links, with pymavlink as the other side: what is unsigned, foreign, replayed, stale or bent stays out."""

from __future__ import annotations

import hashlib
import os
import socket
import time
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.generator.mavcrc import x25crc

from companion.adapters.mavlink.decode.decoder import Decoder
from companion.adapters.mavlink.link.dialect import NewerMessage
from companion.adapters.mavlink.link.link import Link, open_link
from companion.adapters.mavlink.link.signing import Refusal, SignedTransport, Signing, load_signing
from companion.cli.doctor import diagnose
from companion.doctor.evidence import FindingLevel
from companion.doctor.examine import Examination
from companion.errors import ConfigError
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Notice, ParameterChange, RawChunk
from companion.service.config import ServiceConfig
from companion.service.wiring import Service
from sitl_tests.loop.ground_stations import COMPANION, SYSTEM, Air, S, Station, TurnedClock, Wire
from sitl_tests.ports import free_port

KEY, OTHER = bytes(range(32)), bytes(32)
NOW = 300_000_000_000_000 // 10  # some day, in 10 us
SECOND = 100_000
MADE_S = 1_420_070_400 + NOW // SECOND - 120  # when a key was made, seconds of the day's clock


class Other:
    """A pymavlink component that signs."""

    def __init__(self, key: bytes | None = KEY, timestamp: int = NOW, link: int = 5, component: int = 1) -> None:
        self.mav = mavlink.MAVLink(None, 3, component)
        if key is not None:
            self.mav.signing.secret_key = key
            self.mav.signing.link_id = link
            self.mav.signing.timestamp = timestamp
            self.mav.signing.sign_outgoing = True

    def frame(self, mark: int = 0) -> bytes:
        return bytes(mavlink.MAVLink_heartbeat_message(1, 3, 0, mark, 4, 3).pack(self.mav))


class Ours:
    def __init__(self, timestamp: int = NOW) -> None:
        self.clock, self.wire = TurnedClock(), Wire()
        self.signing = Signing(KEY, self.clock, timestamp)
        self.transport = SignedTransport(self.wire, self.signing, 2)

    def take(self, data: bytes) -> bytes:
        self.wire.inbox += data
        return self.transport.receive(65536, self.clock.now)


def test_signed_frames_come_in_and_are_the_same_bytes() -> None:
    ours, other = Ours(), Other()
    data = b"".join(other.frame(k) for k in range(20))
    assert ours.take(data) == data
    assert ours.signing.accepted == 20
    assert not ours.signing.refused


def test_cuts_anywhere_and_garbage_between_lose_nothing() -> None:
    other = Other()
    frames = [other.frame(k) for k in range(6)]
    # what looks like the start of a frame is waited for, so something must follow the last one
    data = b"\x00\xfd\xfe" + b"\xfd\x09".join(frames) + bytes(300)
    for cut in range(len(data)):
        ours = Ours()
        assert ours.take(data[:cut]) + ours.take(data[cut:]) == b"".join(frames)
    ours = Ours()
    assert b"".join(ours.take(data[k : k + 1]) for k in range(len(data))) == b"".join(frames)


def test_what_is_unsigned_of_mavlink_1_or_of_another_key_is_refused_and_counted() -> None:
    ours = Ours()
    plain, wrong = Other(key=None), Other(key=OTHER)
    old = bytes(mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3).pack(mavlink.MAVLink(None, 3, 1), True))
    assert ours.take(plain.frame() + old + wrong.frame() + wrong.frame()) == b""
    assert ours.signing.refused == {Refusal.UNSIGNED: 2, Refusal.WRONG_KEY: 2}
    (notice,) = ours.signing.notices(ours.clock.now)
    assert "2 unsigned" in notice.text
    assert "2 wrong key" in notice.text
    ours.take(plain.frame())
    assert ours.signing.notices(ours.clock.now + S) == []


def test_a_telemetry_radio_s_status_is_no_refusal() -> None:
    """SiK radios mix it in, and have no key."""
    ours, status = Ours(), mavlink.MAVLink_radio_status_message(200, 200, 90, 30, 30, 0, 0)
    for is_old in (False, True):
        assert ours.take(bytes(status.pack(mavlink.MAVLink(None, 51, 68), is_old))) == b""
    assert not ours.signing.refused


def test_a_frame_is_taken_once() -> None:
    ours, other = Ours(), Other()
    first, second = other.frame(1), other.frame(2)
    assert ours.take(first + first + second + first) == first + second
    assert ours.signing.refused == {Refusal.REPLAYED: 2}


def test_streams_are_apart_by_link_and_component() -> None:
    ours = Ours()
    same = [Other(link=1), Other(link=2), Other(link=1, component=200)]
    data = b"".join(other.frame() for other in same)
    assert ours.take(data) == data


@pytest.mark.parametrize(("behind_s", "taken"), [(59.9, True), (60.1, False), (-3600.0, True)])
def test_a_new_stream_may_be_a_minute_behind(behind_s: float, taken: bool) -> None:
    ours = Ours()
    frame = Other(timestamp=NOW - round(behind_s * SECOND)).frame()
    assert (ours.take(frame) == frame) is taken
    assert ours.signing.refused.get(Refusal.STALE, 0) == (not taken)


def test_our_time_runs_and_follows_what_is_ahead() -> None:
    ours = Ours()
    ours.clock.now += 61 * S
    assert ours.take(Other(timestamp=NOW).frame()) == b""
    ahead = NOW + 7200 * SECOND
    assert ours.take(Other(timestamp=ahead).frame())
    assert ours.signing.now() == ahead
    ours.clock.now += S
    assert ours.signing.now() == ahead + SECOND
    # whoever has recorded a frame of before cannot bring it back as a new stream
    assert ours.take(Other(timestamp=NOW + 3600 * SECOND, link=9).frame()) == b""


def test_a_forger_cannot_stop_a_stream() -> None:
    """A wrong signature with a stamp far ahead must not count as the stream's newest."""
    ours, honest = Ours(), Other()
    assert ours.take(honest.frame())
    ours.take(Other(key=OTHER, timestamp=NOW + 10**9).frame())
    assert ours.take(honest.frame(1))


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 255))
def test_a_bent_frame_never_comes_in(place: int, flip: int) -> None:
    ours = Ours()
    frame = bytearray(Other().frame(7))
    frame[place % len(frame)] ^= flip
    assert ours.take(bytes(frame)) == b""


def test_what_we_send_is_accepted_by_pymavlink_with_the_key_and_by_nobody_else() -> None:
    ours = Ours()
    packer = mavlink.MAVLink(None, 3, 191)
    for k in range(5):
        message = mavlink.MAVLink_named_value_float_message(k, b"toe_mrad", 0.5 * k)
        ours.transport.send(bytes(message.pack(packer)))
        packer.seq += 1
    for key, results in ((KEY, [True] * 5), (OTHER, [False] * 5)):
        peer = mavlink.MAVLink(None)
        peer.robust_parsing = True
        peer.signing.secret_key = key
        peer.signing.timestamp = NOW
        parsed = [peer.parse_buffer(frame)[0] for frame in ours.wire.sent]
        assert [message.get_type() == "NAMED_VALUE_FLOAT" for message in parsed] == results
    stamps = [int.from_bytes(frame[-12:-6], "little") for frame in ours.wire.sent]
    assert stamps == sorted(set(stamps)), "each stamp is later, though the clock stands still"


def test_a_message_that_pymavlink_does_not_know_is_signed() -> None:
    """COMPONENT_METADATA, which ground stations ask for as they connect; its CRC extra is 182 (common.xml)."""
    ours = Ours()
    message = NewerMessage(397, "COMPONENT_METADATA", 182, "<II", time_boot_ms=7, file_crc=9)
    plain = bytes(message.pack(mavlink.MAVLink(None, 3, 191)))
    ours.transport.send(plain)
    (frame,) = ours.wire.sent
    assert (frame[2], frame[3:-15], len(frame)) == (1, plain[3:-2], len(plain) + 13)
    crc = x25crc(frame[1:-15] + b"\xb6")
    assert int.from_bytes(frame[-15:-13], "little") == crc.crc
    assert frame[-6:] == hashlib.sha256(KEY + frame[:-6]).digest()[:6]


def test_a_key_file_is_read_and_a_bad_one_named(tmp_path: Path) -> None:
    path = tmp_path / "key"
    clock = TurnedClock()
    with pytest.raises(ConfigError, match="cannot read"):
        load_signing(path, clock)
    path.write_text("passphrase: correct horse\n")
    path.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        load_signing(path, clock)
    path.chmod(0o600)
    os.utime(path, (MADE_S, MADE_S))
    signing = load_signing(path, clock)
    frame = Other(key=hashlib.sha256(b"correct horse").digest()).frame()
    assert signing.judge(frame) is None
    path.write_text(KEY.hex())
    os.utime(path, (MADE_S, MADE_S))
    assert load_signing(path, clock).judge(Other(timestamp=NOW + SECOND).frame()) is None
    for bad in ("", "abcd", KEY.hex() + "00", "passphrase:"):
        path.write_text(bad)
        with pytest.raises(ConfigError, match="64 hexadecimal"):
            load_signing(path, clock)


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    """A key that was made two minutes before NOW."""
    path = tmp_path / "key"
    path.write_text(KEY.hex())
    path.chmod(0o600)
    os.utime(path, (MADE_S, MADE_S))
    return path


def stamped(path: Path, before: str = "") -> str:
    """Content of the stamp file, once it is another than before."""
    stamp = path.with_name("key.stamp")
    for _ in range(3000):  # the deadline of a hang: a busy disk may take seconds
        if stamp.exists() and stamp.read_text() != before:
            return stamp.read_text()
        time.sleep(0.01)
    raise AssertionError("nothing was kept")


def test_after_a_power_cycle_at_most_a_second_of_old_traffic_comes_in(key_file: Path) -> None:
    """Ten minutes of two streams, one of them 20 s behind; then the power is cut at any instant."""
    clock = TurnedClock()
    before = load_signing(key_file, clock)
    recorded: list[tuple[int, bytes]] = []
    text = ""
    for tick in range(6000):
        clock.now += S // 10
        stamps = (NOW + tick * SECOND // 10, NOW - 20 * SECOND + tick * SECOND // 10)
        for link, stamp in enumerate(stamps):
            frame = Other(timestamp=stamp, link=link).frame()
            assert before.judge(frame) is None
            recorded.append((tick, frame))
        if tick % 5 == 4 and tick > 5990:
            text = stamped(key_file, text)
        if tick % 5 == 4 and tick >= 5989:
            time.sleep(0.2)  # the thread that wrote ends, or the next half second's stamps would be left out
    again = load_signing(key_file, TurnedClock())
    accepted = [tick for tick, frame in recorded if again.judge(frame) is None]
    assert len(accepted) <= 2 * 10
    assert all(tick >= 6000 - 10 for tick in accepted)
    for link, stamp in enumerate((NOW + 601 * SECOND, NOW - 20 * SECOND + 601 * SECOND)):
        assert again.judge(Other(timestamp=stamp, link=link).frame()) is None, "each stream goes on"
    assert again.judge(Other(timestamp=NOW + 590 * SECOND, link=9).frame()) is Refusal.STALE, "a new one must be new"
    assert again.judge(Other(timestamp=NOW + 603 * SECOND, link=9).frame()) is None


def test_a_stamp_that_cannot_be_written_refuses_the_start_and_is_told_in_flight(key_file: Path) -> None:
    key_file.with_name("key.stamp").mkdir()  # not even root may put a file in its place
    clock = TurnedClock()
    signing = load_signing(key_file, clock)
    with pytest.raises(ConfigError, match=r"key\.stamp of signing cannot be written"):
        signing.require_keeping()
    assert signing.judge(Other().frame()) is None, "in flight it goes on"
    assert signing._keeper is not None
    assert signing._keeper._writing is not None
    signing._keeper._writing.join()
    (notice,) = signing.notices(clock.now)
    assert "a restart lets old frames in" in notice.text
    assert len(notice.text) <= 2 * 50
    assert signing.notices(clock.now + 59 * S) == []
    assert len(signing.notices(clock.now + 60 * S)) == 1
    key_file.with_name("key.stamp").rmdir()
    signing.require_keeping()
    assert signing.notices(clock.now + 200 * S) == []


def test_the_service_does_not_start_where_its_signing_time_cannot_be_kept(key_file: Path) -> None:
    key_file.with_name("key.stamp").mkdir()
    config = ServiceConfig(load_airframe("nadir-2m"), Settings(), (), signing_key=key_file)
    with pytest.raises(ConfigError, match="signing cannot be written"):
        Service(config)


def test_trying_to_keep_the_time_changes_nothing_that_was_kept(key_file: Path) -> None:
    stamp = key_file.with_name("key.stamp")
    stamp.write_text(f"{NOW}\n5 3 1 {NOW - 7}\n")
    for _ in range(3):
        load_signing(key_file, TurnedClock()).require_keeping()
    assert stamp.read_text() == f"{NOW}\n5 3 1 {NOW - 7}\n"


def test_a_service_keeps_its_signing_time_in_its_state_folder(
    key_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    beside = key_file.with_name("key.stamp")
    beside.write_text(f"{NOW}\n")  # of before it had one
    (tmp_path / "state").mkdir()
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path / 'state'}:{tmp_path / 'other'}")
    signing = load_signing(key_file, TurnedClock())
    assert signing.judge(Other(timestamp=NOW - SECOND).frame()) is Refusal.STALE
    signing.require_keeping()
    assert (tmp_path / "state" / "key.stamp").read_text() == f"{NOW}\n"
    beside.unlink()
    assert load_signing(key_file, TurnedClock()).judge(Other(timestamp=NOW - SECOND).frame()) is Refusal.STALE


def test_our_own_stamps_go_on_behind_those_before_the_cut(key_file: Path) -> None:
    clock = TurnedClock()
    before = load_signing(key_file, clock)
    last = before.sign(Other(key=None).frame(), 0)
    stamped(key_file)
    clock.now += S // 2 - 1
    last = before.sign(Other(key=None).frame(), 0)
    again = load_signing(key_file, TurnedClock())
    first = again.sign(Other(key=None).frame(), 0)
    assert int.from_bytes(first[-12:-6], "little") > int.from_bytes(last[-12:-6], "little")


@pytest.mark.parametrize("damage", [None, "", "soon\n", "-5\n", f"{1 << 60}\n", "12\n1 2\n"])
def test_without_a_good_stamp_file_nothing_older_than_the_key_comes_in(key_file: Path, damage: str | None) -> None:
    if damage is not None:
        key_file.with_name("key.stamp").write_text(damage)
    signing = load_signing(key_file, TurnedClock())
    for age_s in (3 * 365 * 86400, 86400, 121):
        assert signing.judge(Other(timestamp=NOW - age_s * SECOND).frame()) is Refusal.STALE
    assert signing.judge(Other(timestamp=NOW).frame()) is None


def test_a_stamp_file_of_an_earlier_version_is_read(key_file: Path) -> None:
    key_file.with_name("key.stamp").write_text(f"{NOW + 500 * SECOND}\n")
    signing = load_signing(key_file, TurnedClock())
    assert signing.judge(Other(timestamp=NOW + 499 * SECOND).frame()) is Refusal.STALE
    assert signing.judge(Other(timestamp=NOW + 502 * SECOND).frame()) is None


@pytest.mark.parametrize(("key", "reason"), [(OTHER, Refusal.WRONG_KEY), (None, Refusal.UNSIGNED)])
def test_a_wrong_key_is_no_dead_cable(key: bytes | None, reason: Refusal) -> None:
    air = Air()
    signing = air.pilot.component.signing = Signing(KEY, air.clock, NOW)
    air.pilot._links[0]._transport = SignedTransport(air.wire, signing, 0)
    if key is not None:
        air.beats.signing.secret_key, air.beats.signing.timestamp = key, NOW
        air.beats.signing.sign_outgoing = True
    texts = [record.text for record in air.run(12.0) if isinstance(record, Notice)]
    assert f"no autopilot heartbeat: frames arrive, all are refused: {reason} (--sign-key)" in texts
    assert any(text.startswith(f"signing refused 1 {reason}") for text in texts)
    assert not any("nothing arrives" in text for text in texts)


@pytest.mark.parametrize("key", [KEY, OTHER])
def test_the_doctor_names_refused_frames(key: bytes) -> None:
    ours, pilot, node = Ours(), Other(key=key), Other(key=None, component=200)
    links = [Link(0, "memory", ours.transport, ours.clock)]
    examination = Examination(links, ours.clock, load_airframe("nadir-2m"), Settings(), 3.0, signing=ours.signing)
    while not examination.over:
        ours.wire.inbox += pilot.frame() + node.frame()
        ours.clock.now += S // 2
        examination.run_once(0.0)
    texts = [entry.text for entry in diagnose(examination.evidence()) if entry.level is FindingLevel.FIX]
    if key == OTHER:
        assert texts == ["no autopilot heartbeat: frames arrive, all are refused: unsigned, wrong key (--sign-key)"]
    else:
        assert any(text.startswith("signing refused 6 unsigned") for text in texts)


def test_a_node_without_a_key_is_heard_over_a_link_that_is_not_signed() -> None:
    clock = TurnedClock()
    signing = Signing(KEY, clock, NOW)
    node, came = Other(key=None, component=200), {}
    for ending in ("", ",unsigned"):
        port = free_port(socket.SOCK_DGRAM)
        link = open_link(f"udpin:127.0.0.1:{port}{ending}", clock, 0, signing)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(node.frame(), ("127.0.0.1", port))
        came[ending] = link.read() is not None
        link.close()
    assert came == {"": False, ",unsigned": True}
    (notice,) = signing.notices(clock.now)
    assert notice.text == "signing refused 1 unsigned: spell a link whose nodes cannot sign LINK,unsigned"


def test_over_a_signed_link_only_the_signed_station_sets_and_the_recording_replays_without_the_key() -> None:
    honest, intruder = Station(), Station(system=254)
    air = Air(honest, intruder)
    signing = Signing(KEY, air.clock, NOW)
    air.pilot._links[0]._transport = SignedTransport(air.wire, signing, 0)
    for link, mav in enumerate((honest.packer, air.beats)):
        mav.signing.secret_key, mav.signing.link_id, mav.signing.timestamp = KEY, link, NOW
        mav.signing.sign_outgoing = True
    air.run(2.0)
    intruder.set("RNG_TRUST", 0.2)
    honest.set("OUT_RATE", 5.0)
    air.run(0.5)
    changes = [record for record in air.records if isinstance(record, ParameterChange)]
    assert [(change.name, change.value) for change in changes] == [("OUT_RATE", 5.0)]
    assert honest.values["OUT_RATE"] == 5.0
    assert signing.refused == {Refusal.UNSIGNED: 4}  # its heartbeats and its PARAM_SET
    decoder = Decoder(load_airframe("nadir-2m"), COMPANION)
    chunks = [record for record in air.records if isinstance(record, RawChunk)]
    again = [repr(record) for chunk in chunks for record in decoder.decode_chunk(chunk)]
    adapter_kinds = (RawChunk, Notice, ParameterChange)
    assert again == [repr(record) for record in air.records if not isinstance(record, adapter_kinds)]
    assert decoder.system_id == SYSTEM

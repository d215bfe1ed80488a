"""Our metadata, fetched over MAVLink FTP with pymavlink's own client, and read as ground stations read it."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lxml import objectify
from pymavlink import mavftp
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.component.ftp import FileServer
from companion.adapters.mavlink.decode.message_records import Heard
from companion.params.metadata import apm_pdef_xml, mavlink_crc32, metadata_files, parameter_json
from companion.params.settings import tunables
from sitl_tests.loop.ground_stations import COMPANION, SYSTEM, Air, S, Station

FILES = metadata_files(COMPANION)
ROWS = list(tunables())


class Master:
    """Connection for pymavlink's client: a station in our air."""

    source_system, source_component = 255, 190

    def __init__(self, air: Air, station: Station) -> None:
        self.air, self.station = air, station
        self.mav = self
        self.taken = 0

    def file_transfer_protocol_send(self, network: int, system: int, component: int, payload: Any) -> None:
        self.station.say(mavlink.MAVLink_file_transfer_protocol_message(network, system, component, list(payload)))

    def recv_match(self, type: Any, timeout: float, blocking: bool = True) -> Any:
        ends = self.air.clock.now + round(timeout * S)
        while True:
            while self.taken < len(self.station.heard):
                message = self.station.heard[self.taken]
                self.taken += 1
                if message.get_type() in type:
                    return message
            if self.air.clock.now >= ends:
                return None
            self.air.run(0.005)

    def time(self) -> float:
        return self.air.clock.now / S

    def sleep(self, seconds: float) -> None:
        self.air.run(max(seconds, 0.005))


def client(monkeypatch: pytest.MonkeyPatch, loss: float = 0.0, seed: int = 1) -> tuple[Any, Master]:
    station = Station()
    station.greets = False
    master = Master(Air(station, loss=loss, seed=seed), station)
    master.air.run(1.0)
    monkeypatch.setattr(mavftp, "time", master)
    return mavftp.MAVFTP(master, SYSTEM, COMPANION), master


@pytest.mark.parametrize("path", sorted(FILES))
@pytest.mark.parametrize(("loss", "seed"), [(0.0, 1), (0.1, 2), (0.1, 3)])
def test_every_file_arrives_whole(monkeypatch: pytest.MonkeyPatch, path: str, loss: float, seed: int) -> None:
    ftp, _ = client(monkeypatch, loss, seed)
    got: list[bytes] = []
    ftp.cmd_get([path], callback=lambda file: got.append(file.read() if file is not None else b""))
    ftp.process_ftp_reply("OpenFileRO", timeout=60)
    assert got == [FILES[path]]


def test_the_list_names_every_file_with_its_size(monkeypatch: pytest.MonkeyPatch) -> None:
    ftp, _ = client(monkeypatch)
    listed = ftp.cmd_list(["/"])
    sizes_b = {entry.name: entry.size_b for entry in listed.directory_listing}
    assert sizes_b == {path[1:]: len(content) for path, content in FILES.items()}


def test_nothing_can_be_written_and_unknown_files_are_not_found(monkeypatch: pytest.MonkeyPatch) -> None:
    ftp, master = client(monkeypatch)
    ftp.cmd_get(["/etc/passwd"], callback=lambda _: None)
    ftp.process_ftp_reply("OpenFileRO", timeout=10)
    replies = [m for m in master.station.heard if m.get_type() == "FILE_TRANSFER_PROTOCOL"]
    assert replies
    assert all(m.payload[3] == mavftp.OP_Nack for m in replies if m.payload[5] == mavftp.OP_OpenFileRO)
    for opcode in range(6, 14):
        payload = struct.pack("<HBBBBBBI", 900 + opcode, 0, opcode, 5, 0, 0, 0, 0) + b"/x.py"
        message = mavlink.MAVLink_file_transfer_protocol_message(0, SYSTEM, COMPANION, list(payload.ljust(251, b"\0")))
        master.station.say(message)
        master.air.run(0.1)
        answer = [m for m in master.station.heard if m.get_type() == "FILE_TRANSFER_PROTOCOL"][-1]
        assert (answer.payload[3], answer.payload[5]) == (mavftp.OP_Nack, opcode)


@given(st.binary(min_size=0, max_size=251))
def test_no_request_breaks_the_server_or_gets_what_is_not_there(payload: bytes) -> None:
    server = FileServer(FILES, COMPANION)
    message = mavlink.MAVLink_file_transfer_protocol_message(0, SYSTEM, COMPANION, list(payload.ljust(251, b"\0")))
    for _ in range(3):
        server.hear(Heard(0, 255, 190, message, 0), SYSTEM)
    sent = [server.due(k * S) for k in range(200)]
    answers = [bytes(m.payload) for m in sent if m is not None]
    assert len(answers) <= 120
    for answer in answers:
        size = answer[4]
        data = answer[12 : 12 + size]
        if answer[3] == mavftp.OP_Ack and answer[5] in (mavftp.OP_ReadFile, mavftp.OP_BurstReadFile):
            assert any(data in content for content in FILES.values())


# ------------------------------------------------------------------------------------------ what the files say


def test_mavproxys_help_reads_the_definition_file() -> None:
    """The loops are those of MAVProxy's ``param help``: it wants entries in the vehicle and in every library."""
    tree = objectify.fromstring(apm_pdef_xml().encode())
    definitions = {entry.get("name").split(":")[1]: entry for entry in tree.vehicles.parameters.param}
    for library in tree.libraries.parameters:
        definitions |= {entry.get("name"): entry for entry in library.param}
    assert definitions.keys() == {row.name for row in ROWS}
    for row in ROWS:
        entry = definitions[row.name]
        fields = {field.get("name"): str(field) for field in entry.field}
        low, high = (float(limit) for limit in fields["Range"].split())
        assert (low, high) == (row.minimum, row.maximum)
        assert fields.get("Units", "") == row.unit
        assert ("RebootRequired" in fields) is not row.live
        values = [str(value) for value in entry["values"].value] if row.choices else []
        assert tuple(values) == row.choices
        assert entry.get("documentation") == row.doc


def test_the_component_metadata_leads_from_the_message_to_the_ranges() -> None:
    station = Station()
    air = Air(station)
    air.run(1.0)
    request = mavlink.MAVLink_command_long_message(
        SYSTEM, COMPANION, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 397.0, 0, 0, 0, 0, 0, 0
    )
    station.say(request)
    frames: list[bytes] = []
    for _ in range(20):
        frames += air.wire.sent
        air.run(0.005)
    raw = next(frame for frame in frames if frame[7:10] == (397).to_bytes(3, "little"))
    body = raw[10:-2].ljust(108, b"\0")
    _, crc, uri = struct.unpack("<II100s", body)
    place = uri.rstrip(b"\0").decode()
    assert place == f"mftp://[;comp={COMPANION}]/general.json"
    general = FILES[place.split("]")[1]]
    assert crc == mavlink_crc32(general)
    (entry,) = json.loads(general)["metadataTypes"]
    content = FILES[entry["uri"].split("]")[1]]
    assert entry["type"] == 1
    assert entry["fileCrc"] == mavlink_crc32(content)
    table = {row["name"]: row for row in json.loads(content)["parameters"]}
    for row in ROWS:
        parameter = table[row.name]
        assert (parameter["min"], parameter["max"], parameter["default"], parameter["units"]) == (
            row.minimum,
            row.maximum,
            row.default,
            row.unit,
        )
        assert parameter["rebootRequired"] is not row.live
    acknowledged = [m for m in station.heard if m.get_type() == "COMMAND_ACK"]
    assert [m.result for m in acknowledged] == [mavlink.MAV_RESULT_ACCEPTED]


def test_the_setup_s_table_names_the_groups_and_choices_that_the_metadata_gives() -> None:
    text = (Path(__file__).resolve().parents[2] / "config" / "SETUP.md").read_text()
    documented = dict(re.findall(r"^\| (\w+) \| `([A-Z]+)_\*` \|", text, re.MULTILINE))
    rows = json.loads(FILES["/parameter.json"])["parameters"]
    assert documented == {row["group"]: row["name"].partition("_")[0] for row in rows}
    assert {row["category"] for row in rows} == {"Standard"}
    (choices,) = (row["values"] for row in rows if row["name"] == "TRG_POLICY")
    assert [choice["value"] for choice in choices] == list(range(len(choices)))


@pytest.mark.parametrize(
    ("command", "wanted", "result"),
    [
        (mavlink.MAV_CMD_REQUEST_MESSAGE, 148, mavlink.MAV_RESULT_ACCEPTED),
        (mavlink.MAV_CMD_REQUEST_MESSAGE, 30, mavlink.MAV_RESULT_UNSUPPORTED),
        (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, mavlink.MAV_RESULT_UNSUPPORTED),
    ],
)
def test_a_command_to_us_is_always_answered(command: int, wanted: float, result: int) -> None:
    station = Station()
    air = Air(station)
    air.run(1.0)
    for component in (COMPANION, 0, 1, 200):
        station.say(mavlink.MAVLink_command_long_message(SYSTEM, component, command, 0, wanted, 0, 0, 0, 0, 0, 0))
    air.run(0.2)
    answers = [m for m in station.heard if m.get_type() == "COMMAND_ACK"]
    assert [(m.command, m.result, m.target_system) for m in answers] == [(command, result, 255)]


def test_the_checksum_is_mavlinks() -> None:
    """Bit by bit: polynomial 0x04C11DB7 reflected, started at 0, not inverted."""
    data = np.random.default_rng(1).bytes(300)
    state = 0
    for byte in data:
        state ^= byte
        for _ in range(8):
            state = state >> 1 ^ (0xEDB88320 if state & 1 else 0)
    assert mavlink_crc32(data) == state
    assert len(parameter_json()) < 20_000


def test_a_station_that_begins_again_with_the_same_number_gets_its_own_answer() -> None:
    server, sizes = FileServer(FILES, COMPANION), {}
    for at_s, path in enumerate(sorted(FILES, key=lambda name: len(FILES[name]))[:2]):
        head = struct.pack("<HBBBBBBI", 0, 0, mavftp.OP_OpenFileRO, len(path), 0, 0, 0, 0)
        payload = list((head + path.encode()).ljust(251, b"\0"))
        message = mavlink.MAVLink_file_transfer_protocol_message(0, SYSTEM, COMPANION, payload)
        for _ in range(2):  # the second time as our answer was lost
            server.hear(Heard(0, 255, 190, message, 0), SYSTEM)
        answers = [server.due((at_s + 1) * S + k * S // 10) for k in range(2)]
        sizes[path] = {struct.unpack_from("<I", bytes(answer.payload), 12)[0] for answer in answers}
    assert sizes == {path: {len(FILES[path])} for path in sizes}

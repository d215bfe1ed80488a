"""Inputs that fuzzing broke something with, each input made by code: it ends in data or in one sentence, at once."""

from __future__ import annotations

import io
import re
import struct
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.io import savemat

from companion.adapters.cameras.folder import read_grey
from companion.adapters.recordings.logs.bin import BinRecording
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.recording import Notes
from companion.adapters.recordings.recording_factory import open_recording
from companion.adapters.recordings.tables.mapped_recording import MappedRecording
from companion.adapters.recordings.tables.mapping import parse_mapping
from companion.adapters.recordings.tables.matlab_file import read_matlab
from companion.calibration.vibration import read_vibration_test
from companion.cli.main import main
from companion.core.pipeline import start
from companion.errors import ConfigError, DeviceError, RecordingError
from companion.params.files import dump_airframe, load_airframe, parse_airframe
from companion.params.learned import load_latency
from companion.params.settings import Settings
from companion.records import ImuBatch, Tick
from sitl_tests.fuzz import corpora
from sitl_tests.unit import test_recordings_bin as onboard
from sitl_tests.unit import test_recordings_mcap as ours
from sitl_tests.unit import test_recordings_ulog as px4

AIRFRAME = load_airframe("sitl-plane")


def ulog(tmp_path: Path, data: bytes) -> list[ImuBatch]:
    """The samples that are read, in less time than any hang takes."""
    (tmp_path / "a.ulg").write_bytes(data)
    began = time.process_time()
    try:
        recording = open_recording(tmp_path / "a.ulg", AIRFRAME)
        return [record for record in recording.records() if isinstance(record, ImuBatch)]
    finally:
        assert time.process_time() - began < 2.0


def message(kind: bytes, body: bytes) -> bytes:
    return struct.pack("<H", len(body)) + kind + body


def test_a_ulog_cut_in_its_definitions_ends(tmp_path: Path) -> None:
    """pyulog went back by a message's whole length at the end of the file, and read it again, for ever."""
    log_bytes = px4.three_imus(40).data
    with pytest.raises(RecordingError, match="no inertial samples"):
        ulog(tmp_path, log_bytes[:60] + b"\xff\xff\x00" + log_bytes[60:90])


@pytest.mark.parametrize(
    "fields",
    [
        "float[99999999] x;",
        "float[65535] x;" * 9,
        "sensor_accel x;",
        "float x",
        "float[-1] x;",
        "",
        "uint64_t;",
        "x[2] y;",
    ],
)
def test_a_ulog_format_that_cannot_be_is_damage(tmp_path: Path, fields: str) -> None:
    data = px4.three_imus(40).data.replace(px4.FORMATS["sensor_accel"].encode(), b"?", 1)
    formats = message(b"F", f"sensor_accel:{fields}".encode())
    with pytest.raises(RecordingError, match="no inertial samples"):
        ulog(tmp_path, data[:16] + formats + data[16:])


def test_ulog_formats_nested_as_a_bomb_cost_nothing(tmp_path: Path) -> None:
    """Ten fields in ten fields, eight times: each of no bytes, a hundred million in all."""
    bomb = b"".join(message(b"F", f"n{i}:{f'n{i + 1} x;' * 10}".encode()) for i in range(7))
    bomb += message(b"F", b"n7:" + b"float[0] x;" * 10)
    bomb += message(b"F", b"sensor_accel:uint64_t timestamp;n0 x;float y;")
    with pytest.raises(RecordingError, match="no inertial samples"):
        ulog(tmp_path, px4.MAGIC_AND_START + bomb + message(b"A", struct.pack("<BH", 0, 1) + b"sensor_accel"))


def test_a_ulog_is_read_on_behind_damage(tmp_path: Path) -> None:
    """A length field that swallows what follows, and garbage, cost the messages that they hit."""
    log = px4.three_imus(400)
    sample_count = sum(len(batch.t_ns) for batch in ulog(tmp_path, log.data))
    middle = log.data.index(b"D\0\0" + struct.pack("<QQ", 205_300, 205_000)) - 2
    swallowed = log.data[:middle] + b"\xff\x0f" + log.data[middle + 2 :]
    garbage = log.data[:middle] + np.random.default_rng(1).bytes(3000) + log.data[middle:]
    for data in (swallowed, garbage):
        remaining_count = sum(len(batch.t_ns) for batch in ulog(tmp_path, data))
        assert sample_count - 150 <= remaining_count < sample_count + 1


def test_a_megabyte_of_noise_in_a_ulog_costs_seconds_at_most(tmp_path: Path) -> None:
    data = px4.three_imus(40).data
    noise = np.random.default_rng(2).integers(64, 84, 1_000_000, dtype=np.uint8).tobytes()  # many kinds, wrong lengths
    assert ulog(tmp_path, data + noise)


def bin_log(tmp_path: Path, number: int, letters: bytes, columns: bytes, values: bytes) -> BinRecording:
    """An onboard log of one kind of message."""
    body = struct.pack("<BB4s16s64s", number, 3 + len(values), b"ACC", letters, columns)
    data = onboard.HEAD + bytes([128]) + body + 50 * (onboard.HEAD + bytes([number]) + values)
    (tmp_path / "a.BIN").write_bytes(data)
    return BinRecording(tmp_path / "a.BIN", AIRFRAME)


@pytest.mark.parametrize(
    ("letters", "columns", "values"),
    [
        (b"QBZfff", b"TimeUS,I,SampleUS,AccX,AccY,AccZ", struct.pack("<QB64sfff", 1, 0, b"\xe8\x03", 0, 0, -9.8)),
        (b"QBQfff", b"TimeUS,I,SampleUS,AccX,AccX,AccZ", struct.pack("<QBQfff", 1, 0, 1, 0, 0, -9.8)),
        (b"QBQfff", b"TimeUS,I,,AccX,AccY,AccZ", struct.pack("<QBQfff", 1, 0, 1, 0, 0, -9.8)),
    ],
)
def test_columns_of_an_onboard_log_that_cannot_be_are_refused(
    tmp_path: Path, letters: bytes, columns: bytes, values: bytes
) -> None:
    with pytest.raises(RecordingError):
        bin_log(tmp_path, 162, letters, columns, values)


def test_an_onboard_log_whose_stamps_all_are_one_keeps_the_airframes_rate(tmp_path: Path) -> None:
    values = struct.pack("<QBQfff", 1, 0, 1000, 0, 0, -9.8)
    recording = bin_log(tmp_path, 162, b"QBQfff", b"TimeUS,I,SampleUS,AccX,AccY,AccZ", values)
    assert recording.airframe.root.rate_hz == AIRFRAME.root.rate_hz


def chunk_at(data: bytes) -> int:
    at = 8
    while data[at] != 6:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    return at + 9


@pytest.mark.parametrize("size", [2**31, 2**40, 2**63, 2**64 - 1])
def test_sizes_in_a_chunk_are_held_against_what_is_there(tmp_path: Path, size: int) -> None:
    """One flipped byte made an OverflowError; what a chunk says it unpacks to was allocated."""
    path = tmp_path / "a.mcap"
    ours.write(path, ours.seconds_of_flight(3))
    data = path.read_bytes()
    at = chunk_at(data)
    for offset in (16, 36):  # the size once unpacked, the size of the packed bytes
        path.write_bytes(data[: at + offset] + struct.pack("<Q", size) + data[at + offset + 8 :])
        recording = McapRecording(path)
        assert any(isinstance(record, Tick) for record in recording.records()), "the other chunks"
        assert offset == 36 or any("damaged and left out" in notice.text for notice in recording.notices)


@pytest.mark.slow
def test_a_damaged_message_in_a_whole_chunk_is_left_out_and_told(tmp_path: Path) -> None:
    from sitl_tests.fuzz.structured import mcap_record

    path, rng = tmp_path / "a.mcap", np.random.default_rng(5)
    undamaged = corpora.mcaps()[0]
    warned_count = 0
    for _ in range(60):
        path.write_bytes(mcap_record(undamaged, rng))
        try:
            recording = McapRecording(path)
        except (RecordingError, ConfigError):
            continue
        for _ in recording.records():
            pass
        warned_count += any("a message of" in notice.text for notice in recording.notices)
    assert warned_count > 3


@pytest.mark.parametrize("kind", [0, 8, 10, 11, 19, 2**16 - 1])
def test_a_matlab_file_with_an_unknown_kind_of_number_is_refused(tmp_path: Path, kind: int) -> None:
    """scipy's reader took the process with it."""
    file = io.BytesIO()
    savemat(file, {"data": np.random.default_rng(1).standard_normal((30, 3))})
    data = file.getvalue()
    at = data.rindex(struct.pack("<II", 9, 720))
    (tmp_path / "a.mat").write_bytes(data[:at] + struct.pack("<I", kind) + data[at + 4 :])
    with pytest.raises(RecordingError, match="damaged"):
        read_matlab(tmp_path / "a.mat")


@pytest.mark.slow
def test_a_matlab_bomb_is_refused(tmp_path: Path) -> None:
    import zlib

    packer = zlib.compressobj(9)
    packed = b"".join(packer.compress(bytes(1 << 20)) for _ in range(500)) + packer.flush()
    (tmp_path / "a.mat").write_bytes(bytes(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(packed)) + packed)
    with pytest.raises(RecordingError, match="once unpacked"):
        read_matlab(tmp_path / "a.mat")


@pytest.mark.parametrize("number", [np.float64, np.float32, np.int16, np.uint8])
@pytest.mark.parametrize("packed", [False, True])
def test_matlab_files_are_read_as_they_were_written(tmp_path: Path, number: type, packed: bool) -> None:
    values = (10 * np.random.default_rng(1).random((7, 3))).astype(number)
    names = np.array(["Drive", "Tip ü"], dtype=object)
    savemat(tmp_path / "a.mat", {"data": values, "names": names, "note": "rig 7"}, do_compression=packed)
    back = read_matlab(tmp_path / "a.mat")
    np.testing.assert_array_equal(back["data"], values)
    assert [str(entry[0]) for entry in back["names"].reshape(-1)] == ["Drive", "Tip ü"]
    assert back["note"].tolist() == ["rig 7"]


def test_an_image_of_impossible_size_is_refused(tmp_path: Path) -> None:
    _, encoded = cv2.imencode(".png", np.zeros((4, 4), np.uint8))
    data = encoded.tobytes()
    (tmp_path / "a.png").write_bytes(data[:16] + struct.pack(">II", 2**31 - 1, 2**31 - 1) + data[24:])
    with pytest.raises(DeviceError, match="not an image"):
        read_grey(tmp_path / "a.png")


@pytest.mark.parametrize(
    "text",
    [
        b"rate_hz = 0", b"rate_hz = 1e400", b"rate_hz = '2'", b"rate_hz = [1]", b"band_hz = 3\nrate_hz = 1",
        b"\xff", b"x = " + b"[" * 3000, b"rate_hz = 1" + b"0" * 4000,
    ],
)  # fmt: skip
def test_what_no_toml_file_should_hold_is_told_in_a_sentence(tmp_path: Path, text: bytes) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(text + b"\n")
    for read in (
        lambda: load_airframe(str(path)),
        lambda: read_vibration_test(path, tmp_path, read_matlab),
        lambda: load_latency(path),
    ):
        with pytest.raises(ConfigError, match=r"a\.toml"):
            read()
    with pytest.raises(ConfigError, match=r"a\.toml"):
        parse_mapping(text.decode("latin-1"), "a.toml")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("orientation", "9" * 400),
        ("frequency_hz", "1_000"),
        ("slope_factor_radpm", "-0"),
        ("slope_factor_radpm", "1e-6"),
        ("corners_hz", "[1e-300, 20.0]"),
    ],
)
def test_numbers_of_an_airframe_that_cannot_be_are_refused(key: str, value: str) -> None:
    """They ended in an OverflowError, a ZeroDivisionError, or a model of the tracker that is not stable."""
    text = re.sub(rf"^{key} = .*$", f"{key} = {value}", dump_airframe(AIRFRAME), count=1, flags=re.MULTILINE)
    with pytest.raises(ConfigError, match=rf"a\.toml: '.*{key}"):
        parse_airframe(text, "a.toml")


@pytest.mark.parametrize("damping", ["1e-4", "0.03", "0.5"])
@pytest.mark.parametrize("rate_hz", [100, 500])
@pytest.mark.parametrize("corner_hz", ["0.001", "1000.0"])
def test_the_stiffest_mode_that_is_accepted_can_be_tracked(damping: str, rate_hz: float, corner_hz: str) -> None:
    text = dump_airframe(AIRFRAME)
    for key, value in (
        ("frequency_hz", "500"),
        ("damping", damping),
        ("rate_hz", "2000.0"),
        ("corners_hz", f"[{corner_hz}, 1000.0]"),
    ):
        text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
    start(parse_airframe(text, "a.toml"), Settings().replace("TRK_RATE", rate_hz))


@pytest.mark.parametrize("rate", ["0", "-5", "nan", "inf", "1e999"])
def test_a_vibration_layout_without_a_rate_is_refused(tmp_path: Path, rate: str) -> None:
    layout = tmp_path / "layout.toml"
    layout.write_text(
        f"rate_hz = {rate}\nband_hz = [4.0, 35.5]\nforce = {{ column = 1, newton_per_volt = 9.4 }}\n"
        "accelerometers = { columns = [2], mps2_per_volt = 9.5 }\n[[points]]\nnumber = 1\nspan_m = 0.4\naft_m = 0.4\n"
        'edge = "leading"\n[[runs]]\nfile = "a.mat"\npoints = [1]\n'
    )
    savemat(tmp_path / "a.mat", {"signalIn": np.random.default_rng(1).standard_normal((64, 3))})
    with pytest.raises(ConfigError, match="rate_hz"):
        read_vibration_test(layout, tmp_path, read_matlab)


def test_a_mapping_with_what_is_no_number_is_refused(tmp_path: Path) -> None:
    base = 'rate_hz = 100\n[columns]\n"#1" = { channel = "left_z_mps2" }\n'
    extra = '[[recordings]]\nfile = "a"\nvalues = { x_m = 2026-01-01 }\n'
    for text in (base + extra, base.replace("100", "1" + "0" * 400), base + "[table]\nheader_line = -3\n"):
        with pytest.raises(ConfigError, match=r"lab\.toml"):
            MappedRecording(tmp_path / "a.txt", parse_mapping(text, "lab.toml"), AIRFRAME)


@pytest.mark.slow
@pytest.mark.parametrize("stamp_us", [2**40, 2**62])
def test_a_damaged_stamp_is_not_flown_through(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], stamp_us: int
) -> None:
    """A replay stepped its clock, ten milliseconds at a time, to wherever one sample said it was."""
    log = onboard.flight(300)
    for imu in range(3):
        log.add("ACC", 400_000, imu, stamp_us, 0.1, 0.2, -9.8)
        log.add("GYR", 400_000, imu, stamp_us, 0.1, 0.2, -9.8)
    (tmp_path / "a.BIN").write_bytes(log.data)
    began = time.process_time()
    assert main(["replay", str(tmp_path / "a.BIN"), "--airframe", "sitl-plane"]) in (0, 3)
    assert time.process_time() - began < 10.0
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("steps_ns", [(-5, -5, -5), (0, 0, 9), (-5, -5, 40)])
def test_stamps_that_mostly_go_back_or_repeat_are_told_and_have_no_gaps(steps_ns: tuple[int, ...]) -> None:
    notes = Notes()
    notes.gaps("left", np.cumsum(np.array((100, *steps_ns), dtype=np.int64)))
    assert len(notes.notices) == 1
    assert re.search(r"stamps (go back|repeat)", notes.notices[0].text)

"""Bad input on the command line: exit code 1 and one clear sentence, never a traceback."""

from __future__ import annotations

import json
import signal
import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.cli.main import main

BAD_INPUT = 1
NOTHING_FOUND = 3


@pytest.fixture(autouse=True)
def _signals() -> Iterator[None]:
    """``spanwise run`` takes over SIGINT, SIGTERM and SIGHUP; give them back."""
    before = [(number, signal.getsignal(number)) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    yield
    for number, handler in before:
        signal.signal(number, handler)


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run a command that must be refused; give its sentence."""

    def run(*arguments: object) -> str:
        code = main([str(argument) for argument in arguments])
        said = capsys.readouterr()
        assert code == BAD_INPUT
        assert said.out == ""
        lines = said.err.strip().splitlines()
        assert len(lines) == 1
        assert lines[0].startswith(f"spanwise {arguments[0]}: ")
        assert "Traceback" not in said.err
        return lines[0]

    return run


def table(folder: Path, header: str = "t_s,left_z_mps2,right_z_mps2,root_z_mps2", seconds: float = 3.0) -> Path:
    """Write accel.csv of a wing at rest at 200 Hz."""
    folder.mkdir(exist_ok=True)
    columns = header.count(",")
    rows = [f"{k / 200:.4f}" + ",-9.81" * columns for k in range(round(200 * seconds))]
    (folder / "accel.csv").write_text("\n".join([header, *rows]) + "\n")
    return folder


def tlog(path: Path, seconds: float = 2.0) -> Path:
    """Write a tlog of an autopilot at rest: three IMUs at 100 Hz."""
    packer = mavlink.MAVLink(None, 1, 1)
    with path.open("wb") as file:
        for step in range(round(100 * seconds)):
            still = (0, 0, -1000, 0, 0, 0, 0, 0, 0)
            messages = [
                mavlink.MAVLink_raw_imu_message(10_000 * step, *still),
                mavlink.MAVLink_scaled_imu2_message(10 * step, *still),
                mavlink.MAVLink_scaled_imu3_message(10 * step, *still),
            ]
            if step % 100 == 0:
                messages.insert(0, mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3))
            for message in messages:
                file.write(struct.pack(">Q", 1_700_000_000_000_000 + 10_000 * step) + message.pack(packer))
                packer.seq = (packer.seq + 1) % 256
    return path


# ------------------------------------------------------------------------------------------ airframe


@pytest.mark.parametrize(
    "command", [("simulate", "--out", "x"), ("demo", "--out", "x"), ("run", "--connect", "udpin:127.0.0.1:0")]
)
def test_an_airframe_that_is_not_there_is_answered_with_those_that_are(
    command: tuple[str, ...], refused: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    sentence = refused(*command, "--airframe", "nadir-3m")
    assert "nadir-3m" in sentence
    assert "nadir-2m" in sentence
    assert "sitl-plane" in sentence
    assert not (tmp_path / "x").exists(), "nothing was begun"


def test_a_log_that_does_not_tell_its_aircraft_needs_an_airframe(refused: Callable[..., str], tmp_path: Path) -> None:
    sentence = refused("replay", tlog(tmp_path / "flight.tlog"))
    assert "--airframe" in sentence


def test_an_airframe_file_with_a_wrong_value_is_named_with_its_key(refused: Callable[..., str], tmp_path: Path) -> None:
    bad = tmp_path / "mine.toml"
    source = Path(__file__).resolve().parents[2] / "config" / "airframes" / "nadir-2m.toml"
    bad.write_text(source.read_text().replace("semispan_m = 1.0", 'semispan_m = "one metre"'))
    sentence = refused("simulate", "--airframe", bad, "--out", tmp_path / "out")
    assert "mine.toml" in sentence
    assert "semispan_m" in sentence


@pytest.mark.parametrize("name", ["covariate-frequency", "airspeed-dependence"])
def test_an_effect_that_follows_a_channel_is_not_flown_without_one(
    name: str, refused: Callable[..., str], tmp_path: Path
) -> None:
    sentence = refused("simulate", "--effect", f"{name}=0.05", "--out", tmp_path / "out")
    assert name in sentence
    assert "channel" in sentence
    assert not (tmp_path / "out").exists()


def test_the_demo_needs_cameras(refused: Callable[..., str], tmp_path: Path) -> None:
    assert "no camera pair" in refused("demo", "--airframe", "sitl-plane", "--out", tmp_path)


# ------------------------------------------------------------------------------------------ recordings


def test_a_telemetry_log_is_not_made_into_one(refused: Callable[..., str], tmp_path: Path) -> None:
    flown = tlog(tmp_path / "flight.tlog")
    sentence = refused("convert", flown, tmp_path / "other.tlog", "--airframe", "sitl-plane")
    assert "is a telemetry log already" in sentence


def test_a_device_that_is_no_serial_one_is_said_to_be_none(refused: Callable[..., str]) -> None:
    sentence = refused("run", "--connect", "/dev/null", "--airframe", "nadir-2m", "--for", "1")
    assert sentence.endswith("/dev/null: is no serial device")


def test_a_table_in_another_encoding_is_told_which_is_read(refused: Callable[..., str], tmp_path: Path) -> None:
    header = "t_s,left_z_mps2,Böe".encode("latin-1")
    (tmp_path / "accel.csv").write_bytes(header + b"\n0.0,-9.8,1\n")
    assert "is not text in UTF-8" in refused("replay", tmp_path, "--airframe", "nadir-2m")


def test_a_recording_that_is_not_there(refused: Callable[..., str], tmp_path: Path) -> None:
    assert "no such file" in refused("replay", tmp_path / "gone.mcap")


def test_a_file_that_is_no_recording(refused: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("flew well today")
    assert "not a recording" in refused("replay", tmp_path / "notes.txt", "--airframe", "sitl-plane")


@pytest.mark.parametrize(
    ("header", "named"),
    [
        ("t_s,left_z_mps,right_z_mps2,root_z_mps2", "left_z_mps"),
        ("t_ms,left_z_mps2,right_z_mps2,root_z_mps2", "t_s"),
        ("t_s,left_p_mps2,right_z_mps2,root_z_mps2", "left_p_mps2"),
    ],
)
def test_a_table_in_wrong_units_is_refused_with_file_line_and_column(
    header: str, named: str, refused: Callable[..., str], tmp_path: Path
) -> None:
    sentence = refused("replay", table(tmp_path / "lab", header), "--airframe", "sitl-plane")
    assert "accel.csv, line 1" in sentence
    assert named in sentence


def test_a_table_whose_time_goes_back_is_told_and_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = table(tmp_path / "lab") / "accel.csv"
    lines = path.read_text().splitlines()
    lines[300], lines[301] = lines[301], lines[300]
    path.write_text("\n".join(lines) + "\n")
    assert main(["replay", str(tmp_path / "lab"), "--airframe", "sitl-plane"]) != BAD_INPUT
    assert "root: 1 of 600 stamps go back" in capsys.readouterr().out


@pytest.mark.slow
def test_a_hole_in_a_table_is_told_and_bridged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = table(tmp_path / "lab") / "accel.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(lines[:201] + lines[321:]) + "\n")
    code = main(["replay", str(tmp_path / "lab"), "--airframe", "sitl-plane", "--json"])
    said = capsys.readouterr()
    result = json.loads(said.out)
    assert code == NOTHING_FOUND, "a wing at rest has no mode"
    assert said.err == ""
    holes = [notice for notice in result["notices"] if "gap" in notice]
    assert holes
    assert any("605.0 ms" in notice for notice in holes), "120 rows are missing: 605 ms between two rows"


@pytest.mark.parametrize("cut", [1, 7, 19])
def test_a_tlog_cut_inside_a_message_is_read_to_there(
    cut: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tlog(tmp_path / "flight.tlog")
    path.write_bytes(path.read_bytes()[:-cut])
    code = main(["replay", str(path), "--airframe", "sitl-plane", "--json"])
    said = capsys.readouterr()
    result = json.loads(said.out)
    assert code == NOTHING_FOUND
    assert said.err == ""
    assert any("truncated" in notice for notice in result["notices"])
    assert result["outputs"]["ModeState"] >= 4, "the two seconds before the cut were used"


def test_an_empty_tlog_holds_nothing(refused: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "empty.tlog").write_bytes(b"")
    assert "empty" in refused("replay", tmp_path / "empty.tlog", "--airframe", "sitl-plane")


# ------------------------------------------------------------------------------------------ settings and links


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ("RNG_MAXIMUM=5", "RNG_MAXIMUM"),
        ("trg_rat=5", "no parameter 'trg_rat'; is it TRG_RATE? spanwise params lists them"),
        ("X=5", "no parameter 'X'; spanwise params lists them"),
        ("RNG_MAX=far", "RNG_MAX=far"),
        ("RNG_MAX", "NAME=VALUE"),
        ("RNG_MAX=9000", "outside 5 to 500 m"),
        ("RNG_MAX=nan", "finite"),
        ("TRK_ADAPT=0.5", "whole number"),
    ],
)
def test_a_setting_that_cannot_be_is_refused(
    change: str, problem: str, refused: Callable[..., str], tmp_path: Path
) -> None:
    log = tlog(tmp_path / "flight.tlog", 0.5)
    assert problem in refused("replay", log, "--airframe", "sitl-plane", "--set", change)


def test_a_settings_file_is_checked_like_the_command_line(refused: Callable[..., str], tmp_path: Path) -> None:
    log, file = tlog(tmp_path / "flight.tlog", 0.5), tmp_path / "mine.toml"
    for text, problem in (("RNG_MAX = 'far'\n", "RNG_MAX"), ("RNG_MAX = = 3\n", "TOML"), ("RANGE = 3\n", "RANGE")):
        file.write_text(text)
        assert problem in refused("replay", log, "--airframe", "sitl-plane", "--settings", file)
    assert "gone.toml" in refused("replay", log, "--airframe", "sitl-plane", "--settings", tmp_path / "gone.toml")


@pytest.mark.parametrize(
    ("spelling", "hint"),
    [("udp14550", "udpin:HOST:PORT"), ("udpin:14550", "host and a port"), ("/dev/ttyNONE9,fast", "baud")],
)
def test_a_misspelt_link_is_answered_with_the_right_spelling(
    spelling: str, hint: str, refused: Callable[..., str], tmp_path: Path
) -> None:
    keep = tmp_path / "kept"
    sentence = refused("run", "--connect", spelling, "--airframe", "nadir-2m", "--parameters", keep, "--for", "1")
    assert spelling in sentence
    assert hint in sentence

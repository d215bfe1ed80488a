"""Progress of a replay: on standard error alone, at a terminal or where lines were asked for."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import pytest
from pymavlink.dialects.v20.ardupilotmega import MAVLink, MAVLink_heartbeat_message

from companion.adapters.recordings.logs.tlog import TlogRecording
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.main import main
from companion.cli.terminal.progress import Progress, length_ns, progress_of
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, Tick

SECOND_NS = 1_000_000_000


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every look at the clock finds it two seconds later."""
    beats = itertools.count(100.0, 2.0)
    monkeypatch.setattr("companion.cli.terminal.progress.time.monotonic", lambda: next(beats))


def wing_at_rest(folder: Path, seconds: float) -> Path:
    folder.mkdir()
    rows = [f"{k / 200:.4f},-9.81,-9.81,-9.81" for k in range(round(200 * seconds))]
    (folder / "accel.csv").write_text("\n".join(["t_s,left_z_mps2,right_z_mps2,root_z_mps2", *rows]) + "\n")
    return folder


@pytest.mark.usefixtures("clock")
def test_lines_tell_the_share_and_the_time(capsys: pytest.CaptureFixture[str]) -> None:
    progress = Progress("replaying", 40 * SECOND_NS, plain=True)
    for second in range(41):
        progress.at(7 * SECOND_NS + second * SECOND_NS)
    progress.close()
    said = capsys.readouterr()
    assert said.out == ""
    shares = [int(match) for match in re.findall(r"^replaying +(\d+) %, \d+ s of flight in \d+ s$", said.err, re.M)]
    assert len(shares) == len(said.err.splitlines()) >= 5
    assert shares == sorted(shares)
    assert 5 <= shares[0] < shares[-1] <= 100


@pytest.mark.usefixtures("clock")
def test_a_terminal_gets_one_line_that_is_rewritten_and_wiped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    progress = Progress("replaying", None, plain=False)
    for second in range(5):
        progress.at(second * SECOND_NS)
    progress.close()
    said = capsys.readouterr().err
    assert "\n" not in said
    assert "replaying 3 s of flight in " in said
    assert said.endswith("\r\033[K")


@pytest.mark.usefixtures("clock")
def test_a_pipe_gets_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    progress = Progress("replaying", None, plain=False)
    progress.at(SECOND_NS)
    progress.at(9 * SECOND_NS)
    progress.close()
    assert capsys.readouterr() == ("", "")


@pytest.mark.usefixtures("clock")
def test_a_telemetry_log_tells_the_share_of_its_bytes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stamp_us, frame = 1_700_000_000_000_000, MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)
    packed = frame.pack(MAVLink(None, srcSystem=1))
    log = b"".join((stamp_us + 100_000 * k).to_bytes(8, "big") + packed for k in range(100))
    (tmp_path / "flight.tlog").write_bytes(log)
    recording = open_recording(tmp_path / "flight.tlog", load_airframe("sitl-plane"))
    assert isinstance(recording, TlogRecording)
    progress = progress_of(recording, "replaying", plain=True)
    for stamp_us, _ in recording.frames():
        progress.at(1000 * stamp_us)
    shares = [int(match) for match in re.findall(r"^replaying +(\d+) %, ", capsys.readouterr().err, re.M)]
    assert shares == sorted(shares)
    assert 1 <= shares[0] < 10
    assert shares[-1] > 90


def test_the_length_is_that_of_the_samples(tmp_path: Path) -> None:
    recording = open_recording(wing_at_rest(tmp_path / "lab", 3.0), load_airframe("sitl-plane"))
    assert length_ns(recording) == pytest.approx(2.995e9, abs=1e3)


def test_the_length_of_our_own_recording_is_that_of_its_records(tmp_path: Path) -> None:
    airframe = load_airframe("nadir-2m")
    writer = McapWriter(tmp_path / "flight.mcap", About.of(airframe, Settings(), ClockName.HOST))
    for second in range(5, 13):
        writer.write(Tick(second * SECOND_NS))
    writer.close()
    assert length_ns(open_recording(tmp_path / "flight.mcap", None)) == 7 * SECOND_NS


@pytest.mark.slow
def test_json_stays_json(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.cli.terminal.progress._LINE_S", 0.0)
    folder = wing_at_rest(tmp_path / "lab", 3.0)
    main(["replay", str(folder), "--airframe", "sitl-plane", "--json", "--plain"])
    said = capsys.readouterr()
    assert said.out.startswith("{")
    assert said.out.rstrip().endswith("}")
    assert "replaying" not in said.out
    assert re.search(r"replaying +9\d %", said.err)

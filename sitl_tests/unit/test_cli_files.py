"""Files that commands are given: none is lost by naming it twice, and what is said is what was written."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.cli.main import main
from companion.cli.run import _recorded, _recordings
from companion.cli.steps.options import check_output
from companion.errors import ConfigError
from companion.params.airframe import NamedEffect
from companion.params.files import dump_airframe, load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, Record, Tick

AIRFRAMES = Path(__file__).resolve().parents[2] / "config" / "airframes"


@pytest.mark.parametrize("link", [False, True])
def test_a_recording_is_not_overwritten_by_what_is_made_of_it(tmp_path: Path, *, link: bool) -> None:
    recording, other = tmp_path / "flight.mcap", tmp_path / "link.mcap"
    recording.write_bytes(b"a flight")
    if link:
        other.symlink_to(recording)
    with pytest.raises(ConfigError, match="is what is read"):
        check_output(other if link else recording, "--out", [recording])
    check_output(tmp_path / "new.mcap", "--out", [recording])


def test_a_table_of_a_laboratorys_folder_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "accel.csv").write_text("t_s\n")
    with pytest.raises(ConfigError, match="is what is read"):
        check_output(tmp_path / "accel.csv", "--json", [tmp_path])
    (tmp_path / "found.json").write_text("{}")
    check_output(tmp_path / "found.json", "--json", [tmp_path])


@pytest.mark.parametrize("name", ["run.csv", "run.txt", "mapping.toml", "mapping.json"])
def test_a_table_or_mapping_that_is_named_itself_is_not_overwritten(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("t_s\n")
    with pytest.raises(ConfigError, match="is what is read"):
        check_output(tmp_path / name, "--json", [tmp_path / name])
    if name == "run.txt":
        with pytest.raises(ConfigError, match="is what is read"):
            check_output(tmp_path / name, "--html", [tmp_path])


@pytest.mark.parametrize("option", ["--json", "--html"])
def test_diagnose_leaves_its_recording_and_its_mapping_as_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str
) -> None:
    table, mapping = tmp_path / "run.csv", tmp_path / "mapping.toml"
    for path in (table, mapping):
        path.write_text("as it was\n")
        assert main(["diagnose", str(table), "--mapping", str(mapping), option, str(path)]) == 1
        assert "is what is read" in capsys.readouterr().err
        assert path.read_text() == "as it was\n"


@pytest.mark.parametrize("command", [["replay", "--out"], ["report", "--out"]])
def test_replay_and_report_leave_their_recording_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    recording = tmp_path / "flight.mcap"
    recording.write_bytes(b"a flight")
    assert main([command[0], str(recording), command[1], str(recording)]) == 1
    assert "is what is read" in capsys.readouterr().err
    assert recording.read_bytes() == b"a flight"


@pytest.mark.parametrize("words", [["--set", "TRG_RATE=500"], ["--set", "TRG_RAT=5"], ["--live", "127.0.0.1:99999"]])
def test_a_refused_demo_leaves_the_last_flight_as_it_is(tmp_path: Path, words: list[str]) -> None:
    flown = [tmp_path / name for name in ("flight.mcap", "summary.png", "summary.json")]
    for file in flown:
        file.write_text("of the last flight")
    assert main(["demo", *words, "--out", str(tmp_path)]) == 1
    assert all(file.exists() for file in flown)
    assert main(["demo", *words, "--out", str(tmp_path / "new")]) == 1
    assert not (tmp_path / "new").exists()


def test_an_interrupted_demo_leaves_no_result_of_another_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stopped(*_: object) -> None:
        raise ConfigError("stopped")

    monkeypatch.setattr("companion.cli.demo._flown", stopped)
    for name in ("demo.txt", "flight.mcap", "summary.png", "summary.json"):
        (tmp_path / name).write_text("of the last flight")
    assert main(["demo", "--duration", "2", "--out", str(tmp_path)]) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["demo.txt"]
    assert "2 s of nadir-2m" in (tmp_path / "demo.txt").read_text()


@pytest.mark.parametrize("name", ["flight.mcap", "summary.json"])
def test_a_demo_leaves_files_that_no_demo_wrote(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    (tmp_path / name).write_text("of a real flight")
    assert main(["demo", "--duration", "2", "--out", str(tmp_path)]) == 1
    assert f"holds a {name} that no demo wrote" in capsys.readouterr().err
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {name: "of a real flight"}


def test_a_demo_replaces_one_from_before_they_left_a_mark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object) -> None:
        raise ConfigError("stopped")

    monkeypatch.setattr("companion.cli.demo._flown", stopped)
    (tmp_path / "summary.json").write_text('{"toe_error_mrad": {}}')
    assert main(["demo", "--duration", "2", "--out", str(tmp_path)]) == 1
    assert not (tmp_path / "summary.json").exists()


@pytest.mark.parametrize(
    ("words", "ending"),
    [
        (["report", "flight.mcap", "--out"], ".html"),
        (["replay", "flight.mcap", "--out"], ".mcap"),
        (["diagnose", "flight.mcap", "--html"], ".html"),
        (["diagnose", "flight.mcap", "--json"], ".json"),
        (["diagnose", "flight.mcap", "--apply"], ".toml"),
        (["params", "--xml"], ".xml"),
        (["run", "--connect", "udpin:127.0.0.1:0", "--airframe", "nadir-2m", "--record"], ".mcap"),
    ],
)
def test_a_file_is_not_named_as_what_it_does_not_hold(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], ending: str
) -> None:
    assert main([*words, str(tmp_path / "x.tlog")]) == 1
    assert f"x.tlog: what is written there ends in {ending}" in capsys.readouterr().err


@pytest.mark.parametrize("option", [["--out", "~/flown"], ["--out=~/flown"]])
def test_a_quoted_home_is_the_users(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: list[str]) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "--duration", "2", *option]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["flown"]


def test_the_recording_that_is_told_is_the_one_that_was_written(tmp_path: Path) -> None:
    before, written = tmp_path / "flight.mcap", tmp_path / "flight.2.mcap"
    before.write_bytes(b"yesterday")
    earlier = _recordings(before)
    assert _recorded(before, earlier) == f"nothing was recorded to {before}"
    written.write_bytes(b"today")
    assert f"recorded {written};" in _recorded(before, earlier)


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_an_effect_of_no_finite_size_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str], value: str) -> None:
    where = tmp_path / "flight"
    assert main(["simulate", "--airframe", "nadir-2m", "--effect", f"tone={value}", "--out", str(where)]) == 1
    assert "not a finite number" in capsys.readouterr().err
    assert not where.exists()


def test_an_effect_of_a_size_that_nothing_has_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["simulate", "--duration", "2", "--out", str(tmp_path), "--effect"]
    assert main([*command, "frequency-shift=1e300"]) == 1
    assert "ratio is 1e+300, and must be within 100000 from 0" in capsys.readouterr().err
    assert main([*command, "exposure-delay=10"]) == 1
    assert "the exposures lie outside the flight" in capsys.readouterr().err
    assert main([*command, "clock-skew=0.01"]) == 0


def test_a_page_of_settings_that_is_no_text_is_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "PARAMETERS.md").write_bytes(b"\xff\xfe")
    monkeypatch.chdir(tmp_path)
    assert main(["params", "--check"]) == 1
    assert "PARAMETERS.md: is not text in UTF-8" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["run", "--connect", "udpin:127.0.0.1:0", "--airframe", "nadir-2m", "--record", "."], "is a folder"),
        (["demo", "--flights", "3"], "--flights is of --landing"),
        (["setup", "--dry-run", "--airframe", "no-such-wing", "--link", "serial:/dev/ttyAMA0:921600"], "no-such-wing"),
    ],
)
def test_what_would_do_nothing_is_refused(capsys: pytest.CaptureFixture[str], words: list[str], sentence: str) -> None:
    assert main(words) == 1
    assert sentence in capsys.readouterr().err


def test_an_airframe_file_may_begin_with_the_mark_of_an_editor(tmp_path: Path) -> None:
    marked = tmp_path / "wing.toml"
    marked.write_text(dump_airframe(load_airframe("nadir-2m")), encoding="utf-8-sig")
    assert load_airframe(str(marked)) == load_airframe("nadir-2m")


def test_the_airframe_that_is_read_is_not_replaced_by_what_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wing, flight = tmp_path / "wing.toml", tmp_path / "flight"
    wing.write_text(dump_airframe(load_airframe("nadir-2m")))
    before = wing.read_text()
    flight.mkdir()
    (flight / "accel.csv").write_text("t_s,left_z_mps2,right_z_mps2\n")
    assert main(["diagnose", str(flight), "--airframe", str(wing), "--apply", str(wing)]) == 1
    assert "is what is read" in capsys.readouterr().err
    assert wing.read_text() == before


def test_ranges_of_an_earlier_flight_do_not_stay_beside_a_flight_without_cameras(tmp_path: Path) -> None:
    for name in ("nadir-2m", "sitl-plane"):
        assert main(["simulate", "--airframe", name, "--duration", "2", "--out", str(tmp_path)]) == 0
    assert not (tmp_path / "range.csv").exists()


def test_a_simulated_flight_tells_the_effects_of_its_airframe(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base = load_airframe("nadir-2m")
    changed = dataclasses.replace(base, effects=(NamedEffect("frequency-shift", {"ratio": -0.2}),))
    (tmp_path / "soft.toml").write_text(dump_airframe(changed))
    words = ["simulate", "--exact", "--airframe", str(tmp_path / "soft.toml"), "--duration", "2"]
    assert main([*words, "--out", str(tmp_path / "flown")]) == 0
    flown = capsys.readouterr().out
    assert f" {0.8 * base.wing.symmetric.frequency_hz.value:.3f} Hz" in flown
    assert "airframe's effect: frequency-shift {'ratio': -0.2}; hidden: nothing" in flown


def test_a_simulated_flight_does_not_replace_what_was_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = [tmp_path / name for name in ("accel.csv", "range.csv")]
    for table in measured:
        table.write_text("t_s\n")
    assert main(["simulate", "--duration", "2", "--out", str(tmp_path)]) == 1
    assert "holds other files already" in capsys.readouterr().err
    assert {path: path.read_text() for path in tmp_path.iterdir()} == dict.fromkeys(measured, "t_s\n")


def test_a_latency_is_not_written_into_an_airframe_that_did_not_fly_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = _empty_recording(tmp_path / "flight.mcap", "forward-2m")
    command = ["calibrate", "latency", str(flight), "--out", str(tmp_path), "--airframe"]
    assert main([*command, "nadir-2m"]) == 1
    assert "recorded by airframe 'forward-2m', not by 'nadir-2m'" in capsys.readouterr().err
    assert main([*command, "forward-2m"]) == 1
    assert "only 0 shots" in capsys.readouterr().err


def _empty_recording(path: Path, airframe: str) -> Path:
    McapWriter(path, About.of(load_airframe(airframe), Settings(), ClockName.HOST)).close()
    return path


def test_a_calibration_goes_on_from_the_earlier_or_leaves_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    earlier = tmp_path / "airframe.toml"
    earlier.write_text(dump_airframe(load_airframe("nadir-2m")))
    monkeypatch.setattr("companion.cli.calibrate._latency", lambda _, base: base)
    command = ["calibrate", "latency", "flight.mcap", "--out", str(tmp_path), "--airframe"]
    assert main([*command, "forward-2m"]) == 1
    assert f"give --airframe {earlier} to go on" in capsys.readouterr().err
    assert load_airframe(str(earlier)).name == "nadir-2m"
    assert main([*command, str(earlier)]) == 0


def test_run_refuses_an_airframe_that_no_process_could_read_messages_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Both tips on one source, as a copied section leaves them: one sentence, and no process is started."""
    wing = tmp_path / "wing.toml"
    wing.write_text(dump_airframe(load_airframe("nadir-2m")).replace("component = 201", "component = 200"))
    assert main(["run", "--connect", "udpin:127.0.0.1:0", "--airframe", str(wing), "--for", "1"]) == 1
    assert "has the same source as left" in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    [
        ("run", "--connect", "udpin:127.0.0.1:0", "--for", "1"),
        ("doctor", "--connect", "udpin:127.0.0.1:0", "--fix"),
        ("setup", "wing", "--connect", "sim"),
    ],
)
@pytest.mark.parametrize(
    ("before", "after", "sentence"),
    [
        ("orientation = 25", "orientation = 5", "is not along a body axis"),
        ("orientation = 25", "orientation = 0", "is not where the cameras look"),
        ("[right_camera]", "[right_camera]\nrow_time_s = 2e-5", "row_time_s of the cameras differ"),
        ("[left_camera]", "[left_camera]\ndistortion = [-0.9, 0.0, 0.0, 0.0, 0.0]", "folds the image"),
        ("[left_camera]", "[left_camera]\nrotation_rad = [0.0, 0.9, 0.0]", "more than 45 degrees apart"),
    ],
)
def test_cameras_that_no_process_could_use_are_refused_before_anything_is_opened(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: tuple[str, ...], before: str, after: str, sentence: str
) -> None:
    wing = tmp_path / "wing.toml"
    wing.write_text((AIRFRAMES / "nadir-2m.toml").read_text().replace(before, after))
    assert main([*command, "--airframe", str(wing)]) == 1
    said = capsys.readouterr()
    assert sentence in said.err
    assert said.out == ""


@pytest.mark.parametrize(
    ("command", "ending"),
    [(["replay", "--out"], ".mcap"), (["diagnose", "--airframe", "nadir-2m", "--apply"], ".toml")],
)
def test_a_file_of_another_flight_is_not_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str], ending: str
) -> None:
    recording, other = _empty_recording(tmp_path / "flight.mcap", "nadir-2m"), tmp_path / f"precious{ending}"
    other.write_text("as it was")
    assert main([command[0], str(recording), *command[1:], str(other)]) == 1
    assert "exists already, and would be lost" in capsys.readouterr().err
    assert other.read_text() == "as it was"


def test_an_airframe_that_no_file_can_be_named_after_is_told_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "accel.csv").write_text("t_s,left_z_mps2\n0.0,-9.8\n0.1,-9.8\n")
    wing = tmp_path / "wing.toml"
    wing.write_text((AIRFRAMES / "nadir-2m.toml").read_text().replace('name = "', 'name = "no-such/', 1))
    assert main(["diagnose", str(tmp_path), "--airframe", str(wing), "--apply"]) == 1
    assert "no folder no-such" in capsys.readouterr().err


def test_one_changed_setting_leaves_the_others_as_they_were_flown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They fell back to the defaults: a replay with one change was of another flight altogether."""
    path, replayed = tmp_path / "flight.mcap", list[Settings]()
    flown = Settings(smoother_lag_s=0.3, max_range_m=80.0)
    writer = McapWriter(path, About.of(load_airframe("nadir-2m"), flown, ClockName.HOST))
    writer.write(Tick(1))
    writer.close()

    def replay(_: object, settings: Settings, *__: object) -> Iterator[Record]:
        replayed.append(settings)
        return iter(())

    monkeypatch.setattr("companion.cli.replay._replayed", replay)
    file = tmp_path / "settings.toml"
    file.write_text("RNG_MIN = 5\n")
    for words in ([], ["--set", "RNG_MIN=5"], ["--settings", str(file)]):
        main(["replay", str(path), *words])
    changed = flown.replace("RNG_MIN", 5.0)
    assert replayed == [flown, changed, Settings().replace("RNG_MIN", 5.0)]


def test_a_replay_that_cannot_begin_leaves_no_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "accel.csv").write_text("t_s,root_z_mps2,left_z_mps2\n0.0,x,1.0\n")
    out = tmp_path / "out.mcap"
    assert main(["replay", str(tmp_path), "--airframe", "nadir-2m", "--out", str(out)]) == 1
    assert "line 2" in capsys.readouterr().err
    assert not out.exists()


def test_an_identification_goes_on_from_the_earlier_or_leaves_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    earlier = tmp_path / "airframe.toml"
    earlier.write_text(dump_airframe(load_airframe("nadir-2m")))
    monkeypatch.setattr("companion.cli.identify._from_flight", lambda *_: 0)
    command = ["identify", "flight", "flight.mcap", "--out", str(tmp_path)]
    assert main(command) == 1
    assert f"give --airframe {earlier} to go on" in capsys.readouterr().err
    assert main([*command, "--airframe", str(earlier)]) == 0

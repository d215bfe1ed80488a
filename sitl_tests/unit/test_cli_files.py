"""Files that commands are given: none is lost by naming it twice, and what is said is what was written."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.cli.main import main
from companion.cli.run import _recorded, _recordings
from companion.cli.steps.options import check_output
from companion.errors import ConfigError


@pytest.mark.parametrize("link", [False, True])
def test_a_recording_is_not_overwritten_by_what_is_made_of_it(tmp_path: Path, *, link: bool) -> None:
    recording, other = tmp_path / "flight.mcap", tmp_path / "link.mcap"
    recording.write_bytes(b"a flight")
    if link:
        other.symlink_to(recording)
    with pytest.raises(ConfigError, match="the recording itself"):
        check_output(other if link else recording, "--out", [recording])
    check_output(tmp_path / "new.mcap", "--out", [recording])


def test_a_table_of_a_laboratorys_folder_is_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "accel.csv").write_text("t_s\n")
    with pytest.raises(ConfigError, match="the recording itself"):
        check_output(tmp_path / "accel.csv", "--json", [tmp_path])
    (tmp_path / "found.json").write_text("{}")
    check_output(tmp_path / "found.json", "--json", [tmp_path])


@pytest.mark.parametrize("command", [["replay", "--out"], ["report", "--out"]])
def test_replay_and_report_leave_their_recording_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: list[str]
) -> None:
    recording = tmp_path / "flight.mcap"
    recording.write_bytes(b"a flight")
    assert main([command[0], str(recording), command[1], str(recording)]) == 1
    assert "the recording itself" in capsys.readouterr().err
    assert recording.read_bytes() == b"a flight"


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

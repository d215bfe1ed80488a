"""Which setting wins: default, file, ground station, command line; and what is said of kept values."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from companion.cli.steps.options import add_settings, read_settings, state_file
from companion.params.persist import store


def read(arguments: list[str], parameters: Path | None) -> object:
    parser = argparse.ArgumentParser()
    add_settings(parser)
    options = parser.parse_args(arguments)
    options.parameters = parameters
    return read_settings(options)


def test_the_last_of_file_ground_station_and_command_line_wins(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved_file, file = tmp_path / "kept", tmp_path / "settings.toml"
    file.write_text("TRG_RATE = 5\nOUT_RATE = 5\nRNG_MAX = 50\n")
    store(saved_file, {"OUT_RATE": 6.0, "RNG_MAX": 60.0})
    settings = read(["--settings", str(file), "--set", "RNG_MAX=70"], saved_file)
    merged = (settings.trigger_rate_hz, settings.publish_rate_hz, settings.max_range_m)  # type: ignore[attr-defined]
    assert merged == (5.0, 6.0, 70.0)
    said = capsys.readouterr().err
    assert "OUT_RATE 6" in said
    assert str(saved_file) in said


def test_damage_is_said_and_does_not_stop_the_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    saved_file = tmp_path / "kept"
    saved_file.write_text("TRG_RATE = 1\n")
    settings = read([], saved_file)
    assert settings.trigger_rate_hz == 10.0  # type: ignore[attr-defined]
    assert "damaged" in capsys.readouterr().err


def test_state_lies_where_the_system_wants_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert state_file("x") == tmp_path / "spanwise" / "x"
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert state_file("x") == tmp_path / ".local" / "state" / "spanwise" / "x"

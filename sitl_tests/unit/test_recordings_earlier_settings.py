"""Recordings of earlier versions, with settings that are refused today: they are replayed as they were flown."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.cli.main import main
from companion.core.pipeline import start, step
from companion.errors import ConfigError
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Notice, ParameterChange, Reject, Rejected
from sitl_tests.unit.test_recordings_mcap import seconds_of_flight

AIRFRAME = load_airframe("nadir-2m")


def recorded(path: Path, settings: Settings, *changes: ParameterChange) -> Path:
    """Write three seconds of a recording with these settings."""
    writer = McapWriter(path, About.of(AIRFRAME, settings))
    for record in [*changes, *seconds_of_flight(3)]:
        writer.write(record)
    writer.close()
    return path


@pytest.mark.parametrize(
    ("name", "attribute", "value"),
    [("RNG_MATCHES", "min_matches", 500), ("TRG_RATE", "trigger_rate_hz", 0.5), ("SW_COMPID", "component_id", 1)],
)
def test_a_setting_that_is_refused_today_is_replayed_as_flown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, attribute: str, value: float
) -> None:
    settings = Settings().replace(name, value, flown=True)
    path = recorded(tmp_path / "old.mcap", settings)
    recording = McapRecording(path)
    assert getattr(recording.settings, attribute) == value
    (text,) = [notice.text for notice in recording.notices]
    assert text.startswith(f"old.mcap: {name} = {value:g} is outside ")
    assert text.endswith("replayed as flown")
    main(["replay", str(path), "--json"])
    assert json.loads(capsys.readouterr().out)["notices"] == [text]


@pytest.mark.parametrize(("name", "value"), [("RNG_MATCHES", 501), ("TRG_RATE", 0.4), ("RNG_MATCHES", 20.5)])
def test_a_setting_that_no_version_took_is_refused(name: str, value: float) -> None:
    with pytest.raises(ConfigError, match=name):
        Settings().replace(name, value, flown=True)


def test_what_an_earlier_version_took_cannot_be_set_today() -> None:
    with pytest.raises(ConfigError, match="RNG_MATCHES = 500 is outside 4 to 100"):
        Settings().replace("RNG_MATCHES", 500)


def test_a_recorded_change_is_used_as_flown() -> None:
    state = start(AIRFRAME, Settings())
    state, outputs = step(state, ParameterChange("RNG_MATCHES", 500.0, 5))
    assert state.settings.min_matches == 500
    assert outputs == []


@pytest.mark.parametrize(("name", "value"), [("RNG_MATCHES", 1e9), ("TRG_RATE", float("nan")), ("RNG_MATCHEZ", 12.0)])
def test_a_damaged_change_is_refused_in_a_sentence(name: str, value: float) -> None:
    """It raised, which cost a replay its estimation."""
    state = start(AIRFRAME, Settings())
    state, outputs = step(state, ParameterChange(name, value, 5))
    assert state.settings == Settings()
    refused, notice = outputs
    assert isinstance(refused, Rejected)
    assert refused.reason is Reject.INCONSISTENT
    assert isinstance(notice, Notice)
    assert name in notice.text


def test_a_setting_that_is_no_more_is_passed_over_in_recordings_alone() -> None:
    assert Settings().replace("RNG_ORIENT", 0.0, flown=True) == Settings()
    with pytest.raises(ConfigError, match="no parameter 'RNG_ORIENT'"):
        Settings().replace("RNG_ORIENT", 0.0)

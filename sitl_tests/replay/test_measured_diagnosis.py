"""Measured data (DROPBEAR's beam, mAEWing1's vibration test, PX4 logs): what `spanwise diagnose` must say of them.

The data are not in the repository: they are looked for in SPANWISE_DATA, or in ../shared beside it.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest

from companion.cli.main import main

DATA = Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[3] / "shared")) / "measured"


def diagnose(tmp_path: Path, *arguments: str) -> dict[str, Any]:
    json_path = tmp_path / "found.json"
    page = tmp_path / "page.html"
    code = main(["diagnose", *arguments, "--json", str(json_path), "--html", str(page)])
    assert code == (3 if json.loads(json_path.read_text())["verdict"] == "not-identifiable" else 0)
    text = page.read_text(encoding="utf-8")
    assert text.startswith("<!doctype html>")
    assert "http" not in text.replace("http-equiv", "")  # self-contained
    plain: dict[str, Any] = json.loads(json_path.read_text(encoding="utf-8"))
    return plain


def needed(name: str) -> str:
    if not (DATA / name).exists():
        pytest.skip(f"measured/{name} is not here (SPANWISE_DATA)")
    return str(DATA / name)


@pytest.mark.slow
def test_a_ground_vibration_test_says_that_run_order_and_sensor_position_are_confounded(tmp_path: Path) -> None:
    plain = diagnose(tmp_path, needed("maewing1-gvt"), "--mapping", "maewing1-gvt")
    assert plain["verdict"] == "not-identifiable"
    assert "changed between runs 5 and 10 (9.17 -> 9.48 Hz)" in plain["reason"]
    assert "not identifiable: run order and sensor position are confounded" in plain["reason"]
    assert plain["confounded"] == ["run_order", "sensor_position_m"]
    assert plain["causes"] == []
    assert any("sensor position of run 1 after run 10" in line for line in plain["advice"])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "gaps", "longest_ms"), [("sample.ulg", 8, 64.8), ("sample_log_small.ulg", 1, 161.3)])
def test_a_log_without_wing_sensors_gets_its_gaps_and_jitter_told_and_nothing_else(
    tmp_path: Path, name: str, gaps: int, longest_ms: float
) -> None:
    plain = diagnose(tmp_path, needed(f"px4-ulog/{name}"), "--airframe", "sitl-plane")
    assert plain["verdict"] == "not-identifiable"
    assert plain["causes"] == []
    (root,) = plain["timing"]
    assert root["station"] == "root"
    assert root["gaps"] == gaps
    assert root["longest_gap_ms"] == pytest.approx(longest_ms, abs=0.1)
    assert root["step_p99_ms"] >= root["step_p1_ms"] > 0.0
    assert any("dropout" in note for note in plain["notes"])


@pytest.mark.long
def test_a_beam_s_frequency_follows_the_roller_and_not_time(tmp_path: Path) -> None:
    folders = [needed(f"dropbear8/{name}") for name in ("slow10", "rand0")]
    plain = diagnose(tmp_path, *folders, "--mapping", "dropbear8")
    first, second = plain["causes"][:2]
    assert (first["name"], first["channel"]) == ("covariate-frequency", "roller_position_v")
    assert first["gain"]["share_of_signal"][1] < 0.25 < 0.7 < first["gain"]["share_of_signal"][0]
    assert "frequency-drift" not in [entry["name"] for entry in plain["causes"]]
    # a drift wins on likelihood and foretells little
    drift = next(entry for entry in plain["screening"] if entry["name"] == "frequency-drift")
    assert drift["log_odds"] > 100.0
    assert drift["gain"]["share_of_square_gone"] < 0.3
    assert first["gain"]["share_of_square_gone"] > 0.9
    # the close pair of the decays
    assert second["name"] == "close-mode"
    for decay_modes in plain["modes"]["in_the_last_decay"]:
        assert sorted(decay_modes["frequency_hz"]) == pytest.approx([24.2, 26.3], abs=0.15)
    # and what nobody has explained yet is said
    assert plain["verdict"] == "unexplained"
    assert "damping follows roller_position_v" in plain["residual"]["description"]
    assert plain["residual"]["failed"]


@pytest.mark.slow
def test_a_flutter_rig_s_limit_cycles_are_named_and_foretold(tmp_path: Path) -> None:
    plain = diagnose(tmp_path, needed("flutter-rig"), "--mapping", "flutter-rig")
    causes = {cause["name"]: cause for cause in plain["causes"]}
    assert {"cubic-stiffness", "limit-cycle", "quadratic-damping"} <= causes.keys()
    assert causes["cubic-stiffness"]["channel"] == "pitch_rad"
    assert causes["cubic-stiffness"]["parameters"]["pitch_rad: cubic"]["interval"][0] > 0.0  # it hardens
    assert len(plain["held_out_speeds"]) == 9
    for entry in plain["held_out_speeds"]:
        assert abs(entry["frequency_hz"]["relative_error"]) < 0.01
        assert all(abs(pair["relative_error"]) < 0.1 for pair in entry["amplitude"].values())
    assert plain["labels"] == []
    still = next(entry for entry in plain["decays"] if entry["airspeed_mps"] is None)
    assert still["stiffness"]["heave"]["frequency_at_rest_hz"] == pytest.approx(2.3, abs=0.1)  # its own w_h: 2.30 Hz


def test_hammer_blows_alone_tell_a_flutter_rig_s_onset(tmp_path: Path) -> None:
    files = sorted(map(str, Path(needed("flutter-rig")).glob("*Hammer.mat")))
    plain = diagnose(tmp_path, *files, "--mapping", "flutter-rig")
    low, high = plain["onset"]["airspeed_mps"]["interval"]
    assert 23.0 < low < high < 26.0

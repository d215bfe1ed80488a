"""``spanwise diagnose`` on folders that another hand simulated: nadir-2m, with noise that its file does not know."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.adapters.recordings.tables.number_table import read_table
from companion.cli.main import main
from companion.core.wing.effects import catalogue
from companion.diagnosis.flights.adequacy import check
from companion.diagnosis.flights.recordings import Flights
from companion.evaluation.flight_models import models_of
from companion.params.files import load_airframe
from companion.records import Floats
from tools.trial_generators import GENERATORS
from tools.trial_judge import model_of
from tools.trial_truths.stranger.folder import GRAVITY, Flight, write

AIRFRAME = Path(__file__).parents[2] / "config" / "airframes" / "nadir-2m.toml"


def diagnosed(folder: Path, flight: Flight, respoil: Callable[[Floats], Floats] | None = None) -> dict[str, Any]:
    write(folder, AIRFRAME, flight)
    if respoil is not None:
        header, *_ = (folder / "accel.csv").read_text(encoding="utf-8").partition("\n")
        rows = respoil(np.loadtxt(folder / "accel.csv", delimiter=",", skiprows=1))
        np.savetxt(folder / "accel.csv", rows, fmt="%.6f,%.5f,%.5f", header=header, comments="")
    assert main(["diagnose", str(folder), "--airframe", "nadir-2m", "--json", str(folder / "found.json")]) == 0
    text = (folder / "found.json").read_text(encoding="utf-8")

    def never(constant: str) -> float:
        raise AssertionError(f"{constant} is no JSON")

    diagnosis: dict[str, Any] = json.loads(text, parse_constant=never)
    return diagnosis


def names(diagnosis: dict[str, Any]) -> set[str]:
    return {name for cause in diagnosis["causes"] for name in (cause["name"], *cause["group"])}


def test_the_stranger_writes_gravity_down_and_ranges_that_read_short(tmp_path: Path) -> None:
    write(tmp_path, AIRFRAME, Flight(1, duration_s=8.0, rate_hz=400.0, decimals=4))
    tip = read_table(tmp_path / "accel.csv")["left_z_mps2"]
    assert abs(np.mean(tip) + GRAVITY) < 0.2
    # 14.9 mm of trim bend diverge the axes by 41 mrad: 1/Z' = 1/40 + 0.041/1.98
    inverse = np.mean(1.0 / read_table(tmp_path / "range.csv")["range_m"])
    assert inverse == pytest.approx(1.0 / 40.0 + 0.0414 / 1.98, rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize(
    "flight",
    [pytest.param(Flight(62), marks=pytest.mark.long), Flight(63, rate_hz=800.0, decimals=3)],
    ids=["1 kHz", "whole ms"],
)
def test_a_noisier_sensor_than_believed_is_no_fault(tmp_path: Path, flight: Flight) -> None:
    assert diagnosed(tmp_path, flight)["verdict"] == "adequate"


def wandering(rows: Floats) -> Floats:
    """Stamps that wander by the period of the samples, written to whole milliseconds: they repeat and go back."""
    rows[:, 0] = np.round(rows[:, 0] + 0.001 * np.random.default_rng(5).standard_normal(len(rows)), 3)
    return rows


def torn(rows: Floats) -> Floats:
    """Rows late and twice, 0.4 s missing of every 5 s and 2 s once: nothing that the samples could not tell."""
    rng = np.random.default_rng(6)
    rows = rows[(rows[:, 0] % 5.0 < 3.0) | (rows[:, 0] % 5.0 > 3.4)]
    rows = rows[(rows[:, 0] < 16.0) | (rows[:, 0] > 18.0)]
    rows = np.repeat(rows, np.where(rng.uniform(size=len(rows)) < 0.02, 2, 1), axis=0)
    return rows[np.argsort(np.arange(len(rows)) + 15.0 * rng.uniform(size=len(rows)))]


@pytest.mark.slow
def test_a_fuselage_that_recoils_is_no_fault() -> None:
    """The wing's own bending in the root sensor is neither a load nor a leak."""
    hand = GENERATORS["stranger"]
    label = hand.hide([], (8.0, 14.0), np.random.default_rng(1), 20.0)
    (tables,) = hand.fly([label], [20.0], 1, 30.0, [0.0])
    model = model_of(tables, hand.airframe(20.0, 0.0), hand.top_hz)
    flights = Flights([model], [catalogue()["rigid-body-leak"], catalogue()["load-dependent-bend"]])
    null = flights.null()
    assert all(entry.passed for entry in check([model], null))
    assert all(entry.z < 4.4 for entry in flights.screen(null, lambda _what, _ratio: None).candidates)


@pytest.mark.slow
def test_stamps_that_repeat_and_go_back_are_named_dropout_jitter(tmp_path: Path) -> None:
    diagnosis = diagnosed(tmp_path, Flight(62), wandering)
    assert diagnosis["verdict"] == "explained"
    assert names(diagnosis) == {"dropout-jitter"}
    assert diagnosis["causes"][0]["parameters"]["jitter_s"]["value"] == pytest.approx(0.001, rel=0.05)


@pytest.mark.long
def test_a_torn_recording_is_diagnosed_like_a_whole_one(tmp_path: Path) -> None:
    diagnosis = diagnosed(tmp_path, Flight(62), torn)
    assert diagnosis["verdict"] == "adequate"
    assert any("in 2 segments are judged" in note for note in diagnosis["notes"])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "flight", "truth"),
    [
        ("camera-asymmetry", {"camera_gain": (1.0, 1.25)}, {"ratio": 0.125, "both": 0.125}),
        ("mount-resonance", {"mount_hz": 16.0}, {"softness_s2": (2.0 * np.pi * 16.0) ** -2}),
        ("sensor-filter", {"sensor_corner_hz": 45.0}, {"lag_s": 2.0**0.5 / (2.0 * np.pi * 45.0)}),
    ],
)
def test_another_hand_s_form_of_an_effect_is_explained_by_its_name(
    tmp_path: Path, name: str, flight: dict[str, Any], truth: dict[str, float]
) -> None:
    """One camera alone; a mount with a damper; a Butterworth filter."""
    write(tmp_path, AIRFRAME, Flight(71, duration_s=40.0, rate_hz=400.0, decimals=5, **flight))
    models = models_of([tmp_path], load_airframe("nadir-2m"))
    flights = Flights(models, [catalogue()[name]])
    null = flights.null()
    assert any(abs(entry.z) > 5.0 for entry in check(models, null))
    (candidate,) = flights.screen(null, lambda _what, _ratio: None).candidates
    refitted = flights.refit(null, candidate)
    assert refitted is not None
    fitted = flights.fit(refitted[1].terms, refitted[1])
    assert all(entry.passed for entry in check(models, fitted))
    assert fitted.log_evidence > null.log_evidence + 50.0
    names = [entry.name for entry in fitted.terms[0].effect.parameters()]
    for parameter, value in truth.items():
        place = fitted.blocks[0][names.index(parameter)]
        # sigmas are of the model; of the sampled filter and the mount's loss 3 % are another hand's
        assert abs(fitted.values[place] - value) < 3.0 * fitted.spread[place] + 0.03 * abs(value)


@pytest.mark.long
def test_a_late_stream_is_named_with_its_delay(tmp_path: Path) -> None:
    diagnosis = diagnosed(tmp_path, Flight(12, right_late_s=0.004, rate_hz=400.0))
    assert diagnosis["verdict"] == "explained"
    assert "stream-delay" in names(diagnosis)
    low, high = diagnosis["causes"][0]["parameters"]["delay_s"]["interval"]
    # each stream's own offset is drawn with 0.2 ms
    assert low - 0.0006 < 0.004 < high + 0.0006


@pytest.mark.long
def test_what_was_applied_explains_the_same_recording(tmp_path: Path) -> None:
    write(tmp_path, AIRFRAME, Flight(77, right_scale=1.2, rate_hz=400.0))
    applied, again = tmp_path / "applied.toml", tmp_path / "again.json"
    assert main(["diagnose", str(tmp_path), "--airframe", "nadir-2m", "--apply", str(applied)]) == 0
    assert 'name = "accel-scale"' in applied.read_text(encoding="utf-8")
    assert main(["diagnose", str(tmp_path), "--airframe", str(applied), "--json", str(again)]) == 0
    assert json.loads(again.read_text(encoding="utf-8"))["verdict"] == "adequate"

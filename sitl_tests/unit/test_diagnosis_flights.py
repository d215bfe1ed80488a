"""Answers of `spanwise diagnose` on recordings that cannot tell, and of tables on the bench, by the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat
from scipy.signal import lfilter

from companion.adapters.recordings.tables.mapping import load_mapping
from companion.cli.main import main
from companion.diagnosis.data.observations import RawRecording, RawStream
from companion.evaluation.flight_models import models_of
from companion.params.files import load_airframe
from companion.records import Side


def diagnosis_of(tmp_path: Path, *arguments: str) -> dict[str, Any]:
    path = tmp_path / "found.json"
    code = main(["diagnose", *arguments, "--json", str(path), "--html", str(tmp_path / "page.html")])
    assert code == (3 if json.loads(path.read_text())["verdict"] == "not-identifiable" else 0)
    assert (tmp_path / "page.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    plain: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return plain


def accel(tmp_path: Path, place: str, t_s: np.ndarray) -> str:  # type: ignore[type-arg]
    rows = "".join(f"{t:.4f},-9.8\n" for t in t_s)
    (tmp_path / "accel.csv").write_text(f"t_s,{place}_z_mps2\n{rows}")
    return str(tmp_path)


def test_a_fuselage_alone_gets_its_gaps_told_and_no_cause(tmp_path: Path) -> None:
    t_s = np.arange(0.0, 12.0, 0.01)
    t_s = t_s[(t_s < 3.0) | (t_s > 3.2)]
    plain = diagnosis_of(tmp_path, accel(tmp_path, "root", t_s), "--airframe", "nadir-2m")
    assert plain["verdict"] == "not-identifiable"
    assert "no accelerometer on a wing" in plain["reason"]
    assert plain["causes"] == []
    (stream,) = plain["timing"]
    assert (stream["station"], stream["gaps"]) == ("root", 1)
    assert stream["longest_gap_ms"] == pytest.approx(220.0, abs=11.0)
    assert stream["longest_stretch_s"] == pytest.approx(8.8, abs=0.05)
    assert "left_z" in plain["advice"][0]


def test_a_rate_is_told_by_the_samples_of_a_time_and_not_by_the_usual_step(tmp_path: Path) -> None:
    """Steps of 2.5, 2.5 and 4 ms are 333 samples a second."""
    t_s = np.concatenate([[0.0], np.cumsum(np.tile([0.0025, 0.0025, 0.004], 1300))])
    plain = diagnosis_of(tmp_path, accel(tmp_path, "root", t_s), "--airframe", "nadir-2m")
    assert plain["timing"][0]["rate_hz"] == pytest.approx(333.3, abs=0.5)


def test_stamps_a_thousand_times_too_small_are_asked_for_their_unit(tmp_path: Path) -> None:
    """Seconds that the mapping takes for milliseconds."""
    rows = "".join(f"{0.005 * k:.3f},-1.0,-1.0\n" for k in range(12_000))
    (tmp_path / "wing.csv").write_text(f"time_ms,left_g,right_g\n{rows}")
    words = ["--mapping", "two-accelerometers", "--airframe", "nadir-2m"]
    plain = diagnosis_of(tmp_path, str(tmp_path / "wing.csv"), *words)
    assert plain["verdict"] == "not-identifiable"
    assert "it says 200000 Hz: are its stamps in another unit?" in plain["reason"]


def test_a_wing_without_eight_seconds_gets_that_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t_s = np.arange(0.0, 12.0, 0.01)
    t_s = t_s[(t_s < 5.0) | (t_s > 11.0)]
    applied = tmp_path / "applied.toml"
    table = accel(tmp_path, "left", t_s)
    plain = diagnosis_of(tmp_path, table, "--airframe", "nadir-2m", "--apply", str(applied))
    assert "no airframe was written" in capsys.readouterr().err
    assert not applied.exists()
    assert plain["verdict"] == "not-identifiable"
    assert "the longest stretch without a gap is 5.0 s" in plain["reason"]
    assert "at least 8 s in all" in plain["advice"][0]


@pytest.mark.slow
def test_a_vibration_test_is_judged_from_its_matlab_files(tmp_path: Path) -> None:
    rng = np.random.default_rng(8)
    names = np.array(["Force", "Tip"], dtype=object)
    for k, natural_hz in enumerate((9.0, 9.0, 9.4), start=1):
        # a damped swing of one degree of freedom, by its impulse response
        t_s = np.arange(6000) / 200.0
        omega, zeta = 2.0 * np.pi * natural_hz, 0.01
        impulse = np.exp(-zeta * omega * t_s) * np.sin(omega * t_s) / omega / 200.0
        force = rng.standard_normal(6000) * np.hanning(6000)
        force[-1500:] = 0.0
        swing = lfilter(impulse, 1.0, force)
        tip = np.gradient(np.gradient(swing, t_s), t_s) + 1e-3 * rng.standard_normal(6000)
        savemat(tmp_path / f"run{k}.mat", {"data": np.stack([force, tip], 1), "channels": names})
    (tmp_path / "bench.toml").write_text(
        'test = "vibration"\nfiles = "run*.mat"\nrate_hz = 200.0\nband_hz = [4.0, 20.0]\n'
        '[matlab]\narray = "data"\nnames = "channels"\n'
        '[columns]\n"Force" = { channel = "input_n", unit = "N" }\n'
        '"Tip" = { channel = "response_tip_mps2", unit = "mps2" }\n'
        + "".join(
            f'[[recordings]]\nfile = "run{k}.mat"\nvalues = {{ run_order = {k}, place_m = {0.1 * k} }}\n'
            for k in (1, 2, 3)
        )
    )
    plain = diagnosis_of(tmp_path, str(tmp_path), "--mapping", str(tmp_path / "bench.toml"))
    assert plain["verdict"] == "not-identifiable"
    assert "changed between runs 2 and 3 (9.00 -> 9.4" in plain["reason"]
    assert plain["confounded"] == ["run_order", "place_m"]


def test_a_table_without_what_its_test_needs_is_refused_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "one.csv").write_text("t,a\n0,1\n0.001,2\n")
    mapping = tmp_path / "ring.toml"
    columns = '[columns]\n"t" = { channel = "t_s" }\n"a" = { channel = "strain_v" }\n'
    mapping.write_text(f'test = "ringing"\n{columns}')
    assert main(["diagnose", str(tmp_path / "one.csv"), "--mapping", str(mapping)]) == 1
    assert "'band_hz' is missing" in capsys.readouterr().err
    mapping.write_text(f'test = "ringing"\nband_hz = [4.0, 20.0]\n{columns}')
    assert main(["diagnose", str(tmp_path / "one.csv"), "--mapping", str(mapping)]) == 1
    assert "the mapping gives no left_z_mps2 or right_z_mps2" in capsys.readouterr().err


def test_a_sensor_that_never_changes_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "one.csv").write_text("t,a\n" + "".join(f"{0.002 * k:.3f},-9.8\n" for k in range(2000)))
    (tmp_path / "ring.toml").write_text(
        'test = "ringing"\nband_hz = [4.0, 20.0]\n[belief]\nfrequency_hz = { value = 8.0, sigma = 1.0 }\n'
        "damping = { value = 0.02, sigma = 0.01 }\n"
        '[columns]\n"t" = { channel = "t_s" }\n"a" = { channel = "left_z_mps2", unit = "mps2" }\n'
    )
    assert main(["diagnose", str(tmp_path / "one.csv"), "--mapping", str(tmp_path / "ring.toml")]) == 1
    assert "left_z_mps2 never changes: check its sensor" in capsys.readouterr().err


def test_two_tips_of_the_same_samples_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    swing = -9.8 + np.random.default_rng(0).standard_normal(1200)
    rows = "".join(f"{0.01 * k:.2f},{value:.4f},{value:.4f}\n" for k, value in enumerate(swing))
    (tmp_path / "accel.csv").write_text(f"t_s,left_z_mps2,right_z_mps2\n{rows}")
    assert main(["diagnose", str(tmp_path), "--airframe", "nadir-2m"]) == 1
    assert "left_z and right_z are the same samples, those of one sensor" in capsys.readouterr().err


def test_a_laboratory_s_own_table_reaches_the_model_in_si(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    t_ms = np.arange(0.0, 10_000.0, 4.0)
    left, right = -1.0 + 0.01 * rng.standard_normal((2, t_ms.size))
    rows = [f"{t:.1f},{a:.6f},{b:.6f},{20 + 1e-4 * t:.3f}" for t, a, b in zip(t_ms, left, right, strict=True)]
    (tmp_path / "wing.csv").write_text("time_ms,left_g,right_g,airspeed_kt\n" + "\n".join(rows) + "\n")
    (model,) = models_of([tmp_path / "wing.csv"], load_airframe("nadir-2m"), load_mapping("two-accelerometers"))
    assert model.observations.sides == (Side.LEFT, Side.RIGHT)
    assert "airspeed_mps" in model.observations.covariates
    # 0.01 g rms of white noise over 125 Hz, of which the model's band keeps its share
    in_band_mps2 = 0.01 * 9.80665 * np.sqrt(0.5 * model.observations.rate_hz / 125.0)
    np.testing.assert_allclose(model.observations.up_mps2.std(0), in_band_mps2, rtol=0.1)


def test_a_channel_has_one_unit_in_recordings_that_are_judged_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Constant in each at 15 and 25 m/s: about 20 by 5; a recording that lacks it keeps the unit for the file."""
    rng = np.random.default_rng(6)
    t_s = np.arange(0.0, 12.0, 0.005)
    airspeeds = {"slow": 15.0, "fast": 25.0, "unrecorded": None}

    def raw(path: Path, *_: object) -> RawRecording:
        tips = {side: RawStream(t_s, -9.8 + 0.1 * rng.standard_normal(len(t_s))) for side in Side}
        speed = airspeeds[path.name]
        return RawRecording(tips, None, None, {} if speed is None else {"tas_mps": (t_s, np.full(len(t_s), speed))})

    monkeypatch.setattr("companion.evaluation.flight_models.load", raw)
    models = models_of([Path(name) for name in ("unrecorded", "slow", "fast")], load_airframe("nadir-2m"))
    for model, expected in zip(models[1:], (-1.0, 1.0), strict=True):
        np.testing.assert_allclose(model.observations.covariates["tas_mps"], expected)
    assert not models[0].observations.covariates
    assert [model.observations.units for model in models] == [{"tas_mps": pytest.approx((20.0, 5.0))}] * 3

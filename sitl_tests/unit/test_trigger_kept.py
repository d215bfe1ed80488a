"""Latency that one flight has learned is the next one's belief, on the same path and on no other."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from companion.cli import run
from companion.core.trigger.latency import LatencyModel
from companion.errors import ConfigError
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.learned import keep_latency, load_latency, with_latency
from companion.records import Shot, Side, TriggerLatency

MS = 1_000_000
TRUE_S = (0.0213, 0.0197)  # command to start of exposure: far from the airframe's 8 +- 2 ms
JITTER_S = 0.0004


@pytest.fixture
def airframe() -> Airframe:
    return load_airframe("nadir-2m")


def _flown(airframe: Airframe, shots: int, seed: int = 1) -> LatencyModel:
    model, random = LatencyModel(airframe), np.random.default_rng(seed)
    for plan in range(shots):
        fired_ns = (plan + 1) * 100 * MS
        model.shot(Shot(plan, fired_ns, fired_ns))
        for side in Side:
            middle_s = TRUE_S[side] + 0.001 + JITTER_S * random.standard_normal()
            model.exposure(side, plan, fired_ns + round(middle_s * 1e9))
    return model


def test_the_next_flight_begins_with_what_this_one_learned(tmp_path: Path, airframe: Airframe) -> None:
    file = tmp_path / "state" / "nadir.latency"
    learned = _flown(airframe, 60).learned(7 * MS)
    assert learned is not None
    assert keep_latency(file, "gpio:/dev/gpiochip0,4 oak:CAM_B,CAM_C", learned)
    again = with_latency(airframe, load_latency(file), "gpio:/dev/gpiochip0,4 oak:CAM_B,CAM_C")
    before, after = LatencyModel(airframe), LatencyModel(again)
    for side in Side:
        middle_ns = (TRUE_S[side] + 0.001) * 1e9
        assert abs(after.estimate(side).bias_ns - middle_ns) < 4 * JITTER_S / np.sqrt(60) * 1e9 + 1000
        assert abs(before.estimate(side).bias_ns - middle_ns) > 10 * MS
        # the spread is what single shots scatter by, neither the first prior's 2 ms nor the mean's own sigma
        assert after.sigmas_ns()[side] == pytest.approx(JITTER_S * 1e9, rel=0.5)


def test_what_is_kept_is_exact(tmp_path: Path) -> None:
    file = tmp_path / "a.latency"
    learned = TriggerLatency(1, np.array([0.1 + 0.2, 1 / 3]), np.array([1e-5, 2 / 7 * 1e-3]), 31)
    keep_latency(file, 'serial:"odd\\name"', learned)
    saved = load_latency(file)
    assert saved is not None
    assert saved.path == 'serial:"odd\\name"'
    assert [latency.value for latency in saved.latency_s] == learned.latency_s.tolist()
    assert [latency.sigma for latency in saved.latency_s] == learned.sigma_s.tolist()
    assert saved.shots == 31


def test_another_path_or_too_few_shots_change_nothing(tmp_path: Path, airframe: Airframe) -> None:
    file = tmp_path / "a.latency"
    few = _flown(airframe, 6).learned(1)
    assert few is not None
    assert not keep_latency(file, "mavlink", few)
    assert load_latency(file) is None
    assert LatencyModel(airframe).learned(1) is None
    many = _flown(airframe, 20).learned(1)
    assert many is not None
    keep_latency(file, "mavlink", many)
    assert with_latency(airframe, load_latency(file), "gpio:/dev/gpiochip0,4") is airframe
    blind = dataclasses.replace(airframe, left_camera=None, right_camera=None)
    assert with_latency(blind, load_latency(file), "mavlink") is blind


_NEGATIVE = """path = "a"
shots = 9
left_s = { value = -1.0, sigma = 1e-4 }
right_s = { value = 0.01, sigma = 1e-4 }
"""


@pytest.mark.parametrize("text", ["", "path = 3", "rubbish", _NEGATIVE])
def test_a_damaged_file_is_named_and_not_guessed(tmp_path: Path, text: str) -> None:
    file = tmp_path / "a.latency"
    file.write_text(text)
    with pytest.raises(ConfigError, match=r"a\.latency"):
        load_latency(file)


def test_run_restores_it_and_says_so(tmp_path: Path, airframe: Airframe, capsys: pytest.CaptureFixture[str]) -> None:
    parser = argparse.ArgumentParser()
    run.add_arguments(parser)
    words = [
        "--connect",
        "udpin:127.0.0.1:0",
        "--airframe",
        "nadir-2m",
        "--parameters",
        str(tmp_path / "kept.parameters"),
    ]
    keeper = run.LatencyKeeper(tmp_path / "kept.latency", "mavlink")
    learned = _flown(airframe, 40).learned(3)
    assert learned is not None
    keeper.take(learned)
    keeper.keep()
    restored = run.service_config(parser.parse_args([*words, "--trigger", "mavlink"])).airframe
    assert restored.left_camera is not None
    assert restored.left_camera.latency_s.value == pytest.approx(TRUE_S[0], abs=3e-4)
    assert "40 shots" in capsys.readouterr().err
    other = run.service_config(parser.parse_args(words)).airframe
    assert other == airframe
    (tmp_path / "kept.latency").write_text("half a li")
    assert run.service_config(parser.parse_args([*words, "--trigger", "mavlink"])).airframe == airframe
    assert "kept.latency: not a latency" in capsys.readouterr().err

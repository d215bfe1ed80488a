"""Flights of ``spanwise simulate``, manoeuvres and all, as ``spanwise diagnose`` understands them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from companion.cli.main import main


def diagnosed(folder: Path, *options: str) -> dict[str, Any]:
    assert main(["simulate", "--out", str(folder), *options]) == 0
    assert main(["diagnose", str(folder), "--airframe", "nadir-2m", "--json", str(folder / "found.json")]) == 0
    diagnosis: dict[str, Any] = json.loads((folder / "found.json").read_text(encoding="utf-8"))
    return diagnosis


@pytest.mark.long
@pytest.mark.parametrize("seed", ["101", pytest.param("105", marks=pytest.mark.long)])
def test_a_flight_with_nothing_hidden_is_adequate(tmp_path: Path, seed: str) -> None:
    assert diagnosed(tmp_path, "--seed", seed, "--duration", "40")["verdict"] == "adequate"


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "parameter", "value"), [("accel-scale", "left", 0.05), ("clock-skew", "skew_s_per_min", 0.005)]
)
def test_an_effect_that_reaches_into_the_rigid_motion_is_named(
    tmp_path: Path, name: str, parameter: str, value: float
) -> None:
    diagnosis = diagnosed(tmp_path, "--seed", "204", "--effect", f"{name}={value}")
    assert diagnosis["verdict"] == "explained"
    assert diagnosis["causes"][0]["name"] == name
    low, high = diagnosis["causes"][0]["parameters"][parameter]["interval"]
    assert low - 0.2 * value < value < high + 0.2 * value

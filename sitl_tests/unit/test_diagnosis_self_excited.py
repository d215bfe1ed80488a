"""A vibration of constant amplitude without an airspeed: limit cycle or response to a periodic force."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from companion.diagnosis.limit_cycles.json_report import as_json
from companion.diagnosis.limit_cycles.recordings import diagnose_vibration
from companion.diagnosis.limit_cycles.tracks import RawVibration, track
from companion.evaluation.pages.flutter_page import flutter_page
from companion.records import Floats

T_S = np.arange(7500) / 250.0
OMEGA = 2.0 * np.pi * 2.5


def judged(level: Floats, seed: int, forces: Mapping[str, Floats] | None = None) -> dict[str, Any]:
    """One recording of a vibration with the amplitudes ``level`` (n,), and 0.2 % noise."""
    shown = level * np.sin(OMEGA * T_S) + 2e-3 * np.random.default_rng(seed).standard_normal(len(T_S))
    raw = RawVibration("run", T_S, {"heave": shown}, None, forces or {})
    return as_json(diagnose_vibration([track(raw, (1.5, 4.5))], 5, lambda _what, _ratio: None))


@pytest.mark.parametrize("seed", range(5))
def test_a_cycle_without_an_airspeed_is_no_linear_wing(seed: int) -> None:
    """One frequency and damping ratio were adequate. Without the force both origins stand in the reason."""
    plain = judged(np.ones_like(T_S), seed)
    assert plain["verdict"] == "unexplained"
    assert plain["nearest"] == "limit-cycle"
    assert plain["causes"] == []
    assert "a self-excited vibration (limit cycle), or the response to a periodic force" in plain["reason"]
    assert any("the force as input_<what>" in line for line in plain["advice"])


@pytest.mark.parametrize("line_hz", [None, 2.8])
def test_a_measured_force_without_its_line_leaves_the_limit_cycle(line_hz: float | None) -> None:
    noise = np.random.default_rng(7).standard_normal(len(T_S))
    force = noise if line_hz is None else np.sin(2.0 * np.pi * line_hz * T_S)
    plain = judged(np.ones_like(T_S), 1, {"input_n": force})
    assert plain["verdict"] == "unexplained"
    assert "a self-excited vibration (limit cycle);" in plain["reason"]
    assert "periodic force" not in plain["reason"]


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_measured_force_in_step_names_both(noise: float) -> None:
    force = np.cos(OMEGA * T_S) + noise * np.random.default_rng(8).standard_normal(len(T_S))
    plain = judged(np.ones_like(T_S), 1, {"input_n": force})
    assert plain["verdict"] == "unexplained"
    assert "in step with a line of input_n: the response of a linear wing to that force, or a limit" in plain["reason"]
    assert any("with the force off" in line for line in plain["advice"])


@pytest.mark.parametrize("zeta", [1e-4, 2e-4, 4e-4, 0.01])
def test_a_slow_linear_decay_stays_adequate(zeta: float) -> None:
    """Twenty periods of such a small damping change by less than 6 %, as those of a limit cycle."""
    plain = judged(np.exp(-zeta * OMEGA * T_S), 2)
    assert plain["verdict"] == "adequate", plain["reason"]


@pytest.mark.parametrize("zeta", [0.005, 0.01, 0.02])
def test_a_periodic_force_that_is_switched_on_is_no_damping_of_the_wing(zeta: float) -> None:
    """Its rise had the verdict explained, by a damping that follows the amplitude."""
    plain = judged(1.0 - np.exp(-zeta * OMEGA * T_S), 1)
    assert plain["verdict"] == "unexplained"
    assert "begins to rise at a constant rate, as the response to a periodic force" in plain["reason"]
    assert any("the force as input_<what>" in line for line in plain["advice"])


@pytest.mark.parametrize("growth", [0.3, 0.6])
def test_a_growth_up_to_a_cycle_is_explained(growth: float) -> None:
    """A' = g A (1 - A^2), solved for A from a twentieth of the cycle on."""
    plain = judged(1.0 / np.sqrt(1.0 + 399.0 * np.exp(-2.0 * growth * T_S)), 3)
    assert plain["verdict"] == "explained", plain["reason"]
    assert [cause["name"] for cause in plain["causes"]] == ["quadratic-damping"]


def test_the_page_says_what_to_record() -> None:
    """The terminal and the JSON said so alone."""
    shown = np.sin(OMEGA * T_S) + 2e-3 * np.random.default_rng(1).standard_normal(len(T_S))
    raw = RawVibration("run", T_S, {"heave": shown}, None)
    diagnosis = diagnose_vibration([track(raw, (1.5, 4.5))], 5, lambda _what, _ratio: None)
    plain = as_json(diagnosis)
    page = flutter_page(diagnosis, plain, "rig")
    assert plain["advice"]
    assert all(f"Record: {line}." in page.replace("&lt;", "<").replace("&gt;", ">") for line in plain["advice"])

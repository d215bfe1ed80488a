"""Limit cycles at one frequency whose amplitude follows the airspeed, in closed form: no linear wing has them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from companion.diagnosis.limit_cycles.json_report import as_json
from companion.diagnosis.limit_cycles.recordings import diagnose_vibration
from companion.diagnosis.limit_cycles.tracks import RawVibration, track

RATE_HZ, SECONDS, F_HZ, ONSET_MPS = 250.0, 30.0, 2.5, 17.0
GROWTH, SQUARE = 0.06, 0.01  # 1/s and square of the amplitude, per m/s above the onset
BELOW_MPS = (14.0, 15.0, 16.0, 17.5)


def swing(speed_mps: float, start: float, noise: float, seed: int) -> RawVibration:
    """A' = g A (1 - A^2/A_c^2) with A_c^2 = SQUARE (V - ONSET), g = GROWTH (V - ONSET), solved for A^2."""
    t_s, above = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ, speed_mps - ONSET_MPS
    fades = np.exp(-2.0 * GROWTH * above * t_s)
    a = np.sqrt(1.0 / (fades / start**2 + (1.0 - fades) / (SQUARE * above)))
    shown = a * np.sin(2.0 * np.pi * F_HZ * t_s) + noise * np.random.default_rng(seed).standard_normal(len(t_s))
    return RawVibration(f"run{seed}", t_s, {"heave": shown}, speed_mps)


def judged(cycles: int, below_mps: tuple[float, ...], noise: float, equal: bool = False) -> dict[str, Any]:
    raw = [swing(v, np.sqrt(SQUARE * (v - ONSET_MPS)), noise, k) for k, v in enumerate(np.linspace(18.0, 24.0, cycles))]
    if equal:
        raw = [RawVibration(entry.name, entry.t_s, raw[0].responses, entry.airspeed_mps) for entry in raw]
    raw += [swing(v, 0.02, 0.1 * noise, 20 + k) for k, v in enumerate(below_mps)]
    tracks = [track(entry, (1.5, 4.5)) for entry in raw]
    return as_json(diagnose_vibration(tracks, 5, lambda _what, _ratio: None))


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("below_mps", [(), BELOW_MPS])
@pytest.mark.parametrize("cycles", [4, 6, 8])
def test_a_cycle_whose_amplitude_alone_follows_the_airspeed_is_named(
    cycles: int, below_mps: tuple[float, ...], noise: float
) -> None:
    """The columns of its constant frequency cost more evidence than those of the amplitude gained."""
    plain = judged(cycles, below_mps, noise)
    cause = next(cause for cause in plain["causes"] if cause["name"] == "limit-cycle")
    slope = cause["parameters"]["square of the cycle's amplitude: heave: slope"]
    speeds = np.linspace(18.0, 24.0, cycles)
    assert slope["value"] == pytest.approx(speeds.std() / (24.0 - ONSET_MPS), rel=0.03)
    assert not any("frequency" in key for key in cause["parameters"])
    assert "damping follows amplitude and airspeed" in plain["reason"]
    assert len(plain["held_out_speeds"]) == cycles
    for entry in plain["held_out_speeds"]:
        assert abs(entry["amplitude"]["heave"]["relative_error"]) < 0.05


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("below_mps", [(), BELOW_MPS])
@pytest.mark.parametrize("cycles", [2, 3])
def test_too_few_cycles_for_a_law_are_no_linear_wing(cycles: int, below_mps: tuple[float, ...], noise: float) -> None:
    """Growth up to a cycle tells the law of the damping; without it nothing does."""
    plain = judged(cycles, below_mps, noise)
    assert plain["verdict"] == ("explained" if below_mps else "unexplained")
    assert "damping follows the amplitude" in plain["reason"]
    if not below_mps:
        assert plain["nearest"] == "limit-cycle"
        assert "record cycles at 4 airspeeds or more" in plain["reason"]


def test_cycles_of_equal_amplitude_are_no_linear_wing() -> None:
    """They had the verdict adequate; at three airspeeds a periodic force is as likely as a limit cycle."""
    plain = judged(3, (), 1e-3, equal=True)
    assert plain["verdict"] == "unexplained"
    assert "(limit cycle), or the response to a periodic force" in plain["reason"]

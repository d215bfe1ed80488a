"""One rule of clipping, and one of wild samples, for forced oscillators and limit cycles."""

from __future__ import annotations

import numpy as np
import pytest

from companion.diagnosis.channel_defects import is_clipped, wild_samples
from companion.diagnosis.forced.even_recording import evenly
from companion.diagnosis.limit_cycles.tracks import RawVibration, track
from companion.errors import RecordingError
from companion.records import Floats

RATE_HZ, TONE_HZ = 250.0, 15.0 / (2.0 * np.pi)  # no whole number of samples a period
T_S = np.arange(7500) / RATE_HZ
TONE: Floats = np.sin(2.0 * np.pi * TONE_HZ * T_S)


def held() -> Floats:
    """A static deflection of 2 s that is released, in steps of a hundredth."""
    since = np.maximum(T_S - 2.0, 0.0)
    return np.round(np.exp(-0.1 * since) * np.cos(2.0 * np.pi * TONE_HZ * since), 2)


CASES = {
    "tone": (TONE, False),
    "coarse tone": (np.round(TONE / 0.02) * 0.02, False),
    "held before its release": (held(), False),
    "clipped from above": (np.minimum(TONE, 0.8), True),
    "clipped from below": (np.maximum(TONE, -0.8), True),
    "coarse tone, clipped": (np.minimum(np.round(TONE / 0.02) * 0.02, 0.8), True),
}


@pytest.mark.parametrize("name", CASES)
def test_both_kinds_of_recording_judge_clipping_alike(name: str) -> None:
    """A coarse tone and a held deflection were noted as clipped in a forced oscillator, and not in a limit cycle."""
    values, clipped = CASES[name]
    assert is_clipped(values) == clipped
    assert any("clipped" in note for note in evenly("run", T_S, TONE, values, 10.0).notes) == clipped
    raw = RawVibration("run", T_S, {"heave": values}, None)
    if clipped:
        with pytest.raises(RecordingError, match="run: heave piles up at its largest or smallest value"):
            track(raw, (1.5, 4.5))
    else:
        assert np.median(track(raw, (1.5, 4.5)).frequency_hz) == pytest.approx(TONE_HZ, rel=0.01)


@pytest.mark.parametrize("samples_per_period", [6, 20])
def test_a_limit_cycle_after_a_long_calm_is_not_wild(samples_per_period: int) -> None:
    """Its peaks were wild by the median step of all samples: it was 2.5 % too small, or was no limit cycle."""
    frequency_hz = 1.003 * RATE_HZ / samples_per_period
    t_s = np.arange(400 * samples_per_period) / RATE_HZ
    grown: Floats = np.clip((t_s - 0.7 * t_s[-1]) * frequency_hz / 10.0, 0.0, 1.0)  # in ten periods
    noise = 1e-4 * np.random.default_rng(1).standard_normal(len(t_s))
    values = grown * np.sin(2.0 * np.pi * frequency_hz * t_s) + noise
    values[50] += 5.0
    assert np.flatnonzero(wild_samples(values)).tolist() == [50]
    followed = track(RawVibration("run", t_s, {"heave": values}, None), (0.7 * frequency_hz, 1.3 * frequency_hz))
    assert np.median(followed.amplitude["heave"][followed.steady]) == pytest.approx(1.0, rel=0.002)


def test_pulses_of_a_random_binary_force_are_not_wild() -> None:
    """A quarter of its samples were left out of the force, and a mass came out 29 % too small."""
    force = np.repeat(np.random.default_rng(2).choice([-1.0, 1.0], 1500), 2)
    t_s = np.arange(len(force)) / RATE_HZ
    even = evenly("run", t_s, force, np.sin(t_s), 100.0)
    assert not even.notes
    np.testing.assert_allclose(even.force, force, atol=1e-9)

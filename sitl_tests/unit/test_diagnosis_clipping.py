"""One rule of clipping for forced oscillators and limit cycles."""

from __future__ import annotations

import numpy as np
import pytest

from companion.diagnosis.clipping import is_clipped
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
    assert any("clipped" in note for note in evenly("run", T_S, TONE, values).notes) == clipped
    raw = RawVibration("run", T_S, {"heave": values}, None)
    if clipped:
        with pytest.raises(RecordingError, match="run: heave piles up at its largest or smallest value"):
            track(raw, (1.5, 4.5))
    else:
        assert np.median(track(raw, (1.5, 4.5)).frequency_hz) == pytest.approx(TONE_HZ, rel=0.01)

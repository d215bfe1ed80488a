"""A strong cubic spring whose harmonics lie beyond half the rate: noted there, and not at twice the rate."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from companion.diagnosis.forced.equation_rows import ForcedRecording
from companion.diagnosis.forced.json_report import as_json
from companion.diagnosis.forced.recordings import diagnose_forced
from companion.records import Floats
from sitl_tests.unit.forced_oscillator import deflection

RATE_HZ, COUNT, SUBSTEPS = 400.0, 16000, 4
REST_HZ, ZETA, DRIVEN_HZ, BAND_HZ = 20.0, 0.02, (5.0, 40.0), (5.0, 45.0)
CUBIC = 0.1  # of a unit stiffness: at the rms deflection its force is 0.7 of the linear one
NOISE = 0.05  # of the response's rms


@pytest.fixture(scope="module")
def motion() -> tuple[Floats, Floats]:
    """Force and deflection, (n,) each, at the higher rate: unit stiffness, Runge and Kutta."""
    f_hz = np.fft.rfftfreq(COUNT, 1.0 / RATE_HZ)
    spectrum = np.fft.rfft(np.random.default_rng(1).standard_normal(COUNT))
    spectrum[(f_hz < DRIVEN_HZ[0]) | (f_hz > DRIVEN_HZ[1])] = 0.0
    spectrum /= np.fft.irfft(spectrum, COUNT).std()
    halves = 2 * SUBSTEPS
    fine = np.fft.irfft(spectrum, halves * COUNT) * halves
    shown = deflection(fine, 1.0 / (RATE_HZ * SUBSTEPS), SUBSTEPS, REST_HZ, ZETA, CUBIC)
    return np.fft.irfft(spectrum, COUNT), shown


def judged(motion: tuple[Floats, Floats], every: int) -> dict[str, Any]:
    force, q = (values[::every] for values in motion)
    noisy = q + NOISE * q.std() * np.random.default_rng(2).standard_normal(len(q))
    entry = ForcedRecording("run", np.arange(len(q)) * every / RATE_HZ, force, noisy)
    return as_json(diagnose_forced([entry], BAND_HZ, 3, lambda _what, _ratio: None))


@pytest.mark.slow
@pytest.mark.parametrize("every", [1, 2, 4])
def test_an_interval_holds_the_truth_and_a_note_says_to_record_faster(
    motion: tuple[Floats, Floats], every: int
) -> None:
    """Harmonics of 30 to 40 Hz lie about 100 Hz: half of 200 Hz folds them back, half of 400 Hz holds them.

    At 200 and 100 Hz the cubic was 6 and 14 sigma off, because what folds back was taken for motion.
    """
    plain = judged(motion, every)
    cubic = next(cause for cause in plain["causes"] if cause["name"] == "cubic-stiffness")["parameters"]["coefficient"]
    off = abs(cubic["value"] - CUBIC) / cubic["sigma"]
    noted = any("beyond half the rate" in note and "record at twice the rate" in note for note in plain["notes"])
    assert noted == (every > 1)
    assert off < 3.0

"""A forced oscillator at levels that grow, of recordings that are noisy to different degrees, and with no named law."""

from __future__ import annotations

import numpy as np
import pytest

from companion.diagnosis.forced.equation_rows import ForcedRecording
from companion.diagnosis.forced.recordings import ForcedDiagnosis, diagnose_forced
from companion.diagnosis.selection.check import DiagnosisVerdict
from sitl_tests.unit.forced_oscillator import deflection

RATE_HZ, COUNT, FINER = 500.0, 8000, 8
BAND_HZ = (3.0, 140.0)
REST_HZ, ZETA, LEVEL = 40.0, 0.04, 0.4


def _driven(seed: int, *, cubic: float = 0.0, gap: float = 0.0, noise: float, grows: bool = False) -> ForcedRecording:
    """White force in 5 to 120 Hz, of a level that grows from a tenth to all of it where it says so."""
    rng = np.random.default_rng(seed)
    f_hz = np.fft.rfftfreq(COUNT, 1.0 / RATE_HZ)
    spectrum = np.where((f_hz > 5.0) & (f_hz < 120.0), np.fft.rfft(rng.standard_normal(COUNT)), 0.0)
    finer = 2 * FINER
    fine = np.fft.irfft(spectrum, COUNT * finer) * finer
    if grows:
        fine *= np.linspace(0.1, 1.0, len(fine))
    fine *= LEVEL / fine.std()
    answer = deflection(fine, 1.0 / (RATE_HZ * FINER), FINER, REST_HZ, ZETA, cubic, gap=gap)
    answer = answer + noise * answer.std() * rng.standard_normal(COUNT)
    return ForcedRecording(f"run{seed}", np.arange(COUNT) / RATE_HZ, fine[::finer].copy(), answer)


def _judged(*recordings: ForcedRecording) -> ForcedDiagnosis:
    return diagnose_forced(recordings, BAND_HZ, 3, lambda _what, _ratio: None)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_cube_under_a_force_that_grows_is_explained(seed: int) -> None:
    """The law's slopes, by which noise of the response enters, are large at the end alone."""
    judged = _judged(_driven(seed, cubic=0.5, noise=0.01, grows=True))
    assert judged.outcome.verdict is DiagnosisVerdict.EXPLAINED
    (cause,) = judged.outcome.causes
    value, sigma = judged.coefficient(cause)
    assert cause.term.name == "cubic-stiffness"
    assert abs(value - 0.5) < 4.0 * sigma


@pytest.mark.slow
@pytest.mark.parametrize(("cubic", "names"), [(0.0, []), (0.5, ["cubic-stiffness"])])
def test_recordings_may_be_noisy_to_different_degrees(cubic: float, names: list[str]) -> None:
    judged = _judged(_driven(3, cubic=cubic, noise=0.005), _driven(4, cubic=cubic, noise=0.05))
    assert [cause.term.name for cause in judged.outcome.causes] == names
    assert judged.outcome.verdict is not DiagnosisVerdict.UNEXPLAINED


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.005, 0.05])
def test_a_gap_is_no_cubic_spring(noise: float) -> None:
    judged = _judged(_driven(5, gap=0.15, noise=noise))
    assert judged.outcome.verdict is DiagnosisVerdict.UNEXPLAINED
    stated = judged.outcome.reason
    assert "explains more" in stated or "outliers" in stated

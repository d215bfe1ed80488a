"""A steady tone: found with honest sigma through the source's low-pass, and not found where there is none."""

from __future__ import annotations

import dataclasses
import tracemalloc

import numpy as np
import pytest

from companion.core.tracking.tone import ToneEstimate, ToneTracker
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, ImuBatch, Reject, Station

SENSOR = load_airframe("sitl-plane").left
EPOCH_NS = 3_000_000_000


def _listen(z: np.ndarray, t: np.ndarray, lowpass_hz: float = 20.0) -> ToneTracker:
    tracker = ToneTracker(Station.LEFT, dataclasses.replace(SENSOR, lowpass_accel_hz=lowpass_hz), (5.8, 8.8))
    values = np.zeros((len(t), 6))
    values[:, 2] = z
    stamps = EPOCH_NS + np.round(t * 1e9).astype(np.int64)
    tracker.add(ImuBatch(Station.LEFT, ClockName.HOST, stamps, values, Axis.Z, int(stamps[-1])))
    return tracker


def _noise(n: int, seed: int, sigma: float) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, sigma, n)


@pytest.mark.parametrize("lowpass_hz", [0.0, 20.0, 100.0])
def test_frequency_amplitude_and_phase_ahead_of_the_low_pass(lowpass_hz: float) -> None:
    t = np.cumsum(np.random.default_rng(4).uniform(0.001, 0.005, 1500))
    frequency, amplitude, phase = 7.306, 4.0, 0.7
    s = 1j * frequency / lowpass_hz if lowpass_hz else 0.0
    response = 1 / (1 + np.sqrt(2) * s + s * s)
    z = -9.8 + amplitude * np.real(response * np.exp(1j * (2 * np.pi * frequency * t + phase)))
    tracker = _listen(z + _noise(len(t), 1, 0.3), t, lowpass_hz)
    for at_s in (2.0, 3.1, float(t[-1])):
        tone = tracker.estimate(EPOCH_NS + round(at_s * 1e9))
        assert isinstance(tone, ToneEstimate)
        assert tone.frequency_hz == pytest.approx(frequency, abs=4 * tone.frequency_sigma_hz)
        assert tone.frequency_sigma_hz < 0.01
        assert tone.amplitude_mps2 == pytest.approx(amplitude, abs=4 * tone.amplitude_sigma_mps2)
        error = np.angle(np.exp(1j * (tone.phase_rad - (2 * np.pi * frequency * at_s + phase))))
        assert abs(error) < 4 * tone.phase_sigma_rad
        assert tone.phase_sigma_rad < np.radians(1.5)


def test_the_sigma_is_that_of_the_errors() -> None:
    t = np.arange(1400) / 333.0
    pulls = []
    for seed in range(60):
        tone = _listen(np.cos(2 * np.pi * 7.3 * t) + _noise(len(t), seed, 0.4), t, 0.0).estimate(
            EPOCH_NS + 2_100_000_000
        )
        assert isinstance(tone, ToneEstimate)
        error = np.angle(np.exp(1j * (tone.phase_rad - 2 * np.pi * 7.3 * 2.1)))
        pulls.append(error / tone.phase_sigma_rad)
    assert (
        0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.4
    )  # 60 draws: 1 +- 0.09 each way, with room for the noise estimate


def test_noise_turbulence_and_silence_hold_no_tone() -> None:
    t = np.arange(1400) / 333.0
    moments_beside_gyro = np.zeros(len(t))
    for k, kick in enumerate(_noise(len(t), 3, 1.0)[1:], 1):  # gusts through a pole at 3 Hz
        moments_beside_gyro[k] = moments_beside_gyro[k - 1] * np.exp(-2 * np.pi * 3 / 333.0) + kick
    for z in (_noise(len(t), 2, 0.05), moments_beside_gyro, np.zeros(len(t))):
        assert _listen(z - 9.8, t).estimate(EPOCH_NS + 2_100_000_000) is Reject.NO_MODE


def test_a_short_or_a_far_window_is_refused() -> None:
    t = np.arange(1400) / 333.0
    z = np.cos(2 * np.pi * 7.3 * t)
    assert _listen(z[:400], t[:400]).estimate(EPOCH_NS + 500_000_000) is Reject.NOT_SETTLED
    assert _listen(z, t).estimate(EPOCH_NS + 30_000_000_000) is Reject.OUT_OF_WINDOW
    assert ToneTracker(Station.LEFT, SENSOR, (5.8, 8.8)).estimate(EPOCH_NS) is Reject.NOT_SETTLED


def test_a_sensor_that_sends_the_same_value_for_ever_holds_no_tone() -> None:
    t = np.arange(1400) / 333.0
    assert _listen(np.zeros(len(t)), t).estimate(EPOCH_NS + 2_100_000_000) is Reject.NO_MODE


def test_a_wide_search_starts_where_the_spectrum_is_largest_and_takes_little_memory() -> None:
    """Stamps that wander, between 2 and 200 Hz at 1 kHz: a table of all exponentials would take 200 MB."""
    rng = np.random.default_rng(5)
    t = np.sort(np.arange(4000) / 1000.0 + rng.uniform(-4e-4, 4e-4, 4000)) - 2.0
    z = np.cos(2 * np.pi * 131.3 * t) + 0.8 * np.cos(2 * np.pi * 9.1 * t) + rng.standard_normal(len(t))
    tracemalloc.start()
    line = ToneTracker(Station.LEFT, SENSOR, (2.0, 200.0))._line(t, z)
    assert tracemalloc.get_traced_memory()[1] < 2e7
    tracemalloc.stop()
    assert line.frequency_hz == pytest.approx(131.3, abs=0.01)

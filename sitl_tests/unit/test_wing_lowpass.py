"""The autopilot's low-pass: phase figures, the discrete filter against the continuous one, its running form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import freqz

from companion.core.wing.lowpass import Biquad, Butterworth2
from companion.records import Complexes, Floats


def gain(biquad: Biquad, frequency_hz: Floats) -> Complexes:
    return np.asarray(freqz(biquad.b, (1.0, *biquad.a), worN=frequency_hz, fs=biquad.rate_hz)[1])


@pytest.mark.parametrize(("cutoff_hz", "phase_deg"), [(20.0, -30.8), (100.0, -5.8)])
def test_phase_at_the_recorded_flights_frequency(cutoff_hz: float, phase_deg: float) -> None:
    response = Butterworth2(cutoff_hz).response(np.array([7.3]))[0]
    assert math.degrees(np.angle(response)) == pytest.approx(phase_deg, abs=0.15)


def test_the_phase_of_20_hz_is_11_7_ms_at_7_3_hz() -> None:
    phase = np.angle(Butterworth2(20.0).response(np.array([7.3]))[0])
    assert -phase / (2 * math.pi * 7.3) == pytest.approx(0.0117, abs=5e-5)


def test_the_biquad_is_down_3_db_at_its_cutoff_and_passes_the_mean() -> None:
    response = gain(Biquad.lowpass(20.0, 400.0), np.array([0.0, 20.0]))
    assert np.abs(response) == pytest.approx([1.0, math.sqrt(0.5)])
    assert np.angle(response[1]) == pytest.approx(-math.pi / 2)


def test_the_biquad_tends_to_the_continuous_filter() -> None:
    frequency = np.linspace(0.5, 40.0, 50)
    difference = gain(Biquad.lowpass(20.0, 20000.0), frequency) - Butterworth2(20.0).response(frequency)
    assert np.abs(difference).max() < 2e-4


def test_running_the_biquad_on_a_sine_gives_its_response() -> None:
    biquad, rate, frequency = Biquad.lowpass(20.0, 1000.0), 1000.0, 7.3
    t = np.arange(4000) / rate
    wave = np.exp(2j * math.pi * frequency * t)
    filtered = biquad.run(np.column_stack([wave.real, wave.imag]))
    passed = (filtered[:, 0] + 1j * filtered[:, 1])[2000:] / wave[2000:]
    assert passed == pytest.approx(gain(biquad, np.array([frequency]))[0], abs=1e-9)


def test_running_starts_settled() -> None:
    assert Biquad.lowpass(20.0, 1000.0).run(np.full(10, -9.80665)) == pytest.approx(np.full(10, -9.80665))


def test_cutoffs_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match="samples/s"):
        Biquad.lowpass(30.0, 50.0)
    for bad in (0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="cutoff"):
            Butterworth2(bad)

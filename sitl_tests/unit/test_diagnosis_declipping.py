"""Samples that a range has cut are restored as the recording's own spectra make them likely."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from companion.diagnosis.data.declipping import impute_clipped
from companion.diagnosis.data.observations import RawRecording, RawStream
from companion.diagnosis.data.resampling import observe
from companion.diagnosis.data.sample_defects import find_sample_defects, interpolate_clipped
from companion.params.files import load_airframe
from companion.records import Floats, Side

RATE_HZ, COUNT, LIMIT = 500.0, 12000, 6.0
F_HZ = np.fft.rfftfreq(COUNT, 1.0 / RATE_HZ)


def rung(rng: np.random.Generator, hz: float, rms: float) -> Floats:
    """White noise through a resonance of 3 % damping, of which an accelerometer shows the acceleration."""
    pole = np.exp((-0.03 + 1j) * 2.0 * np.pi * hz / RATE_HZ)
    ringing = lfilter([1.0, -2.0, 1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal(COUNT))
    return np.asarray(rms * ringing / ringing.std())


def wing(seed: int) -> tuple[Floats, Floats]:
    """Two sides that share two modes, the second cut at one end; the whole and the cut, (2, m)."""
    rng = np.random.default_rng(seed)
    alike, against = rung(rng, 5.0, 5.0), rung(rng, 6.4, 5.0)
    uncut = np.stack([alike - against, alike + against]) + 1.5 * rng.standard_normal((2, COUNT))
    return uncut, np.stack([uncut[0], np.minimum(uncut[1], LIMIT)])


def spectra(values: Floats, low_hz: float, top_hz: float) -> tuple[float, complex]:
    """Power of the second side in a band, and the coherence of both."""
    left, right = np.fft.rfft(values - values.mean(1, keepdims=True))[:, (low_hz <= F_HZ) & (top_hz > F_HZ)]
    power = np.mean(np.abs(right) ** 2) / COUNT
    shared = complex(np.mean(left * right.conj())) / float(np.sqrt(np.mean(np.abs(left) ** 2) * power * COUNT))
    return float(power), shared


def spline(cut: Floats) -> Floats:
    t_s, sensor = np.arange(COUNT) / RATE_HZ, load_airframe("nadir-2m").left
    return np.stack([cut[0], interpolate_clipped(t_s, cut[1], find_sample_defects(t_s, cut[1], sensor))])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_power_and_coherence_are_those_of_the_uncut_recording(seed: int) -> None:
    uncut, cut = wing(seed)
    guessed = spline(cut)
    mended = impute_clipped(cut, (cut < uncut).astype(float), guessed)
    for low_hz, top_hz in ((4.0, 5.6), (5.6, 7.5), (7.5, 30.0), (30.0, 200.0)):
        (true, shared), (power, coherence) = spectra(uncut, low_hz, top_hz), spectra(mended, low_hz, top_hz)
        assert power == pytest.approx(true, rel=0.1)
        assert abs(coherence - shared) < 0.05
    assert spectra(guessed, 5.6, 7.5)[0] < 0.8 * spectra(uncut, 5.6, 7.5)[0]
    assert mended[1].mean() == pytest.approx(uncut[1].mean(), abs=0.1)


def test_what_was_recorded_stays_and_what_was_cut_lies_beyond() -> None:
    uncut, cut = wing(3)
    cut[0] = np.clip(cut[0], -LIMIT, LIMIT)
    side = np.sign(uncut - cut)
    mended = impute_clipped(cut, side, cut)
    assert np.array_equal(mended[side == 0.0], uncut[side == 0.0])
    assert (side * (mended - cut) >= 0.0).all()
    assert np.isfinite(mended).all()


@pytest.mark.slow
def test_a_recording_is_restored_on_its_way_to_the_grid() -> None:
    """Specific force is downward: a side that is cut where it accelerates up is cut at the lower end."""
    uncut, cut = wing(4)
    t_s = np.arange(COUNT) / RATE_HZ
    plain, short = (
        observe(
            RawRecording({side: RawStream(t_s, -9.8 - row) for side, row in zip(Side, values, strict=True)}),
            load_airframe("nadir-2m"),
            50.0,
        )[0]
        for values in (uncut, cut)
    )
    assert [entry.name for entry in short.sample_defects] == ["saturation"]
    assert np.std(short.up_mps2[:, 1]) == pytest.approx(np.std(plain.up_mps2[:, 1]), rel=0.03)
    assert np.std(short.up_mps2[:, 1] - plain.up_mps2[:, 1]) < 0.25 * np.std(plain.up_mps2[:, 1])
    assert np.array_equal(short.up_mps2[:, 0], plain.up_mps2[:, 0])

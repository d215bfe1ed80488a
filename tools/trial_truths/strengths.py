"""How strongly effects are hidden in blind trials: what one sigma of each is. Imports nothing of Spanwise."""

from __future__ import annotations

import numpy as np

SIGMA = {
    "frequency-shift": 0.0076,
    "frequency-drift": 0.0085,
    "damping-shift": 0.115,
    "left-right-frequency": 0.0027,
    "left-right-damping": 0.089,
    "left-right-forcing": 0.0071,
    "cubic-stiffness": 73.0,
    "quadratic-stiffness": 0.97,
    "quadratic-damping": 1.4,
    "coulomb-friction": 0.045,
    "freeplay": 5.8e-5,
    "hysteresis": 0.030,
    "second-mode": 3.1e-4,
    "close-mode": 0.12,
    "torsion-coupling": 2.6e-4,
    "parametric-stiffness": 0.0080,
    "airspeed-dependence": 0.0029,
    "covariate-frequency": 0.0028,
    "accel-scale": 0.0059,
    "accel-bias": 0.053,
    "accel-cubic": 8.0e-6,
    "stream-delay": 0.00023,
    "clock-skew": 0.00031,
    "sensor-filter": 0.00018,
    "tone": 0.086,
    "exposure-delay": 0.00018,
    "exposure-jitter": 6.7e5,
    "rolling-shutter": 1.0e-4,
    "baseline-error": 0.0087,
    "focal-error": 0.0040,
    "convergence-offset": 0.00059,
    "camera-asymmetry": 0.0048,
    "mount-lag": 0.00018,
    "mount-resonance": 1.1e-5,
    "coloured-gust": 4.6e-7,
    "periodic-forcing": 0.058,
    "impulsive-forcing": 0.040,
}
"""Profiled posterior sigma of each effect at 20 dB with this belief, from screening recordings that hide none.

Of five the information at 0 is not that at the magnitudes of trials, for frequency, damping and level make up for
part of them. The sigmas of quadratic-damping, torsion-coupling, hysteresis and exposure-jitter are those by which the
profiled log likelihood ratio of 4 to 6 recordings was what it was (2, 1.3, 1.7 and 2.1 times those at 0); close-mode
has ``CLOSE``.
"""
CLOSE = (
    (0.0, 0.06, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0),
    (0.0, 2.4, 3.4, 5.2, 6.3, 7.6, 8.2, 8.7, 9.0, 9.1),
    (0.0, 1.6, 2.4, 3.85, 4.85, 6.1, 6.85, 7.45, 7.9, 8.1),
)
"""Participations of a mode beside the first, and sigmas of the profiled likelihood ratio of one below and one above it.

From the divergence of the two spectra over 60 s for a mode 9.75 % away, frequency, damping and level free. It
saturates: 7 % away, a mode of any strength reaches 6 sigma at most, 5 % away 4; so what is hidden lies 9.75 to 10 %
away. Noise and gust have no say in it: from 20 to 10 dB none of these numbers changes by more than 1.5 %.
"""
IN_SAMPLES = {"saturation": (5.0, 7.0), "quantisation": (6.0, 8.0), "dropout-jitter": (0.02, 0.05)}
"""What shows in the samples themselves has no sigma: the range beyond 1 g, the step, m/s^2; the share lost."""
NOISIER = {
    "accel-bias": 1.06,
    "accel-cubic": 1.1,
    "camera-asymmetry": 2.5,
    "clock-skew": 1.7,
    "coloured-gust": 1.2,
    "convergence-offset": 1.05,
    "coulomb-friction": 1.04,
    "cubic-stiffness": 1.08,
    "exposure-delay": 1.5,
    "exposure-jitter": 2.5,
    "freeplay": 1.07,
    "impulsive-forcing": 1.06,
    "left-right-damping": 1.05,
    "left-right-forcing": 1.4,
    "left-right-frequency": 1.08,
    "mount-lag": 1.5,
    "mount-resonance": 1.75,
    "parametric-stiffness": 1.06,
    "periodic-forcing": 1.06,
    "quadratic-damping": 1.03,
    "quadratic-stiffness": 1.09,
    "rolling-shutter": 1.75,
    "second-mode": 1.35,
    "sensor-filter": 1.5,
    "stream-delay": 1.4,
    "tone": 1.08,
    "torsion-coupling": 1.2,
    "quantisation": 2.05,
}
"""How much larger the sigma is at 10 dB, where it is by 3 % or more: medians of 4 flights recorded at both.

Of modes and tones over all their frequencies. A step of 12 to 16 m/s^2 adds 1 to 1.6 dB to the noise at 10 dB; much
coarser ones leave less than half a standard deviation to a step, and are no noise but another sensor.
"""
LOUDER = {
    "cubic-stiffness": -2,
    "quadratic-stiffness": -1,
    "quadratic-damping": -1,
    "accel-cubic": -2,
    "coulomb-friction": 1,
    "freeplay": 1,
    "periodic-forcing": 1,
    "impulsive-forcing": 1,
    "tone": 1,
    "exposure-delay": -1,
    "exposure-jitter": -2,
    "rolling-shutter": -1,
    "mount-lag": -1,
    "mount-resonance": -1,
    "camera-asymmetry": -1,
}
"""With which power of the wing's motion the sigma of an effect goes."""
ONE_WAY = frozenset(
    {
        "quadratic-damping",
        "coulomb-friction",
        "freeplay",
        "hysteresis",
        "sensor-filter",
        "mount-lag",
        "mount-resonance",
        "rolling-shutter",
        "exposure-jitter",
        "second-mode",
        "close-mode",
        "torsion-coupling",
        "coloured-gust",
    }
)
"""Effects that nature has in one direction only."""


def sigma_of(name: str, snr_db: float = 20.0, loudness: float = 1.0) -> float:
    """Posterior sigma of an effect; louder sensors than 20 dB widen it, quieter ones count as 20 dB."""
    return float(SIGMA[name] * widening(name, snr_db) * loudness ** LOUDER.get(name, 0))


def widening(name: str, snr_db: float) -> float:
    """Factor by which a sigma is larger at this SNR than at 20 dB."""
    exponent = min(max((20.0 - snr_db) / 10.0, 0.0), 1.0)
    return float(NOISIER.get(name, 1.0) ** exponent)


def participation(strength: tuple[float, float], ratio: float, rng: np.random.Generator) -> float:
    """Participation of a mode beside the first: as strong as asked, or evenly up to where none makes it stronger."""
    sigmas = close_mode_sigmas(ratio)
    low, high = (min(end, sigmas[-1]) for end in strength)
    return float(np.interp(rng.uniform(low, high), sigmas, CLOSE[0]))


def close_mode_sigmas(ratio: float) -> tuple[float, ...]:
    """Sigmas of a close mode below or above the first, at the participations of ``CLOSE``."""
    return CLOSE[1] if ratio < 0.0 else CLOSE[2]

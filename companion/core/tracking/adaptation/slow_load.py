"""Slow load that a fit cannot exclude: the lower corner of the gust as the filter takes it.

A slow bend hardly accelerates a tip. Where the corner lies below what the vertical axes show, the load's density there
is ``f^-2`` from wherever it begins. A filter that believes in too little of it takes the mean bend of a flight for a
sensor's misalignment, and is sure of that. Gyros show the slow bend's rate, so that with them less is left open.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.tracking.adaptation.model_spectrum import load_density
from companion.core.tracking.adaptation.periodogram import Periodogram
from companion.core.tracking.adaptation.whittle import LogNormalPrior, neg_log_likelihood
from companion.core.tracking.parameters import CORNER_1, CORNER_2, FIRST_PARAMETERS, FREQUENCY
from companion.records import Floats

LEAST_CORNER_HZ = 0.03  # derived: of Dryden's vertical gust at 22 m/s in 100 m, V / (2 pi h)
_CORNERS = 7  # numerical: a third of a decade between those tried
_LEAST_PRESENT = 0.98  # chosen: what is missing is bridged, as short as it is beside a second
_RATE_BAND_HZ = (0.1, 1.0)  # chosen: above a bias' drift, and where a 5 Hz wing follows its load at once
_HANN_INDEPENDENT = 18.0 / 35.0  # derived, (sum w^2)^2 / (n sum w^4): independent bins of a Hann taper for each bin


@dataclass(frozen=True, slots=True, eq=False)
class SlopeRates:
    """Periodogram of a family's rate of slope at low frequencies, without the static bend's.

    Attributes
    ----------
    frequency_hz, power : (b,) float64
        One-sided, (rad/s)^2/Hz.
    noise : float
        Density of the gyros' noise.
    slope_factor_radpm : float
        Of the family's first mode.
    """

    frequency_hz: Floats
    power: Floats
    noise: float
    slope_factor_radpm: float

    def neg_log_likelihood(self, values: Floats, reference_hz: float) -> float:
        """Whittle's, of a family with these parameters (p,), whose bend follows a slow load at once."""
        omega_squared = (2.0 * np.pi * values[FREQUENCY]) ** 2
        per_load = (2.0 * np.pi * self.frequency_hz * self.slope_factor_radpm / omega_squared) ** 2
        expected = self.noise + per_load * load_density(values, self.frequency_hz**2, reference_hz)
        return _HANN_INDEPENDENT * float(np.sum(np.log(expected) + self.power / expected))


def slope_rates(rate_radps: Floats, step_s: float, noise: float, slope_factor_radpm: float) -> SlopeRates | None:
    """Periodogram of a rate of slope (n,), NaN where missing; None where many are, or the segment is too short."""
    n, present = len(rate_radps), np.isfinite(rate_radps)
    first, last = np.ceil(np.array(_RATE_BAND_HZ) * n * step_s).astype(int)
    first = max(first, 2)  # the taper leaks a constant into the two lowest
    if last <= first or present.mean() < _LEAST_PRESENT:
        return None
    if not present.all():
        at = np.arange(n)
        rate_radps = np.interp(at, at[present], rate_radps[present])
    taper = np.hanning(n)
    spectrum = np.fft.rfft(taper * (rate_radps - rate_radps.mean()))[first:last]
    power: Floats = 2.0 * step_s / float(taper @ taper) * (spectrum.real**2 + spectrum.imag**2)
    return SlopeRates(np.arange(first, last) / (n * step_s), power, noise, slope_factor_radpm)


def slow_corner_hz(
    periodogram: Periodogram, prior: LogNormalPrior, log_params: Floats, first: int, rates: SlopeRates | None
) -> float:
    """Corner whose slow load is the mean of those that periodogram and rates leave possible.

    Far below a corner c the density goes with ``c^-2``, the load at the reference frequency held. The mean is over the
    likelihood, between :data:`LEAST_CORNER_HZ` and the fit's own corner.

    Parameters
    ----------
    periodogram : Periodogram
        That the family was fitted to.
    prior : LogNormalPrior
        Of the parameters.
    log_params : (p,) float64
        Fit.
    first : int
        Where the family begins in them.
    rates : SlopeRates, optional
        Of the same family.
    """
    corners = first + np.array([CORNER_1, CORNER_2])
    at = int(corners[np.argmin(log_params[corners])])
    tried = np.linspace(min(np.log(LEAST_CORNER_HZ), log_params[at]), log_params[at], _CORNERS)
    reference_hz = float(prior.reference_hz[np.searchsorted(prior.places.first, first)])
    costs = np.empty(len(tried))
    for k, corner in enumerate(tried):
        moved = log_params.copy()
        moved[at] = corner
        costs[k] = neg_log_likelihood(periodogram, prior, moved)
        if rates is not None:
            costs[k] += rates.neg_log_likelihood(np.exp(moved[first : first + FIRST_PARAMETERS]), reference_hz)
    weight = np.exp(costs.min() - costs)
    return float((weight @ np.exp(-2.0 * tried) / weight.sum()) ** -0.5)

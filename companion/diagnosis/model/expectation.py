"""Expectation of a recording under a model: everything that its likelihood needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.diagnosis.model.motion import SmoothedMotion
from companion.diagnosis.spectral_matrices import Complexes
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class Expectation:
    """A model held against a recording of c accelerometers, b frequencies in the band, k exposures, n modes, m samples.

    Attributes
    ----------
    motion : Motion
        What it makes of the accelerations.
    toe_residual_rad : (k,)
    toe_posterior : (k, k)
        Covariance of the toe that the accelerations leave.
    toe_variance : (k,)
        Of the matching, and of exposures that wander.
    rest_residual, rest_variance : (c,)
        The sensors at rest: what is left of the mean, and its variance.
    """

    motion: SmoothedMotion
    toe_residual_rad: Floats
    toe_posterior: Floats
    toe_variance: Floats
    rest_residual: Floats
    rest_variance: Floats

    @property
    def spectrum(self) -> Complexes:
        """Two-sided density of the accelerations in the band, (c, c, b)."""
        return self.motion.spectrum

    @property
    def inverse(self) -> Complexes:
        """Its inverse, (c, c, b)."""
        return self.motion.inverse

    @property
    def residual(self) -> Complexes:
        """Spectrum of the data once all that is not stationary Gaussian is out, (c, b)."""
        return self.motion.residual

    @property
    def q_m(self) -> Floats:
        """Smoothed modal coordinates, (n, m)."""
        return self.motion.in_time[0]

    @property
    def qdot_mps(self) -> Floats:
        """Their rates, (n, m)."""
        return self.motion.in_time[1]

    @property
    def toe_covariance(self) -> Floats:
        """Covariance of the toe residual, (k, k), rad^2."""
        return self.toe_posterior + np.diag(self.toe_variance)

"""Expectation of a recording under a model: everything that its likelihood needs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy.linalg import cho_factor
from scipy.linalg.lapack import dpotri

from companion.diagnosis.model.linear_spectra import Linear
from companion.diagnosis.spectral_matrices import adjoint, apply
from companion.records import Complexes, Floats


class Motion(Protocol):
    """One model's view of the accelerations; frequencies f run from 0 to the top of the band of b.

    Attributes
    ----------
    key : object
        Equal where two models are the same here.
    linear : Linear
    cross : (n, c, f)
        Modal deflection with what is measured.
    spectrum, inverse : (c, c, b)
        Two-sided density of the accelerations in the band, and its inverse.
    """

    key: object
    linear: Linear
    cross: Complexes
    spectrum: Complexes
    inverse: Complexes

    @property
    def smoother(self) -> Complexes:
        """Modal deflection per acceleration, (n, c, f), zero below the band."""

    @property
    def unknown(self) -> Complexes:
        """Density of the deflection that the accelerations leave, (n, n, f), m^2/Hz."""

    @property
    def whitener(self) -> Complexes:
        """Lower triangular L with L L^H the inverse spectrum, (c, c, b)."""

    @property
    def modal(self) -> Complexes:
        """Spectrum of the smoothed modal deflection, (n, f)."""

    @property
    def residual(self) -> Complexes:
        """Tapered spectrum of the data without forced motion and sensors' nonlinearity, (c, b)."""

    @property
    def force_score(self) -> Complexes:
        """Score by a force on each mode, (n, f)."""

    @property
    def forced_mps2(self) -> Complexes | None:
        """Spectrum of the accelerations by known forces, (c, f); None where there are none."""

    @property
    def in_time(self) -> tuple[Floats, Floats]:
        """Smoothed modal deflection and speed, (n, m) each."""


@dataclass(frozen=True, eq=False)
class ToeErrors:
    """Errors of a toe residual at k exposures. Models whose errors are equal share one, so that it is factored once.

    Attributes
    ----------
    posterior : (k, k)
        Covariance of the toe that the accelerations leave, rad^2.
    variance : (k,)
        Of the matching, and of exposures that wander, rad^2.
    """

    posterior: Floats
    variance: Floats

    @property
    def covariance(self) -> Floats:
        """Covariance of the residual, (k, k), rad^2."""
        covariance = self.posterior.copy()
        covariance.flat[:: len(covariance) + 1] += self.variance
        return covariance

    @cached_property
    def factor(self) -> Floats:
        """Cholesky's factor of it, (k, k); only the lower triangle means anything."""
        # transposed, which it equals, it lies in memory as LAPACK wants it and is factored in place
        return np.asarray(cho_factor(self.covariance.T, lower=True, overwrite_a=True, check_finite=False)[0])

    @cached_property
    def precision(self) -> Floats:
        """Inverse of it, (k, k)."""
        inverse: Floats = dpotri(self.factor, lower=1)[0]
        symmetric: Floats = np.where(np.tri(len(inverse), dtype=np.bool_), inverse, inverse.T)
        return symmetric

    def with_variance(self, variance: Floats) -> ToeErrors:
        """These errors with another variance (k,); the same ones where it is equal."""
        return self if np.array_equal(variance, self.variance) else ToeErrors(self.posterior, variance)


@dataclass(frozen=True)
class Expectation:
    """A model held against a recording of c accelerometers, b frequencies in the band, k exposures, n modes, m samples.

    Attributes
    ----------
    motion : Motion
        What it makes of the accelerations.
    toe_residual_rad : (k,)
    toe_errors : ToeErrors
        Their covariance.
    rest_residual, rest_variance : (c,) or (c + 1,)
        Residual and variance of the sensors' means at rest, m/s^2, and of the delay by the recoil (last entry), s.
    """

    motion: Motion
    toe_residual_rad: Floats
    toe_errors: ToeErrors
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
        """Tapered spectrum of the data without forced motion and sensors' nonlinearity, (c, b)."""
        return self.motion.residual

    @property
    def white_residual(self) -> Complexes:
        """The residual as white noise if the model is right, (c, b)."""
        return self.whitened(self.residual)

    def whitened(self, values: Complexes) -> Complexes:
        """Spectra (c, b) in the units in which the model's residual is white noise."""
        return apply(adjoint(self.motion.whitener), values)

    @property
    def q_m(self) -> Floats:
        """Smoothed modal coordinates, (n, m)."""
        return self.motion.in_time[0]

    @property
    def qdot_mps(self) -> Floats:
        """Their rates, (n, m)."""
        return self.motion.in_time[1]

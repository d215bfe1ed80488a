"""Measured mode shapes: points on the leading and trailing edge -> deflection, slope and twist at a camera.

As in the paper's Fig. 9 and 10, each edge gets a polynomial in the span station. It is linear in its coefficients, so
the uncertainty of every figure follows from the fit's covariance.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.records import Floats


@dataclass(frozen=True, slots=True)
class EdgePoints:
    """Measured points of one edge: ``deflection`` in metres up (or per unit of a mode), ``sigma`` likewise or None."""

    span_m: Floats
    deflection: Floats
    sigma: float | None = None

    def __post_init__(self) -> None:
        if self.span_m.ndim != 1 or self.span_m.shape != self.deflection.shape:
            raise ValueError("span stations and deflections must be two lists of equal length")
        if not (np.all(np.isfinite(self.span_m)) and np.all(np.isfinite(self.deflection))):
            raise ValueError("a span station or deflection is not finite")
        if self.sigma is not None and not self.sigma > 0.0:
            raise ValueError(f"sigma must be > 0, not {self.sigma}")


@dataclass(frozen=True, slots=True)
class EdgeFit:
    """A fitted edge, linear in its coefficients.

    Attributes
    ----------
    basis : callable
        (span stations (k,), derivative 0 or 1) -> rows (k, coefficients).
    residual_sigma : float
        Of one point about the curve, as measured (or as given).
    span_m : (float, float)
        First and last measured station; outside, the curve is an extrapolation and is refused.
    """

    basis: Callable[[Floats, int], Floats]
    coefficients: Floats
    covariance: Floats
    residual_sigma: float
    span_m: tuple[float, float]

    def deflection(self, span_m: Floats) -> Floats:
        """Deflection at stations (k,)."""
        return np.asarray(self.rows(span_m, 0) @ self.coefficients)

    def slope(self, span_m: Floats) -> Floats:
        """d(deflection)/d(span) at stations (k,)."""
        return np.asarray(self.rows(span_m, 1) @ self.coefficients)

    def rows(self, span_m: Floats, derivative: int) -> Floats:
        """Basis rows (k, coefficients) at stations (k,); raise :class:`ValueError` outside the measured span."""
        span = np.asarray(span_m, dtype=np.float64)
        low, high = self.span_m
        slack = 1e-9 * (high - low)
        if np.any(span < low - slack) or np.any(span > high + slack):
            raise ValueError(f"a station lies outside the measured span, {low:g} to {high:g} m")
        return self.basis(span, derivative)


def fit_polynomial(points: EdgePoints, degree: int, *, clamped: bool = False) -> EdgeFit:
    """Least-squares polynomial; ``clamped`` leaves out the constant and linear term (root at y = 0 held fast).

    A clamped curve is known from the root on, so its span starts at 0.

    Raises
    ------
    ValueError
        For too few distinct stations, or a clamped polynomial of degree below 2.
    """
    first = 2 if clamped else 0
    if degree < first:
        raise ValueError(f"a clamped edge needs degree 2 or more, not {degree}")
    scale = float(np.max(np.abs(points.span_m)))
    powers = np.arange(first, degree + 1)

    def basis(span_m: Floats, derivative: int) -> Floats:
        u = np.asarray(span_m)[:, None] / scale
        if derivative == 0:
            return np.asarray(u**powers)
        return np.asarray(powers * u ** np.maximum(powers - 1, 0) / scale)

    _enough(points, len(powers))
    rows = basis(points.span_m, 0)
    coefficients, _, rank, _ = np.linalg.lstsq(rows, points.deflection, rcond=None)
    if rank < len(powers):
        raise ValueError("the stations do not determine the polynomial")
    sigma = _residual_sigma(points, rows @ coefficients, float(len(powers)))
    covariance = np.asarray(sigma**2 * np.linalg.inv(rows.T @ rows), dtype=np.float64)
    low, high = float(np.min(points.span_m)), float(np.max(points.span_m))
    return EdgeFit(
        basis, np.asarray(coefficients, dtype=np.float64), covariance, sigma, (min(low, 0.0) if clamped else low, high)
    )


def _enough(points: EdgePoints, unknowns: int) -> None:
    distinct = len(np.unique(points.span_m))
    needed = unknowns if points.sigma is not None else unknowns + 1  # one to spare tells the noise
    if distinct < needed:
        raise ValueError(f"{distinct} distinct stations are too few: {needed} are needed")


def _residual_sigma(points: EdgePoints, fitted: Floats, freedom: float) -> float:
    if points.sigma is not None:
        return points.sigma
    return float(np.linalg.norm(points.deflection - fitted) / math.sqrt(max(len(fitted) - freedom, 1.0)))


@dataclass(frozen=True, slots=True)
class ShapeAt:
    """Deflection, slope (d/dy) and nose-up twist at one place, with the (3, 3) covariance of the three."""

    deflection: float
    slope: float
    twist: float
    covariance: Floats


@dataclass(frozen=True, slots=True)
class ModalFactors:
    """A place's motion per metre at a reference place (the tip station): lift, slope, twist, with covariance."""

    lift_gain: float
    slope_factor_radpm: float
    twist_factor_radpm: float
    covariance: Floats


@dataclass(frozen=True, slots=True)
class WingShape:
    """A mode of one wing half from its two edges.

    ``covariance`` (2 n, 2 n) is that of both edges' coefficients where they hang together; None where each is fitted
    alone.
    """

    leading: EdgeFit
    trailing: EdgeFit
    covariance: Floats | None = None

    def at(self, span_m: float, chord_fraction: float, chord_m: float) -> ShapeAt:
        """Evaluate at a camera: ``chord_fraction`` is 0 at the leading and 1 at the trailing edge of ``chord_m``.

        Raises
        ------
        ValueError
            Outside the measured span, or for a chord that is not positive.
        """
        rows, coefficients, covariance = self._rows(span_m, chord_fraction, chord_m)
        deflection, slope, twist = rows @ coefficients
        return ShapeAt(float(deflection), float(slope), float(twist), rows @ covariance @ rows.T)

    def factors(self, place: tuple[float, float, float], reference: tuple[float, float, float]) -> ModalFactors:
        """Scale the motion of ``place`` by the deflection of ``reference``; each is (span_m, chord_fraction, chord_m).

        Raises
        ------
        ValueError
            As :meth:`at`, and if the mode has a node at the reference.
        """
        rows, coefficients, covariance = self._rows(*place)
        row = self._rows(*reference)[0][0]
        scale = float(row @ coefficients)
        if abs(scale) < 3.0 * math.sqrt(float(row @ covariance @ row)):
            raise ValueError("the mode does not move at the reference place: nothing can be scaled by it")
        values = rows @ coefficients / scale
        jacobian = (rows - np.outer(values, row)) / scale
        return ModalFactors(float(values[0]), float(values[1]), float(values[2]), jacobian @ covariance @ jacobian.T)

    def _rows(self, span_m: float, chord_fraction: float, chord_m: float) -> tuple[Floats, Floats, Floats]:
        if not chord_m > 0.0:
            raise ValueError(f"the chord must be > 0 m, not {chord_m}")
        span = np.array([span_m])
        lead, trail = self.leading.rows(span, 0)[0], self.trailing.rows(span, 0)[0]
        lead_slope, trail_slope = self.leading.rows(span, 1)[0], self.trailing.rows(span, 1)[0]
        near, far = 1.0 - chord_fraction, chord_fraction
        rows = np.vstack(
            [
                np.concatenate([near * lead, far * trail]),
                np.concatenate([near * lead_slope, far * trail_slope]),
                np.concatenate([lead, -trail]) / chord_m,
            ]
        )
        return rows, np.concatenate([self.leading.coefficients, self.trailing.coefficients]), self._covariance()

    def _covariance(self) -> Floats:
        if self.covariance is not None:
            return self.covariance
        n = len(self.leading.coefficients)
        covariance = np.zeros((2 * n, 2 * n))
        covariance[:n, :n], covariance[n:, n:] = self.leading.covariance, self.trailing.covariance
        return covariance

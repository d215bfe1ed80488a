"""Polynomial fits of modal peaks along both edges, as in Fig. 9, and the slope at the camera that follows from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.wing.shapes import EdgeFit, EdgePoints, WingShape, fit_polynomial
from companion.paper.modal_peaks import ModalPoints
from companion.records import Floats

CAMERA_M = 0.99  # convention: station of the cameras in the airframe file paper-flying-wing
TIP_M = 1.0  # convention: the semispan in the airframe file paper-flying-wing
WHOLE_DEGREE = 6  # the paper's own choice for Fig. 9
CLAMPED_DEGREE = 4  # two terms beyond the root's clamp: the first mode has no inflection (choice)


@dataclass(frozen=True, slots=True, eq=False)
class Fitted:
    """Both edges fitted across the whole span; slopes and deflections are the mean of the edges and of both tips."""

    points: ModalPoints
    leading: EdgeFit
    trailing: EdgeFit

    def deflection(self, span_m: Floats) -> Floats:
        """Mean of the edges at stations (k,), in units of the peaks."""
        return np.asarray(0.5 * (self.leading.deflection(span_m) + self.trailing.deflection(span_m)))

    def slope(self, span_m: Floats) -> Floats:
        """Its d/dy at stations (k,)."""
        return np.asarray(0.5 * (self.leading.slope(span_m) + self.trailing.slope(span_m)))

    @property
    def reach_m(self) -> float:
        """Outermost station that both edges have on both sides."""
        ends = [abs(end) for fit in (self.leading, self.trailing) for end in fit.span_m]
        return min(ends)

    def slope_factor_radpm(self, station_m: float, reference_m: float) -> float:
        """Up-bend slope at a station per metre of deflection at the reference from the root; both sides' mean."""
        both = np.array([-1.0, 1.0])
        return float((both @ self.slope(station_m * both)) / 2.0 / self.bend(reference_m))

    def bend(self, station_m: float) -> float:
        """Deflection relative to the root, mean of both sides."""
        ends = self.deflection(station_m * np.array([-1.0, 1.0]))
        return float(ends.mean() - self.deflection(np.zeros(1))[0])


def fit_edges(points: ModalPoints, degree: int = WHOLE_DEGREE) -> Fitted:
    """One polynomial for each edge, as the paper does."""
    return Fitted(points, fit_polynomial(points.leading, degree), fit_polynomial(points.trailing, degree))


def clamped_factor(points: ModalPoints) -> float:
    """Camera slope per metre of tip deflection, each half fitted alone with its root held, the mean of both."""
    place, tip = (CAMERA_M, 0.5, 1.0), (TIP_M, 0.5, 1.0)
    slopes = []
    for side in (-1.0, 1.0):
        edges = [_half(edge, side) for edge in (points.leading, points.trailing)]
        leading, trailing = (fit_polynomial(edge, CLAMPED_DEGREE, clamped=True) for edge in edges)
        slopes.append(WingShape(leading, trailing).factors(place, tip).slope_factor_radpm)
    return float(np.mean(slopes))


def _half(edge: EdgePoints, side: float) -> EdgePoints:
    on_side = side * edge.span_m > 0.0
    return EdgePoints(side * edge.span_m[on_side], edge.deflection[on_side])

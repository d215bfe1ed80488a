"""From identified shapes to what an airframe file needs: symmetry of the modes, slope and twist at the tip."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from companion.calibration.modes import IdentifiedMode
from companion.calibration.vibration import Point
from companion.core.wing.shapes import EdgePoints, ModalFactors, WingShape, fit_polynomial
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Mode, Uncertain
from companion.records import Floats, Ints

SYMMETRIC_LEAST = 0.9
_DEGREE = 3


@dataclass(frozen=True, slots=True)
class BendingMode:
    """A mode with both wing halves laid upon each other.

    Attributes
    ----------
    mode : IdentifiedMode
    sign : float
        +1 symmetric, -1 antisymmetric.
    shape : WingShape
        Polynomials of both edges, relative to the root section, per unit of the mode.
    factors : ModalFactors
        At the outermost station, per metre of its deflection.
    """

    mode: IdentifiedMode
    sign: float
    shape: WingShape
    factors: ModalFactors


def symmetry(mode: IdentifiedMode, points: list[Point]) -> float:
    """Likeness of the right to the mirrored left half, amplitude included: 1 symmetric, -1 antisymmetric.

    ``2 r.l / (r.r + l.l)`` over pairs of mirrored points.
    """
    pairs = _mirrored(points)
    right, left = mode.shape[pairs[:, 0]], mode.shape[pairs[:, 1]]
    return float(2.0 * (right @ left) / (right @ right + left @ left))


def bending_modes(modes: list[IdentifiedMode], points: list[Point]) -> list[BendingMode]:
    """Those modes that are clearly symmetric or antisymmetric and move their tips, by frequency."""
    found = []
    for mode in modes:
        likeness = symmetry(mode, points)
        if abs(likeness) < SYMMETRIC_LEAST:
            continue
        sign = 1.0 if likeness > 0.0 else -1.0
        shape = half_shape(mode, points, sign)
        try:
            factors = _tip_factors(shape, points)
        except ValueError:
            continue  # a node at the tip: nothing can be scaled by its deflection
        found.append(BendingMode(mode, sign, shape, factors))
    return found


def half_shape(mode: IdentifiedMode, points: list[Point], sign: float) -> WingShape:
    """Both edges as polynomials in the span station, halves averaged, rigid motion of the root taken out."""
    span = np.array([abs(point.span_m) for point in points])
    folded = np.where(np.array([point.span_m > 0.0 for point in points]), 1.0, sign) * mode.shape
    leading = np.array([point.leading for point in points])
    folded = folded - _rigid(points, folded, sign)
    edges = [fit_polynomial(EdgePoints(span[some], folded[some]), _DEGREE) for some in (leading, ~leading)]
    return WingShape(edges[0], edges[1])


def airframe_with(base: Airframe, found: list[BendingMode]) -> Airframe:
    """The base airframe with the first symmetric and the first antisymmetric bending mode of a test.

    Raises
    ------
    ConfigError
        One of the two was not found.
    """
    wing = dataclasses.replace(
        base.wing,
        symmetric=_record(_first(found, 1.0, "symmetric")),
        antisymmetric=_record(_first(found, -1.0, "antisymmetric")),
        second_symmetric=None,
        second_antisymmetric=None,
    )
    return dataclasses.replace(base, wing=wing, description=f"{base.description}; modes from a ground vibration test")


def _first(found: list[BendingMode], sign: float, name: str) -> BendingMode:
    for each in found:
        if each.sign == sign:
            return each
    raise ConfigError(f"no {name} bending mode was identified; test again with more points or a wider band")


def _record(each: BendingMode) -> Mode:
    sigma = np.sqrt(np.diag(each.factors.covariance))
    mode = each.mode
    return Mode(
        Uncertain(round(mode.frequency_hz, 4), round(mode.frequency_sigma_hz, 4)),
        Uncertain(round(mode.damping, 6), round(mode.damping_sigma, 6)),
        Uncertain(round(each.factors.slope_factor_radpm, 4), round(float(sigma[1]), 4)),
        Uncertain(round(each.factors.twist_factor_radpm, 4), round(float(sigma[2]), 4)),
    )


def _tip_factors(shape: WingShape, points: list[Point]) -> ModalFactors:
    span_m = min(shape.leading.span_m[1], shape.trailing.span_m[1])
    chord_m = _chord(points, span_m)
    place = (span_m, 0.5, chord_m)
    return shape.factors(place, place)


def _chord(points: list[Point], span_m: float) -> float:
    """Distance of the two measured lines of points at a span station, aft."""
    lines = []
    for leading in (True, False):
        some = sorted((abs(p.span_m), p.aft_m) for p in points if p.leading is leading)
        lines.append(float(np.interp(span_m, [s for s, _ in some], [a for _, a in some])))
    return lines[1] - lines[0]


def _rigid(points: list[Point], folded: Floats, sign: float) -> Floats:
    """Motion of the root section, as its innermost points show it: heave and pitch; roll if antisymmetric."""
    span = np.array([abs(point.span_m) for point in points])
    aft = np.array([point.aft_m for point in points])
    leading = np.array([point.leading for point in points])
    inner = [edge & (span < span[edge].min() + 1e-3) for edge in (leading, ~leading)]
    moved, at = ([float(np.mean(values[some])) for some in inner] for values in (folded, aft))
    if sign > 0.0:
        nose_up = (moved[0] - moved[1]) / (at[1] - at[0])
        return moved[0] - nose_up * (aft - at[0])
    return 0.5 * (moved[0] + moved[1]) * span / float(np.mean([span[some].mean() for some in inner]))


def _mirrored(points: list[Point]) -> Ints:
    pairs = []
    for i, right in enumerate(points):
        for j, left in enumerate(points):
            opposite = right.span_m > 0.0 and abs(right.span_m + left.span_m) < 1e-3 and right.leading == left.leading
            if opposite:
                pairs.append((i, j))
    if not pairs:
        raise ConfigError("the layout has no mirrored points: symmetry cannot be told")
    return np.array(pairs, dtype=np.int64)

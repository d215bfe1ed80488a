"""From identified shapes to what an airframe file needs: symmetry of the modes, slope and twist at the tip."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.calibration.clamped_half import ClampedHalf, edge_line
from companion.calibration.modes import IdentifiedMode
from companion.calibration.vibration import Point
from companion.core.wing.shapes import EdgePoints, ModalFactors, WingShape, fit_polynomial
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Mode, Uncertain, Wing
from companion.records import Floats, Ints

SYMMETRIC_LEAST = 0.9  # chosen: modal assurance with the mirrored shape, where 1 is a perfect one
_DEGREE = 3  # of an edge's polynomial: a half wing's first mode needs no more (choice)
# of slope and twist: what cubics leave of the first modes of uniform and tapered wings, free or clamped, whose points
# begin at 0.05 to 0.4 of the semispan, beside the difference of two fits (derived: finite elements, 36 cases)
_CUBIC_RATIO = 0.02
_INBOARD_RATIO = 0.1  # of the measured span: innermost points beyond it leave bend inboard of them unseen (choice)
_UNSEEN = 0.33  # relative sigma of what a test on the ground does not show (choice)


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
    clamped : ClampedHalf
        Fit that tells the root section's own motion.
    motion : (points,) float64
        As measured, with both halves on the right.
    chords : (2, k) float64
        Span stations and the distance between the two lines of points there, m.
    """

    mode: IdentifiedMode
    sign: float
    shape: WingShape
    clamped: ClampedHalf
    motion: Floats
    chords: Floats

    @property
    def span_m(self) -> tuple[float, float]:
        """Where both edges were measured."""
        inner = max(self.shape.leading.span_m[0], self.shape.trailing.span_m[0])
        return inner, min(self.shape.leading.span_m[1], self.shape.trailing.span_m[1])

    @property
    def factors(self) -> ModalFactors:
        """At the outermost station, per metre of its deflection."""
        return self.between(self.span_m[1], self.span_m[1])

    @property
    def moves_at_tip(self) -> bool:
        """Whether anything can be scaled by the outermost station's deflection: no node is there."""
        try:
            return bool(self.factors.slope_factor_radpm)
        except ValueError:
            return False

    def between(self, place_m: float, reference_m: float) -> ModalFactors:
        """Motion at one station, mid-chord, per metre of deflection at another one.

        The covariance has the scatter of the points, and what polynomials leave of a wing's shape: by how much the
        clamped fit by itself differs, and a share of each figure.

        Raises
        ------
        ValueError
            A station lies outside the measured span, or the reference stands still.
        """
        place, reference = ((span, 0.5, float(np.interp(span, *self.chords))) for span in (place_m, reference_m))
        factors = self.shape.factors(place, reference)
        values = np.array([factors.lift_gain, factors.slope_factor_radpm, factors.twist_factor_radpm])
        apart = self.clamped.factors(self.motion, place_m, reference_m) - values
        left_over = np.diag(apart**2 + (_CUBIC_RATIO * values) ** 2)
        return dataclasses.replace(factors, covariance=factors.covariance + left_over)


def symmetry(mode: IdentifiedMode, points: list[Point]) -> float:
    """Likeness of the right to the mirrored left half, amplitude included: 1 symmetric, -1 antisymmetric.

    ``2 r.l / (r.r + l.l)`` over pairs of mirrored points.
    """
    pairs = _mirrored(points)
    right, left = mode.shape[pairs[:, 0]], mode.shape[pairs[:, 1]]
    return float(2.0 * (right @ left) / (right @ right + left @ left))


def bending_modes(modes: list[IdentifiedMode], points: list[Point]) -> list[BendingMode]:
    """Those modes that are resolved, clearly symmetric or antisymmetric, and move their tips, by frequency.

    Raises
    ------
    ConfigError
        An edge has too few span stations, or no run measured one of the points.
    """
    _enough_points(modes, points)
    bending = []
    for mode in modes:
        likeness = symmetry(mode, points)
        if not mode.resolved or abs(likeness) < SYMMETRIC_LEAST:
            continue
        sign = 1.0 if likeness > 0.0 else -1.0
        clamped, motion = ClampedHalf.of_points(points, sign), _mirrored_motion(mode, points, sign)
        each = BendingMode(mode, sign, half_shape(points, clamped, motion), clamped, motion, _chords(points))
        if each.moves_at_tip:
            bending.append(each)
    return bending


def _enough_points(modes: list[IdentifiedMode], points: list[Point]) -> None:
    for leading, edge in ((True, "leading"), (False, "trailing")):
        spans = {abs(point.span_m) for point in points if point.leading is leading}
        if len(spans) < _DEGREE + 2:  # one to spare tells the noise
            raise ConfigError(
                f"the layout's {edge} edge has {len(spans)} span stations a side, {_DEGREE + 2} are needed: measure "
                "and list more points"
            )
    for point, *shown in zip(points, *(mode.shape for mode in modes), strict=True):
        if not np.all(np.isfinite(shown)):
            raise ConfigError(f"no run of the layout measured point {point.number}: add its run or drop the point")


def half_shape(points: list[Point], clamped: ClampedHalf, motion: Floats) -> WingShape:
    """Both edges as polynomials in the span station, halves averaged, less the root's part of ``motion`` (points,).

    The points' scatter is in the coefficients directly and by way of the root's motion, which is the same for both.
    """
    span = np.array([abs(point.span_m) for point in points])
    mirrored = clamped.bent @ motion
    leading = np.array([point.leading for point in points])
    edges, maps, sigmas = [], [], np.empty(len(points))
    for some in (leading, ~leading):
        edge = fit_polynomial(EdgePoints(span[some], mirrored[some]), _DEGREE)
        coefficients = np.zeros((len(edge.coefficients), len(points)))
        coefficients[:, some] = np.linalg.pinv(edge.basis(span[some], 0))
        edges.append(edge)
        maps.append(coefficients)
        sigmas[some] = edge.residual_sigma
    scatter = np.vstack(maps) @ clamped.bent * sigmas
    return WingShape(edges[0], edges[1], scatter @ scatter.T)


def relative_to_root(mode: IdentifiedMode, points: list[Point], sign: float) -> Floats:
    """(points,) the shape with both halves on the right, less the rigid motion of the root section."""
    return np.asarray(ClampedHalf.of_points(points, sign).bent @ _mirrored_motion(mode, points, sign))


def _mirrored_motion(mode: IdentifiedMode, points: list[Point], sign: float) -> Floats:
    """(points,) the shape with both halves on the right."""
    return np.where(np.array([point.span_m > 0.0 for point in points]), 1.0, sign) * mode.shape


@dataclass(frozen=True, slots=True)
class Stations:
    """Span stations of an airframe's tip sensors and cameras, as far as a test has measured; ``notes`` say what not."""

    sensor_m: float
    camera_m: float
    notes: tuple[str, ...]


def stations(base: Airframe, modes: list[BendingMode]) -> Stations:
    """Where the modes have to be known for an airframe."""
    sensor = 0.5 * (abs(base.left.position_m[1]) + abs(base.right.position_m[1]))
    camera, notes = sensor, []
    if base.left_camera is not None and base.right_camera is not None:
        camera = 0.5 * (abs(base.left_camera.position_m[1]) + abs(base.right_camera.position_m[1]))
    inner, outer = max(each.span_m[0] for each in modes), min(each.span_m[1] for each in modes)
    for name, place in (("tip sensors", sensor), ("cameras", camera)):
        if not inner <= place <= outer:
            notes.append(
                f"the {name} sit at {place:.2f} m, points were measured from {inner:.2f} to {outer:.2f} m: "
                f"the modes are given at {min(max(place, inner), outer):.2f} m"
            )
    if inner > _INBOARD_RATIO * outer:
        notes.append(
            f"the innermost points lie {inner:.2f} m from the root: the bend inboard of them was not measured and is "
            "taken to be a clamped wing's"
        )
    if outer > base.wing.semispan_m:
        notes.append(f"points reach {outer:.2f} m, the base airframe's semispan is {base.wing.semispan_m:.2f} m")
    return Stations(min(max(sensor, inner), outer), min(max(camera, inner), outer), tuple(notes))


def airframe_with(base: Airframe, modes: list[BendingMode]) -> Airframe:
    """The base airframe with the first symmetric and the first antisymmetric bending mode of a test.

    Slope and twist are those at its tip sensors, per metre of deflection there; the cameras get the symmetric mode's
    slope and deflection at their own station, relative to those. What a test on the ground does not show, bend in
    flight and gusts, is the base's, as a wing of this frequency would have it, and known to a third. Frequency and
    damping that a single run shows are as uncertain as the base's, relative to their size.

    Raises
    ------
    ConfigError
        One of the two was not found, or it does not move at the tip sensors.
    """
    first, other, place = _first(modes, 1.0, "symmetric"), _first(modes, -1.0, "antisymmetric"), stations(base, modes)
    try:
        at_sensor, at_camera = (first.between(span, place.sensor_m) for span in (place.sensor_m, place.camera_m))
        antisymmetric = other.between(place.sensor_m, place.sensor_m)
    except ValueError as error:
        raise ConfigError(f"at the tip sensors, {place.sensor_m:.2f} m from the root: {error}") from error
    wing = dataclasses.replace(
        base.wing,
        symmetric=_record(first.mode, at_sensor, base.wing.symmetric),
        antisymmetric=_record(other.mode, antisymmetric, base.wing.antisymmetric),
        second_symmetric=None,
        second_antisymmetric=None,
        further_symmetric=(),
        further_antisymmetric=(),
        **_in_flight(base.wing, first.mode.frequency_hz),
    )
    slope_gain = round(at_camera.slope_factor_radpm / at_sensor.slope_factor_radpm, 4)
    lift_gain = round(at_camera.lift_gain, 4)
    left, right = (
        camera if camera is None else dataclasses.replace(camera, slope_gain=slope_gain, lift_gain=lift_gain)
        for camera in (base.left_camera, base.right_camera)
    )
    text = f"{base.description}; modes from a ground vibration test"
    return dataclasses.replace(base, wing=wing, description=text, left_camera=left, right_camera=right)


def _in_flight(wing: Wing, frequency_hz: float) -> dict[str, Any]:
    """Bend and gust deflection of a wing, brought to another frequency of its first mode.

    Static bend goes with the inverse square; under a gust load that is white about the mode, with the power -3/2.
    """
    slower = wing.symmetric.frequency_hz.value / frequency_hz

    def scaled(prior: Uncertain, power: float) -> Uncertain:
        value = prior.value * slower**power
        return Uncertain(round(value, 6), round(max(prior.sigma * slower**power, abs(value) * _UNSEEN), 6))

    return {
        "trim_bend_m": scaled(wing.trim_bend_m, 2.0),
        "bend_per_g_m": scaled(wing.bend_per_g_m, 2.0),
        "gust": dataclasses.replace(wing.gust, deflection_rms_m=scaled(wing.gust.deflection_rms_m, 1.5)),
    }


def _first(modes: list[BendingMode], sign: float, name: str) -> BendingMode:
    for each in modes:
        if each.sign == sign:
            return each
    raise ConfigError(f"no {name} bending mode was identified; test again with more points or a wider band")


def _record(mode: IdentifiedMode, factors: ModalFactors, believed: Mode) -> Mode:
    sigma = np.sqrt(np.diag(factors.covariance))
    return Mode(
        _measured(mode.frequency_hz, mode.frequency_sigma_hz, believed.frequency_hz, 4),
        _measured(mode.damping, mode.damping_sigma, believed.damping, 6),
        Uncertain(round(factors.slope_factor_radpm, 4), round(float(sigma[1]), 4)),
        Uncertain(round(factors.twist_factor_radpm, 4), round(float(sigma[2]), 4)),
    )


def _measured(value: float, sigma: float, believed: Uncertain, digits: int) -> Uncertain:
    """Mean with the scatter of its runs; a single run has none, and the base's relative sigma stays."""
    spread = sigma if np.isfinite(sigma) else value * believed.sigma / believed.value
    return Uncertain(round(value, digits), round(spread, digits))


def _chords(points: list[Point]) -> Floats:
    """(2, k) span stations and the distance of the two measured lines of points there, aft."""
    lines = [edge_line(points, leading=leading) for leading in (True, False)]
    spans = np.unique(np.concatenate([line[0] for line in lines]))
    return np.stack([spans, np.interp(spans, *lines[1]) - np.interp(spans, *lines[0])])


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

"""One robust inverse depth from many: of the surface on the range axis, of the nearest thing, or of the centre."""

from __future__ import annotations

import dataclasses
import enum
import math
from dataclasses import dataclass, field

import numpy as np

from companion.core.stereo.triangulation import Depths
from companion.records import Bools, Floats, Ints
from companion.units import MAD_TO_SIGMA

_ABSOLUTE_STEPS = 8  # reweightings to least absolute deviations: the start of the M-estimate (numerical)
_BIWEIGHT_STEPS = 6  # reweightings by the biweight (choice)
_TUKEY = 4.685  # 95 % efficiency on Gaussian errors (Huber and Ronchetti 2009)
# Prior of the tilt, one sigma: a surface may lie at 45 degrees to the axis. That allows rolls and hillsides, and
# steadies a fit to few matches (choice).
_TILT = 1.0
# sigma of a vertical parallax by matching (choice)
_PARALLAX_RAD = 1e-4
_PARALLAX_SLOPE = 0.02  # rad per unit tangent: about a degree of roll between the cameras, one sigma (choice)
# scatter of parallaxes beyond matches and rotation: places of the cameras before things at many distances, lenses
# (choice: a good pair scatters by 0.02 to 0.8 mrad in all, one whose matches are all wrong by 4 to 10 mrad)
_UNEXPLAINED_RAD = 1e-3
_CLUSTER_SIGMAS = 3.0  # by which matches of one thing may differ (choice)
_CENTRE_FRACTION = 0.2  # share of the matches, nearest to the axis, that CENTRE fits (choice)
# roughness of one surface over its depth (choice)
_ROUGHNESS = 0.01
# directions of the convex hull (numerical: its distance comes out short by at most a hundredth of the field of view)
_DIRECTIONS = np.exp(2j * np.pi * np.arange(360) / 360)
_ELLIPSE_AREA = 4.0 * np.pi  # area of an evenly filled ellipse over the root of its covariance's determinant (derived)
_INNERMOST = (
    5  # matches of the ground under the axis: of more, some lie on the next roof, and ranges are withheld (choice)
)
_ON_SURFACE = 2.0  # median departure, in sigmas, of matches that lie on the surface: 0.67 by noise alone (choice)


class RangeProduct(enum.IntEnum):
    """Product that is published as the range: values of the parameter RNG_PRODUCT."""

    MEDIAN = 0
    NEAREST = 1
    CENTRE = 2


@dataclass(frozen=True, slots=True, eq=False)
class InverseDepthEstimate:
    """A linear estimate: ``weights @ depths.inverse_pm``, and an offset for the nearest thing.

    Attributes
    ----------
    inverse_pm, sigma_pm : float
        Inverse depth on the axis, and its one-sigma from matching (scaled up if matches scatter beyond their sigmas).
    weights : (n,) float64
        Weight of each match; they sum to one. Any change of the geometry moves the estimate by the weighted change.
    used : int
        Number of matches with weight.
    slope_pm : (2,) float64
        Change of the plane's inverse depth per unit of either tangent; zeros for the nearest thing.
    """

    inverse_pm: float
    sigma_pm: float
    weights: Floats
    used: int
    slope_pm: Floats = field(default_factory=lambda: np.zeros(2))


def robust_inverse_depth(
    depths: Depths, product: RangeProduct, least: int, *, one_surface: bool = True, turn_sigma_rad: float = math.inf
) -> InverseDepthEstimate | None:
    """Reduce inverse depths to one value, or None when fewer than ``least`` matches support it.

    ``MEDIAN`` and ``CENTRE`` fit a plane, whose inverse depth is linear in the tangents, with an M-estimator that
    starts from least absolute deviations, and take its value on the axis. This is the range of a beam along the axis,
    without the scatter of sloping ground in a field of view of 40 degrees. ``CENTRE`` uses only the matches nearest to
    the axis. ``NEAREST`` is the near edge of the nearest group of matches that agree among themselves.

    One plane through ground and roofs, or through ground and obstacles, lies on neither. So the plane is fitted to as
    many matches around the axis as lie on one surface with the innermost ones. These are ``least`` matches ahead, and
    five where the ground fills the picture (``one_surface``). ``turn_sigma_rad`` is as in :func:`consistent`.
    """
    inliers = consistent(depths, turn_sigma_rad)
    if inliers.size < least:
        return None
    if product is RangeProduct.NEAREST:
        size = max(4, least // 3)
        inliers = _nearest_group(depths, inliers, size)
        return (
            _edge(depths, inliers, _solve(depths, inliers, np.ones((inliers.size, 1))), size) if inliers.size else None
        )
    outward = _outward(depths, inliers)
    if product is RangeProduct.CENTRE:
        outward = outward[: max(_with_spare(least), round(_CENTRE_FRACTION * inliers.size))]
    return _surface_on_axis(depths, outward, outward[: _INNERMOST if one_surface else least], least)


def mean_inverse_depth(depths: Depths, turn_sigma_rad: float = math.inf) -> InverseDepthEstimate | None:
    """Mean of the consistent matches (:func:`consistent`), where they are too few for a range; None without any."""
    inliers = consistent(depths, turn_sigma_rad)
    if not inliers.size:
        return None
    weights = np.zeros(depths.inverse_pm.size)
    weights[inliers] = 1.0 / inliers.size
    value, sigma = depths.inverse_pm[inliers], depths.sigma_pm[inliers]
    return InverseDepthEstimate(float(value.mean()), float(np.linalg.norm(sigma)) / inliers.size, weights, inliers.size)


def consistent(depths: Depths, turn_sigma_rad: float = math.inf) -> Ints:
    """Indices (k,) of finite matches whose vertical parallax agrees with that of the others.

    A parallax that is smooth over the image is an error of the extrinsics. A match that departs from it by more than
    five times the scatter of all parallaxes is wrong. The scatter counts only as far as the matches' sigmas and the
    one-sigma ``turn_sigma_rad`` of the relative rotation explain it, because wrong matches enlarge it, and at least as
    a match's own sigma, because a plane through few matches leaves less. Matches without a positive sigma, whose rays
    meet behind the cameras, are left out.
    """
    return _consistent(depths, turn_sigma_rad)[0]


def consistent_if_explained(depths: Depths, turn_sigma_rad: float) -> Ints | None:
    """Indices (k,) of :func:`consistent`; None if parallaxes scatter so much that most matches are wrong."""
    alike, explained = _consistent(depths, turn_sigma_rad)
    return alike if explained else None


def _consistent(depths: Depths, turn_sigma_rad: float) -> tuple[Ints, bool]:
    """Indices (k,) of consistent matches, and whether the scatter of all parallaxes is explained."""
    finite, residual = _parallax_residuals(depths)
    if finite.size < 3:
        return finite, True
    scatter_rad = MAD_TO_SIGMA * float(np.median(np.abs(residual)))
    explained_rad = _explained_rad(depths, finite, turn_sigma_rad)
    allowed_rad = np.fmin(np.fmax(scatter_rad, depths.sigma_rad[finite]), explained_rad)
    alike: Bools = np.abs(residual) <= 5.0 * allowed_rad + 1e-6
    return finite[alike], scatter_rad <= float(np.median(explained_rad))


def _parallax_residuals(depths: Depths) -> tuple[Ints, Floats]:
    """Indices (n,) of finite matches, and the departures of their vertical parallaxes from a plane, rad."""
    finite = np.flatnonzero(np.isfinite(depths.inverse_pm) & np.isfinite(depths.sigma_pm) & (depths.sigma_pm > 0.0))
    if finite.size < 3:
        return finite, np.zeros(finite.size)
    design = np.column_stack([np.ones(finite.size), depths.tangent[finite]])
    parallax = depths.parallax_rad[finite]
    prior = np.array([0.0, _PARALLAX_SLOPE**-2, _PARALLAX_SLOPE**-2])
    sigma = np.full(finite.size, _PARALLAX_RAD)
    return finite, parallax - design @ _robust(design, parallax, sigma, prior)[0]


def _explained_rad(depths: Depths, indices: Ints, turn_sigma_rad: float) -> Floats:
    """Largest scatter (n,), rad, of parallaxes that is explained: matching, rotation, places and lenses.

    The plane takes the first-order part of a rotation. What is left is of second order: a yaw shows as ``x y`` of the
    tangents. A match may err by three of its sigmas.
    """
    if math.isinf(turn_sigma_rad):
        return np.full(indices.size, math.inf)
    matching = _CLUSTER_SIGMAS * depths.sigma_rad[indices]
    turned = turn_sigma_rad * np.sum(depths.tangent[indices] ** 2, axis=1)
    return np.asarray(np.sqrt(matching**2 + turned**2 + _UNEXPLAINED_RAD**2))


def _outward(depths: Depths, indices: Ints) -> Ints:
    """The same indices, ordered by distance from the axis."""
    return indices[np.argsort(np.linalg.norm(depths.tangent[indices], axis=1), kind="stable")]


def _plane(depths: Depths, inliers: Ints) -> InverseDepthEstimate:
    return _solve(depths, inliers, np.column_stack([np.ones(inliers.size), depths.tangent[inliers]]))


def _surface_on_axis(depths: Depths, outward: Ints, core: Ints, least: int) -> InverseDepthEstimate:
    """Plane through the matches around the axis: all, or a half, a quarter ... of them, until the ``core`` lies on it.

    If some of the core do not lie on it, an edge is near, and their departure is added to the sigma. If all matches lie
    to one side of the axis, the possible tilt of the surface in between is added.
    """
    count, fewest = outward.size, min(_with_spare(least), outward.size)
    while True:
        fitted = _plane(depths, outward[:count])
        departure_pm, allowed_pm = _departure(depths, core, fitted)
        if float(np.median(np.abs(departure_pm))) <= allowed_pm or count == fewest:
            # one of them may be a wrong match, two are an edge
            second_pm = float(np.sort(np.abs(departure_pm))[-2])
            beside_pm = second_pm if second_pm > allowed_pm else 0.0
            sigma_pm = float(np.linalg.norm([fitted.sigma_pm, beside_pm, _unseen_pm(depths, fitted)]))
            return dataclasses.replace(fitted, sigma_pm=sigma_pm)
        count = max(count // 2, fewest)


def _unseen_pm(depths: Depths, fitted: InverseDepthEstimate) -> float:
    """Sigma of extrapolating a plane to the axis, 1/m: its tilt there is as unknown as that of any surface.

    It grows with the distance of the axis from the convex hull of the matches with weight. A distance up to their mean
    spacing is free: matches of a surface under the axis are as far apart.
    """
    counted = np.flatnonzero(fitted.weights)
    tangent = depths.tangent[counted]
    beyond = float(np.min(tangent @ np.stack([_DIRECTIONS.real, _DIRECTIONS.imag]), axis=0).max())
    offset = tangent - tangent.mean(axis=0)
    determinant = max(float(np.linalg.det(offset.T @ offset / counted.size)), 0.0)
    spacing = float(np.sqrt(_ELLIPSE_AREA * np.sqrt(determinant) / counted.size))
    return _tilt_pm(depths, counted) * max(beyond - spacing, 0.0)


def _tilt_pm(depths: Depths, indices: Ints) -> float:
    """Change of a surface's inverse depth per unit tangent, one sigma, if its tilt is unknown, 1/m."""
    return _TILT * max(float(np.median(np.abs(depths.inverse_pm[indices]))), 1e-4)


def _with_spare(least: int) -> int:
    """Matches to fit if ``least`` must have weight: some are outliers."""
    return least + least // 3


def _departure(depths: Depths, core: Ints, fitted: InverseDepthEstimate) -> tuple[Floats, float]:
    """Departures (n,) of matches from a fitted plane, and their limit by noise and roughness, 1/m."""
    value, sigma = depths.inverse_pm[core], depths.sigma_pm[core]
    plane = fitted.inverse_pm + depths.tangent[core] @ fitted.slope_pm
    allowed = np.hypot(sigma, _ROUGHNESS * fitted.inverse_pm)
    return value - plane, _ON_SURFACE * float(np.median(allowed))


def _nearest_group(depths: Depths, inliers: Ints, size: int) -> Ints:
    """Indices of the nearest ``size`` or more matches that agree within their sigmas; empty without such a group."""
    order = inliers[np.argsort(-depths.inverse_pm[inliers], kind="stable")]
    inverse, sigma = depths.inverse_pm[order], depths.sigma_pm[order]
    for first in range(order.size - size + 1):
        group = slice(first, first + size)
        if inverse[first] - inverse[first + size - 1] <= _CLUSTER_SIGMAS * np.sqrt(2.0) * float(sigma[group].max()):
            middle = float(np.median(inverse[group]))
            return order[np.abs(inverse - middle) <= _CLUSTER_SIGMAS * sigma]
    return order[:0]


def _edge(depths: Depths, inliers: Ints, middle: InverseDepthEstimate, size: int) -> InverseDepthEstimate:
    """Near edge of a group: midway from its middle to its nearest ``size`` members, with that distance as sigma.

    On a flat thing the nearest members are nearer by noise alone. On sloping ground they are truly nearer. The matches
    cannot tell one from the other.
    """
    nearest_pm = float(np.mean(np.sort(depths.inverse_pm[inliers])[-size:]))
    edge_pm = 0.5 * max(nearest_pm - middle.inverse_pm, 0.0)
    sigma_pm = float(np.hypot(middle.sigma_pm, edge_pm))
    return InverseDepthEstimate(middle.inverse_pm + edge_pm, sigma_pm, middle.weights, middle.used)


def _solve(depths: Depths, inliers: Ints, design: Floats) -> InverseDepthEstimate:
    """Robust fit; its value on the axis as a linear functional of all matches."""
    value, sigma = depths.inverse_pm[inliers], depths.sigma_pm[inliers]
    prior = np.zeros(design.shape[1])
    prior[1:] = _tilt_pm(depths, inliers) ** -2
    coefficients, weight, scale = _robust(design, value, sigma, prior)
    normal = (design * weight[:, np.newaxis]).T @ design + np.diag(prior)
    row = np.linalg.solve(normal, np.eye(len(prior))[0])
    weights = np.zeros(depths.inverse_pm.size)
    weights[inliers] = weight * (design @ row)
    spread = float(np.sqrt(np.sum((weights[inliers] * sigma) ** 2))) * max(1.0, scale)
    used = int(np.count_nonzero(weight > 0.0))
    slope_pm = coefficients[1:] if len(coefficients) > 1 else np.zeros(2)
    return InverseDepthEstimate(float(weights[inliers] @ value), spread, weights, used, slope_pm=slope_pm)


def _robust(design: Floats, value: Floats, sigma: Floats, prior: Floats) -> tuple[Floats, Floats, float]:
    """Coefficients, weights and scale (in sigmas) by reweighting: absolute deviations first, then Tukey's biweight."""
    base: Floats = sigma**-2.0
    weight, scale = base, 1.0
    coefficients: Floats = np.zeros(design.shape[1])
    for step in range(_ABSOLUTE_STEPS + _BIWEIGHT_STEPS):
        weighted = (design * weight[:, np.newaxis]).T
        normal = weighted @ design + np.diag(prior)
        coefficients = np.asarray(np.linalg.solve(normal, weighted @ value))
        residual = np.abs(value - design @ coefficients) / sigma
        if step < _ABSOLUTE_STEPS:
            weight = base / np.maximum(residual, 0.05 * max(float(np.median(residual)), 1e-6))
        else:
            scale = max(MAD_TO_SIGMA * float(np.median(residual)), 1e-6)
            weight = base * np.maximum(1.0 - (residual / (_TUKEY * scale)) ** 2, 0.0) ** 2
    return coefficients, weight, scale

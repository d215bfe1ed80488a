"""Corrected range of a matched pair: each camera's bend at its own exposure, robust product, sigma, trust."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.stereo.consistency_gate import range_reject
from companion.core.stereo.epipolar_geometry import epipolar_frame
from companion.core.stereo.exposure import CameraExposure, TipMotion, exposures, rest_exposures, with_relative_rotation
from companion.core.stereo.geometry import Rig, epipolar_axes, orientation_axis
from companion.core.stereo.inverse_depth import (
    InverseDepthEstimate,
    RangeProduct,
    mean_inverse_depth,
    robust_inverse_depth,
)
from companion.core.stereo.lens_residual import PAIR_TERMS, LensAxes, straightened
from companion.core.stereo.range_sigma import Budget, Gradient, budget, gradient_of, toe_gradient
from companion.core.stereo.sectors import matched_sectors
from companion.core.stereo.triangulation import Depths, RangeAxis, Rays, match_rays, range_axis_of_rig, triangulate
from companion.core.stereo.vehicle_motion import STILL, VehicleMotion
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import (
    CorrectedRange,
    Deflection,
    Floats,
    MatchSet,
    ObstacleSectors,
    Reject,
    RelativeRotation,
    Side,
)

# error that all matches of a pair may share: blur that differs between the cameras, imperfect interpolation (choice)
_COMMON_MATCH_PX = 0.02
TIMING_SIGMA_S = 1e-4
"""One-sigma of an exposure's stamp, where none is stated (choice)."""
OPTICAL_AXIS: Floats = np.array([0.0, 0.0, 1.0])
"""Viewing direction in camera axes."""
# 1 / (10 km): below this the depth counts as infinite (choice)
_INFINITY_PM = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class RangeAnswer:
    """Range of one pair, its sectors, the depths behind it and its error budget.

    Attributes
    ----------
    range : CorrectedRange
        Range with its sigma.
    sectors : ObstacleSectors or None
        Obstacle sectors, only for pairs that look forward.
    depths : Depths
        Inverse depths of all features along the range axis.
    match_sigma_m : float
        Part of the range's sigma that comes from matching.
    causes_m : Budget
        The other parts by cause, m.
    """

    range: CorrectedRange
    sectors: ObstacleSectors | None
    depths: Depths
    match_sigma_m: float
    causes_m: Budget


@dataclass(frozen=True, slots=True, eq=False)
class PairConditions:
    """Conditions of a pair besides the bend of the wing.

    Attributes
    ----------
    timing_sigma_s : float
        One-sigma of each exposure's stamp.
    motion : VehicleMotion
        The aircraft's velocity, which moves it between unequal exposures.
    turned : RelativeRotation or None
        Relative rotation beyond the tracked bend, and lens terms, by the matches; None: the tracked bend alone is used.
    joint_covariance : (12, 12) float64 or None
        Covariance of that rotation and of the lens terms; None: lens terms without variance.
    attitude_rad : tuple or None
        Roll and pitch, by which sectors are levelled.
    """

    timing_sigma_s: float = TIMING_SIGMA_S
    motion: VehicleMotion = STILL
    turned: RelativeRotation | None = None
    joint_covariance: Floats | None = None
    attitude_rad: tuple[float, float] | None = None

    def measured_rotation(self, body_from_epipolar: Floats) -> tuple[Floats, Floats, Floats] | None:
        """Relative rotation (3,), rad, by the matches, lens terms (9,), covariance (12, 12) of both; body axes."""
        if self.turned is None:
            return None
        covariance = self.turned.covariance if self.joint_covariance is None else self.joint_covariance
        to_body = np.zeros((3 + PAIR_TERMS, len(covariance)))
        to_body[:3, :3] = body_from_epipolar
        to_body[3:, 3:] = np.eye(PAIR_TERMS)[:, : len(covariance) - 3]
        return body_from_epipolar @ self.turned.rotation_rad, self.turned.lens, to_body @ covariance @ to_body.T


AS_TRACKED = PairConditions()
"""Level flight, usual stamps, relative rotation by the tracked bend alone."""


def correct(
    matches: MatchSet,
    left: Deflection,
    right: Deflection,
    rig: Rig,
    airframe: Airframe,
    settings: Settings,
    conditions: PairConditions = AS_TRACKED,
) -> RangeAnswer:
    """Range along the airframe's orientation from one matched pair.

    Parameters
    ----------
    matches : MatchSet
        Raw pixels.
    left, right : Deflection
        The wing at the left and at the right mid-exposure.
    rig : Rig
        Cameras of the airframe.
    airframe : Airframe
        Orientation, slope and twist factors, calibration sigmas.
    settings : Settings
        Product, limits, trust.
    conditions : PairConditions
        Stamps, flight, relative rotation by the matches, attitude.

    Returns
    -------
    RangeAnswer
        Always finite. ``range.reject`` is the reason not to trust it.
    """
    scene = _Scene.exposed(matches.features(), left, right, rig, airframe, conditions)
    depths, toe = scene.depths(scene.matches), scene.toe()
    product = RangeProduct(settings.product)
    estimate = robust_inverse_depth(
        depths, product, settings.min_matches, one_surface=airframe.looks_down, turn_sigma_rad=toe.sigma_rad
    )
    if estimate is None or not np.isfinite(toe.angle_rad + toe.sigma_rad):
        reason = Reject.NO_MATCHES if estimate is None else Reject.NOT_FINITE
        refused = _refused(scene.matches, scene.t_host_ns, airframe.orientation, settings, reason)
        use_few = reason is Reject.NO_MATCHES and airframe.looks_forward
        few = mean_inverse_depth(depths, toe.sigma_rad) if use_few else None
        sectors = None if few is None else scene.sectors(matches, scene.causes(few).total, toe.sigma_rad, settings)
        return RangeAnswer(refused, sectors, depths, 0.0, Budget(0.0, 0.0, 0.0))
    causes = scene.causes(estimate)
    match_pm = float(np.hypot(estimate.sigma_pm, _COMMON_MATCH_PX / (rig.left.lens.focal_px * rig.baseline_m)))
    answer = _answer(scene, settings, toe, estimate, float(np.hypot(match_pm, causes.total)))
    square = answer.range_m**2
    sectors = scene.sectors(matches, causes.total, toe.sigma_rad, settings) if airframe.looks_forward else None
    return RangeAnswer(answer, sectors, depths, match_pm * square, causes.times(square))


@dataclass(frozen=True, slots=True)
class _Toe:
    angle_rad: float
    sigma_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class _Scene:
    """One pair as it was exposed: poses of the cameras, their covariances, and the rays of the matches.

    ``lens`` (9,) are the terms of the lens residual. ``apart`` (12, 12), body axes, is the covariance of the relative
    rotation and of these terms; None without a measured rotation.
    """

    matches: MatchSet
    rig: Rig
    airframe: Airframe
    bend: Deflection
    t_host_ns: int
    moving: tuple[CameraExposure, CameraExposure]
    conditions: PairConditions
    lens: Floats
    apart: Floats | None
    range_axis: RangeAxis
    rays: Rays

    @classmethod
    def exposed(
        cls,
        matches: MatchSet,
        left: Deflection,
        right: Deflection,
        rig: Rig,
        airframe: Airframe,
        conditions: PairConditions,
    ) -> _Scene:
        """Each camera at its own exposure, turned by the relative rotation that the matches have measured."""
        moving = exposures(rig, TipMotion.from_airframe(airframe), left, right, conditions.motion.velocity_mps)
        lens, apart = np.zeros(PAIR_TERMS), None
        measured = conditions.measured_rotation(epipolar_frame(rig).T)
        if measured is not None:
            rotation_rad, lens, apart = measured
            moving = with_relative_rotation(moving, rotation_rad)
        t_host_ns = (left.t_host_ns + right.t_host_ns) // 2
        range_axis = range_axis_of_rig(rig, orientation_axis(airframe.orientation))
        rays = straightened(match_rays(rig, moving, matches), lens, LensAxes.exposed(moving, epipolar_frame(rig)))
        return cls(matches, rig, airframe, left, t_host_ns, moving, conditions, lens, apart, range_axis, rays)

    def depths(self, matches: MatchSet) -> Depths:
        """Inverse depths of matches of this pair, along the range axis."""
        rays = self.rays
        if matches is not self.matches:
            axes = LensAxes.exposed(self.moving, epipolar_frame(self.rig))
            rays = straightened(match_rays(self.rig, self.moving, matches), self.lens, axes)
        return triangulate(
            rays, self.range_axis, self.rig.slope_sigma_rad(Side.RIGHT, matches.right_px, matches.sigma_px)
        )

    def budget(self, gradient: Gradient) -> Budget:
        """Sigma of a result by cause."""
        at = self.conditions
        return budget(
            gradient, self.rig, self.airframe, self.bend, self.moving, at.timing_sigma_s, at.motion, self.apart
        )

    def causes(self, estimate: InverseDepthEstimate) -> Budget:
        """Sigma by cause of an estimate's inverse depth, 1/m. A turn also moves the axis over a tilted surface."""

        def on_axis_pm(rays: Rays) -> Floats:
            depths = triangulate(rays, self.range_axis, np.ones(len(rays.left)))
            return depths.inverse_pm - depths.tangent @ estimate.slope_pm

        epipolar_from_body = epipolar_frame(self.rig)
        return self.budget(gradient_of(on_axis_pm, estimate.weights, self.rays, self.moving, epipolar_from_body))

    def toe(self) -> _Toe:
        """Divergence of the optical axes beyond that of the ground calibration, and its sigma, rad."""
        sigma_rad = self.budget(toe_gradient(epipolar_axes(*(exposure.pose for exposure in self.moving))[1])).total
        return _Toe(toe_between(self.rig, self.moving), sigma_rad)

    def sectors(
        self, matches: MatchSet, common_sigma_pm: float, toe_sigma_rad: float, settings: Settings
    ) -> ObstacleSectors | None:
        """Obstacle sectors of all matches; their common error has this sigma, 1/m, at the middle of the image."""
        depths, attitude_rad = self.depths(matches), self.conditions.attitude_rad
        return matched_sectors(
            depths, self.range_axis, common_sigma_pm, self.t_host_ns, settings, attitude_rad, toe_sigma_rad
        )

    def inverse_depths(self, rays: Rays) -> Floats:
        """Inverse depths (n,) of any rays, along the range axis, 1/m."""
        return triangulate(rays, self.range_axis, np.ones(len(rays.left))).inverse_pm

    def rigid_pm(self) -> Floats:
        """Inverse depths (n,), 1/m, of the matches by the ground calibration alone."""
        return np.nan_to_num(self.inverse_depths(match_rays(self.rig, rest_exposures(self.rig), self.matches)))


def _answer(
    scene: _Scene, settings: Settings, toe: _Toe, estimate: InverseDepthEstimate, sigma_pm: float
) -> CorrectedRange:
    range_m = _metres(estimate.inverse_pm)
    sigma_m = min(sigma_pm * range_m**2, settings.max_range_m) if range_m > 0.0 else settings.max_range_m
    reject = range_reject(estimate.used, range_m, sigma_m, settings)
    return CorrectedRange(
        pair_id=scene.matches.pair_id,
        plan_id=scene.matches.plan_id,
        t_host_ns=scene.t_host_ns,
        orientation=scene.airframe.orientation,
        range_m=range_m,
        sigma_m=sigma_m,
        toe_rad=toe.angle_rad,
        toe_sigma_rad=toe.sigma_rad,
        rigid_range_m=_metres(float(scene.rigid_pm() @ estimate.weights)),
        matches=estimate.used,
        trusted=reject is None,
        reject=reject,
    )


def toe_between(rig: Rig, moving: tuple[CameraExposure, CameraExposure]) -> float:
    """Divergence of the optical axes in the epipolar plane beyond that of the ground calibration, radians."""
    return divergence(moving) - divergence(rest_exposures(rig))


def divergence(
    pair: tuple[CameraExposure, CameraExposure], rays: tuple[Floats, Floats] = (OPTICAL_AXIS, OPTICAL_AXIS)
) -> float:
    """Angle in the epipolar plane by which one ray (3,) of each camera, in its own axes, diverge, rad."""
    x, _, z = epipolar_axes(pair[0].pose, pair[1].pose)
    left, right = (ray @ exposure.pose.camera_from_body for ray, exposure in zip(rays, pair, strict=True))
    return float(np.arctan2(right @ x, right @ z) - np.arctan2(left @ x, left @ z))


def _metres(inverse_pm: float) -> float:
    return 1.0 / inverse_pm if inverse_pm > _INFINITY_PM else 0.0


def _refused(matches: MatchSet, t_host_ns: int, orientation: int, settings: Settings, reject: Reject) -> CorrectedRange:
    return CorrectedRange(
        pair_id=matches.pair_id,
        plan_id=matches.plan_id,
        t_host_ns=t_host_ns,
        orientation=orientation,
        range_m=0.0,
        sigma_m=settings.max_range_m,
        toe_rad=0.0,
        toe_sigma_rad=0.0,
        rigid_range_m=0.0,
        matches=len(matches.sigma_px),
        trusted=False,
        reject=reject,
    )

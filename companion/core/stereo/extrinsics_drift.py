"""Slow relative rotation of the cameras, estimated from the wing tracker and the matches.

The tracker gives each tip's slope with a covariance, and the part of it that is slow (trim bend, tilt bias). The rest
is fast: a process of first order. No inertial sensor shows mounting and thermal set of the cameras. The output is the
relative rotation to take out of this pair, with its covariance. Without matches it is a prediction.
"""

from __future__ import annotations

import math

import numpy as np

from companion.core.stereo.consistency_gate import MatchVerdict
from companion.core.stereo.epipolar import EpipolarFilter, EpipolarUpdate
from companion.core.stereo.epipolar_states import SYSTEMATIC_DOWN_RAD, BendBelief, ExtrinsicsPrior, FastBelief
from companion.core.stereo.exposure import CameraExposure, tip_signs
from companion.core.stereo.flow import FlowView
from companion.core.stereo.geometry import Rig
from companion.core.stereo.lens_residual import PAIR_TERMS, LensAxes, pair_variances
from companion.core.stereo.rotation import without_negative_eigenvalues
from companion.core.stereo.triangulation import Rays
from companion.core.stereo.vehicle_motion import STILL, VehicleMotion
from companion.params.airframe import Airframe
from companion.records import Deflection, Floats, MatchSet, RelativeRotation, Side

# least walk, where the airframe file states no drift: that of cameras which heat turns by 0.12 mrad within ten minutes.
# So matches slowly correct a calibration that is wrong beyond its sigma (choice)
_MIN_WALK_RAD_RTS = 1e-5
_CAMERA_PLACE_SIGMA_M = 0.0005  # sigma of a camera's place across the baseline (choice)
_YAW_BIAS_PX = 0.01  # matching error that all pairs share, in the corner of the image (choice)
# Pitch, yaw and roll ahead. Over obstacles at many distances errors of the cameras' places (wind, exposures apart) look
# like rotations: half a milliradian of pitch and roll for seconds. Yaw has the sigma of a pair that looks down: its
# innovation in three rendered flights is 0.2 mrad rms, at most 2.3 of these sigmas (measured), and a camera turned in
# yaw alone shows in nothing else.
_SYSTEMATIC_AHEAD_RAD = (5e-4, 3e-4, 5e-4)
_FAST_TIME_S = 2.0  # slower bend is slow: trim, load factor; the first modes are far faster (choice)
_MANOEUVRE_S = 3.0  # a roll or a pull-up and its recovery: correlation time of the error that it brings (choice)
_RIPPLE = 1.25  # ratio by which the stated slow sigma may rise by load alone (choice)


class ExtrinsicsDriftFilter:
    """Filter of the slow relative rotation for one airframe, driven by pairs in order of exposure."""

    def __init__(self, rig: Rig, airframe: Airframe) -> None:
        self._rig = rig
        self._filter = EpipolarFilter(rig, extrinsics_prior(rig, airframe))
        self._time_s = min(airframe.left.bias_time_s, airframe.right.bias_time_s)
        self.verdict = MatchVerdict.AGREE
        self.flow_contradicts = False
        """Whether the newest flow contradicts the toe, within two seconds of a flow that was used or before any was."""
        self.joint_covariance: Floats = np.zeros((3 + PAIR_TERMS, 3 + PAIR_TERMS))
        """Covariance (12, 12) of the last rotation returned and of its lens terms, epipolar frame."""
        self._bend_variance = math.inf
        self._bend_ns = 0
        self._mean_slope_rad: float | None = None
        self._per_slope = np.stack(
            [-rig.left.turn_rad(1.0), rig.right.turn_rad(1.0)], axis=1
        )  # relative rotation, body axes, per radian of left and right tip slope
        self.body_from_epipolar: Floats = self._filter.epipolar_from_body.T

    @property
    def has_matches(self) -> bool:
        """Whether any matches have been taken."""
        return self._filter.has_matches

    @property
    def lens_ratio(self) -> float:
        """Variance of the lens residuals over the stated one, estimated from matches; at least 1."""
        return self._filter.lens_ratio

    @property
    def flow_left_aside(self) -> bool:
        """Whether no flow has ever agreed, by far: its velocity, the surface or the calibration is wrong."""
        return self._filter.flow_left_aside

    def reopen(self) -> None:
        """Widen the rotation's variance: matches measure it anew from now on."""
        self._filter.reopen()

    def update(
        self,
        matches: MatchSet,
        rays: Rays,
        bend: tuple[Deflection, Deflection],
        exposures: tuple[CameraExposure, CameraExposure],
        timing_sigma_s: float,
        motion: VehicleMotion = STILL,
        *,
        flow: FlowView | None = None,
        use_matches: bool = True,
    ) -> RelativeRotation:
        """Update by one pair.

        Parameters
        ----------
        matches : MatchSet
            The features; sigmas and pair number are read.
        rays : Rays
            Their rays by the tracked bend alone, body axes.
        bend : tuple of Deflection
            The tracked wing at the left and at the right exposure.
        exposures : tuple of CameraExposure
            Attitudes and rates of turn of the cameras.
        timing_sigma_s : float
            One-sigma of each exposure's stamp, s.
        motion : VehicleMotion
            The aircraft's velocity, which the rays contain, and its covariance.
        flow : FlowView, optional
            Features that an earlier left image shows too.
        use_matches : bool
            False: predict only, with the tracker's own uncertainty.
        """
        t_host_ns = (bend[0].t_host_ns + bend[1].t_host_ns) // 2
        belief, fast = self._belief(bend, t_host_ns), self._fast(bend, exposures, timing_sigma_s)
        if use_matches:
            sigma_rad = self._rig.slope_sigma_rad(Side.RIGHT, matches.right_px, matches.sigma_px)
            shift = self._shift(bend, exposures, timing_sigma_s, motion)
            axes = LensAxes.exposed(exposures, self._filter.epipolar_from_body)
            update = self._filter.update(rays, sigma_rad, fast, t_host_ns, belief, shift, flow, axes)
            if isinstance(update, EpipolarUpdate):
                return self._measured(matches.pair_id, t_host_ns, update)
        return self._predicted(matches.pair_id, t_host_ns, belief, fast)

    def _measured(self, pair_id: int, t_host_ns: int, update: EpipolarUpdate) -> RelativeRotation:
        """Rotation by the pair's matches."""
        self.verdict, self.flow_contradicts = update.verdict, update.flow_contradicts
        self.joint_covariance = update.joint_covariance
        return RelativeRotation(
            pair_id, t_host_ns, update.total_rad, update.total_covariance, update.slow_rad, update.slow_covariance,
            update.used, update.parallax_scale, update.lens, update.flow,
        )  # fmt: skip

    def _predicted(self, pair_id: int, t_host_ns: int, belief: BendBelief, fast: FastBelief) -> RelativeRotation:
        """Rotation without the pair's matches."""
        self.verdict, self.flow_contradicts = MatchVerdict.AGREE, False
        mean, joint = self._filter.predict(t_host_ns, belief)
        slow, covariance = mean[:3], joint[:3, :3].copy()
        joint[:3, :3] += fast.covariance + fast.stamps
        self.joint_covariance = joint
        return RelativeRotation(pair_id, t_host_ns, slow, joint[:3, :3], slow, covariance, 0, 0.0, mean[3:])

    def _belief(self, bend: tuple[Deflection, Deflection], t_host_ns: int) -> BendBelief:
        """Slow error of the tracker, without the ripple of its stated sigma.

        Constants (misalignment, trim) and the load factor make the stated sigma rise and fall by about a percent in
        every manoeuvre. Were every rise taken for a fresh error, the filter would forget what matches have measured.
        So the least stated sigma counts. It ages toward the stated one as the biases drift. A rise beyond the ripple
        means that the tracker itself has lost its estimate.
        """
        direction = self._filter.epipolar_from_body @ self._per_slope.sum(axis=1)
        stated = (0.5 * (bend[0].slow_slope_sigma_rad + bend[1].slow_slope_sigma_rad)) ** 2
        aged = -math.expm1(-2e-9 * max(t_host_ns - self._bend_ns, 0) / self._time_s)
        least = min(self._bend_variance, stated)
        least += aged * (stated - least)
        fast_rad = self._fast_slope_rad(bend, t_host_ns)
        self._bend_variance, self._bend_ns = max(least, stated / _RIPPLE**2), t_host_ns
        return BendBelief(direction, math.sqrt(self._bend_variance), self._time_s, fast_rad)

    def _fast_slope_rad(self, bend: tuple[Deflection, Deflection], t_host_ns: int) -> float:
        """Mean slope of both tips less its moving average over the pairs, rad."""
        slope_rad = 0.5 * float(bend[0].slope_rad[Side.LEFT] + bend[1].slope_rad[Side.RIGHT])
        before_rad = slope_rad if self._mean_slope_rad is None else self._mean_slope_rad
        gain = -math.expm1(-1e-9 * max(t_host_ns - self._bend_ns, 0) / _FAST_TIME_S)
        self._mean_slope_rad = before_rad + gain * (slope_rad - before_rad)
        return slope_rad - self._mean_slope_rad

    def _fast(
        self,
        bend: tuple[Deflection, Deflection],
        exposures: tuple[CameraExposure, CameraExposure],
        timing_sigma_s: float,
    ) -> FastBelief:
        """Error of the fast part (slope covariance less slow variance, and manoeuvre error), and error by stamps.

        The sum of the first two is one first-order process: variances add, and the correlation time is the mean of
        both, weighted by variance. The slow sigma keeps the manoeuvre's part as well, on the safe side.
        """
        left, right = bend
        slopes = np.nan_to_num(0.5 * (left.covariance[4:, 4:] + right.covariance[4:, 4:]))
        slow = 0.5 * (left.slow_slope_sigma_rad + right.slow_slope_sigma_rad)
        fast = without_negative_eigenvalues(slopes - slow**2)
        turn = self._filter.epipolar_from_body @ self._per_slope
        covariance: Floats = turn @ fast @ turn.T
        meanwhile = [timing_sigma_s * (self._filter.epipolar_from_body @ exposure.rate_radps) for exposure in exposures]
        stamps: Floats = np.sum([np.outer(moved, moved) for moved in meanwhile], axis=0)
        in_manoeuvre_rad = 0.5 * (left.manoeuvre_slope_sigma_rad + right.manoeuvre_slope_sigma_rad) * turn.sum(axis=1)
        fresh, total = float(np.trace(covariance)), float(np.trace(covariance) + in_manoeuvre_rad @ in_manoeuvre_rad)
        fast_time_s = 0.5 * (left.fast_slope_time_s + right.fast_slope_time_s)
        time_s = _MANOEUVRE_S + (fast_time_s - _MANOEUVRE_S) * (fresh / total if total > 0.0 else 1.0)
        return FastBelief(covariance + np.outer(in_manoeuvre_rad, in_manoeuvre_rad), time_s, stamps)

    def _shift(
        self,
        bend: tuple[Deflection, Deflection],
        exposures: tuple[CameraExposure, CameraExposure],
        timing_sigma_s: float,
        motion: VehicleMotion,
    ) -> Floats:
        """Covariance (2, 2), rad^2, of this pair's baseline direction, y and z: lift of the tips, flight, stamps."""
        apart_s = exposures[Side.RIGHT].after_s - exposures[Side.LEFT].after_s
        across = self._filter.epipolar_from_body[1:] / self._rig.baseline_m
        stamps = math.sqrt(2.0) * timing_sigma_s * (across @ motion.velocity_mps)
        gains = [self._rig.camera(side).lift_gain * tip_signs(side) for side in Side]
        lift = np.outer(across[:, 2], gains[Side.RIGHT] - gains[Side.LEFT])
        deflection = np.nan_to_num(0.5 * (bend[Side.LEFT].covariance[:2, :2] + bend[Side.RIGHT].covariance[:2, :2]))
        covariance: Floats = apart_s**2 * (across @ motion.covariance @ across.T) + np.outer(stamps, stamps)
        return covariance + lift @ deflection @ lift.T


def extrinsics_prior(rig: Rig, airframe: Airframe) -> ExtrinsicsPrior:
    """Prior of the extrinsics from the airframe file: mounting and its drift, lenses, places."""
    cameras = airframe.camera_pair
    mounting = math.sqrt(sum(camera.rotation_sigma_rad**2 + camera.drift_sigma_rad**2 for camera in cameras))
    walk = math.sqrt(sum(2.0 * camera.drift_sigma_rad**2 / camera.drift_time_s for camera in cameras))
    return ExtrinsicsPrior(
        rotation_rad=mounting,
        walk_rad_rts=max(walk, _MIN_WALK_RAD_RTS),
        baseline_rad=math.sqrt(2.0) * _CAMERA_PLACE_SIGMA_M / rig.baseline_m,
        lens=tuple(np.sqrt(pair_variances(airframe)).tolist()),
        yaw_bias_rad=_yaw_bias_rad(rig),
        bend_scale=_bend_scale_sigma(airframe),
        turn_rate_radps=airframe.root.gyro_bias_sigma_radps,
        systematic_rad=SYSTEMATIC_DOWN_RAD if airframe.looks_down else _SYSTEMATIC_AHEAD_RAD,
    )


def _bend_scale_sigma(airframe: Airframe) -> float:
    """Sigma of the relative error of the tracked fast bend: tip gyros (else accelerometers) and slope factor."""
    slope, tips = airframe.wing.symmetric.slope_factor_radpm, (airframe.left, airframe.right)
    scales = [tip.gyro_scale_sigma if "p" in tip.sends else tip.accel_scale_sigma for tip in tips]
    return math.hypot(0.5 * math.hypot(*scales), slope.sigma / slope.value)


def _yaw_bias_rad(rig: Rig) -> float:
    """Yaw, rad, whose parallax ``x y`` is :data:`_YAW_BIAS_PX` in the corner of the image."""
    lens = rig.left.lens
    width_px, height_px = lens.size_px
    return float(_YAW_BIAS_PX * lens.focal_px / (0.25 * width_px * height_px))

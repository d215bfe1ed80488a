"""Filter of the slow relative rotation of the cameras, driven by the epipolar geometry of matched features.

``epipolar_geometry`` has the parallax that the states leave, ``epipolar_states`` their order and priors, and
``epipolar_posterior`` the update by one pair. Equations and states: EXTRINSICS.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from companion.core.stereo.consistency_gate import KNOCK_RAD, MatchTest, MatchVerdict
from companion.core.stereo.epipolar_geometry import epipolar_frame, in_frame
from companion.core.stereo.epipolar_posterior import (
    FlowConditions,
    Posterior,
    innovation_of,
    joint_prior,
    maximum_a_posteriori,
    pair_turn_rad,
    with_bound_innovation,
    with_considered_states,
    with_flow,
)
from companion.core.stereo.epipolar_states import (
    BASELINE,
    BEND,
    BEND_SCALE,
    CONSIDERED_IN_FLOW_STATES,
    CONSIDERED_STATES,
    FAST,
    FLIGHT,
    LENS,
    NO_BEND,
    NO_SHIFT,
    PERSISTENT_STATES,
    SHIFT,
    SLOW_STATES,
    TURN_RATE,
    VELOCITY,
    BendBelief,
    ExtrinsicsPrior,
    FastBelief,
    rotation_rows,
    with_lens_rows,
)
from companion.core.stereo.exposure import rest_exposures
from companion.core.stereo.flow import FlowInnovation, FlowView
from companion.core.stereo.geometry import Rig
from companion.core.stereo.lens_residual import LensAxes, lens_ratio
from companion.core.stereo.rotation import without_negative_eigenvalues
from companion.core.stereo.triangulation import Rays
from companion.records import Floats, Reject

_CLEARLY_WORSE = 1.5  # ratio of variances that good lenses exceed in one flight of eight (choice)
_DOUBT = 2.0  # factor of variance by each pair whose flow contradicts: from eight sigma to four in two pairs (choice)
# ratio of variances, from the four sigma at which a flow is refused to ten (choice): a calibration wrong by more than
# that is useless, or the velocity is wrong, or the surface moves (waves, a ship)
_MOST_DOUBT = 6.25
_MIN_MATCHES = 12  # three for a rotation, and three times as many to find outliers by (choice)
# largest trace of SHIFT's covariance: a tenth of the baseline flown between the exposures (choice); more is singular
_MAX_SHIFT_RAD2 = 0.01
# in the test of an innovation: the tracker's fast error is neither white nor quite Gaussian (choice)
_FAST_VARIANCE_FACTOR = 3.0
_CONTRADICTION_NS = 2_000_000_000  # within so long the flow finds a changed toe again (choice)
# sigma of a turn above which the flow is linearised about it: half the square of twice as much shortens all slopes by
# 2e-6, a thousandth of a path's noise (choice)
_LINEAR_TURN_RAD = 1e-3
_TURN_ROUNDS = 2  # a turn of 0.1 rad is right to 1e-6 after them (choice)
_VELOCITY_TIME_S = 10.0  # correlation time of a navigation filter's velocity error (choice)


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarUpdate:
    """Relative rotation of the right camera beyond the tracked one, as rotation vectors in the epipolar frame.

    Attributes
    ----------
    slow_rad, slow_covariance : (3,), (3, 3) float64
        Pitch, yaw, roll of the slow part, that of the bend included: valid for the next pairs, too.
    total_rad, total_covariance : (3,), (3, 3) float64
        Slow part, and fast part and innovation of this pair: the correction of this pair.
    lens, joint_covariance : (9,), (12, 12) float64
        Terms of the lens residual; covariance of total rotation and lens terms together.
    parallax_scale : float
        Scatter of the parallaxes over their stated sigma, at least 1. It inflates every covariance.
    used : int
        Matches with at least half their weight.
    flow : int
        Features whose flow since an earlier pair was used.
    verdict : MatchVerdict
        Result of the test of the matches against the prediction.
    flow_contradicts : bool
        Whether the pair's flow was refused within two seconds of a flow that was used, or before any was used.
    """

    slow_rad: Floats
    slow_covariance: Floats
    total_rad: Floats
    total_covariance: Floats
    lens: Floats
    joint_covariance: Floats
    parallax_scale: float
    used: int
    flow: int
    verdict: MatchVerdict
    flow_contradicts: bool


class EpipolarFilter:
    """Iterated, robust Kalman filter of the slow relative rotation, one update per matched pair.

    The fast part comes from the wing tracker: the given rays contain its pose, and its error has the given covariance
    and correlation time. The slow part is an Ornstein-Uhlenbeck process.

    Each pair is solved with a free rotation of its own, the innovation. If the innovation agrees with zero, it is bound
    to zero. If it contradicts once, it stays with the pair (a wrong stamp). If the contradiction lasts, the slow part
    takes it (a turned camera): see :class:`~companion.core.stereo.consistency_gate.MatchTest`.
    """

    def __init__(self, rig: Rig, prior: ExtrinsicsPrior) -> None:
        self.epipolar_from_body = epipolar_frame(rig)
        self._rest_axes = LensAxes.exposed(rest_exposures(rig), self.epipolar_from_body)
        self._prior = prior
        self._mean = np.zeros(PERSISTENT_STATES)
        self._covariance = np.diag(self._first_variances())
        self._fast_covariance = np.zeros((3, 3))
        self._velocity_covariance = np.zeros((3, 3))
        self._bend_variance = 0.0
        self.lens_ratio = 1.0
        """Prior variance of the lens terms over the one that the calibration states."""
        self._updated_ns: int | None = None
        self._flow_used_ns: int | None = None
        self.flow_left_aside = False
        """Whether the flow was refused from the start, even by a calibration that is doubted as far as it may be."""
        self._test = MatchTest()
        self._systematic_rad2 = np.diag(prior.systematic_rad) ** 2

    @property
    def has_matches(self) -> bool:
        """Whether any matches have been taken."""
        return self._updated_ns is not None

    def reopen(self) -> None:
        """Add ``KNOCK_RAD`` squared to the variance about every axis: matches measure the rotation anew from now on."""
        self._covariance[:3, :3] += KNOCK_RAD**2 * np.eye(3)
        self._mean, self._velocity_covariance = self._mean.copy(), np.zeros((3, 3))
        self._forget_flight(self._mean, self._covariance, self._velocity_covariance)
        self._test = MatchTest()

    def _forget_flight(self, mean: Floats, covariance: Floats, velocity: Floats) -> None:
        """Set the errors of velocity and rates to their prior, in place: a wrong rotation has made them wrong."""
        mean[FLIGHT] = covariance[FLIGHT] = covariance[:, FLIGHT] = 0.0
        covariance[VELOCITY, VELOCITY] = velocity
        covariance[TURN_RATE, TURN_RATE] = self._prior.turn_rate_radps**2 * np.eye(3)

    def update(
        self,
        rays: Rays,
        sigma_rad: Floats,
        fast: FastBelief,
        t_host_ns: int,
        bend: BendBelief = NO_BEND,
        shift_covariance: Floats = NO_SHIFT,
        flow: FlowView | None = None,
        axes: LensAxes | None = None,
    ) -> EpipolarUpdate | Reject:
        """Update by the matches of one pair.

        Parameters
        ----------
        rays : Rays
            Matched rays in body axes, by the tracked bend (``triangulation.match_rays``).
        sigma_rad : (n,) float64
            One-sigma of each parallax.
        fast : FastBelief
            Error of the fast relative rotation by the tracker.
        t_host_ns : int
            Midway between both mid-exposures.
        bend : BendBelief
            Slow error of the tracked bend; none where the fast covariance contains all of it.
        shift_covariance : (2, 2) float64
            Covariance of this pair's own error of the baseline's direction, y and z, rad^2.
        flow : FlowView, optional
            Features that an earlier left image shows too.
        axes : LensAxes, optional
            Axes of both cameras by the tracked bend, body axes; at rest if not given.

        Returns
        -------
        EpipolarUpdate or Reject
            A Reject (too few matches, time backwards, not finite) leaves the filter unchanged.
        """
        refused = self._refuse(rays, sigma_rad, t_host_ns)
        if refused is not None:
            return refused
        velocity = self._velocity_covariance if flow is None else flow.velocity_covariance
        mean, predicted = self._predicted(t_host_ns, bend, fast, velocity)
        prior = joint_prior(predicted, shift_covariance / max(float(np.trace(shift_covariance)) / _MAX_SHIFT_RAD2, 1.0))
        epipolar_rays = in_frame(rays, self.epipolar_from_body)
        epipolar_axes = (axes or self._rest_axes).in_frame(self.epipolar_from_body)
        noise_rad = np.hypot(sigma_rad, self._prior.parallax_rad)
        answer, verdict = self._solved(epipolar_rays, epipolar_axes, noise_rad, fast, mean, prior, bend, velocity)
        contradicts = False
        if flow is not None and verdict is MatchVerdict.AGREE:
            answer, contradicts = self._flown(answer, flow, bend, t_host_ns)
        self._mean, self._updated_ns = answer.mean[:PERSISTENT_STATES], t_host_ns
        self._covariance = answer.covariance[:PERSISTENT_STATES, :PERSISTENT_STATES]
        self._bend_variance, self._fast_covariance = bend.sigma_rad**2, fast.covariance
        self._velocity_covariance = velocity
        self._doubt_lenses()
        return _describe(answer, bend, verdict, contradicts)

    def _solved(
        self,
        epipolar_rays: Rays,
        axes: LensAxes,
        noise_rad: Floats,
        fast: FastBelief,
        mean: Floats,
        prior: Floats,
        bend: BendBelief,
        velocity: Floats,
    ) -> tuple[Posterior, MatchVerdict]:
        """Posterior of one pair, its innovation bound by what the test grants, and the test's verdict."""
        answer = maximum_a_posteriori(epipolar_rays, axes, noise_rad, mean, prior, bend)
        tested = innovation_of(answer).loosened(
            self._systematic_rad2 + _FAST_VARIANCE_FACTOR * fast.covariance + fast.stamps
        )
        verdict, granted_rad2 = self._test.take(tested)
        if verdict is MatchVerdict.KNOCKED:
            prior[:3, :3] += KNOCK_RAD**2 * np.eye(3)
            self._forget_flight(mean, prior, velocity)
            answer = maximum_a_posteriori(epipolar_rays, axes, noise_rad, mean, prior, bend)
        bound = with_bound_innovation(answer, granted_rad2 + fast.stamps)
        return with_considered_states(bound, mean, prior, CONSIDERED_STATES), verdict

    def _flown(self, answer: Posterior, flow: FlowView, bend: BendBelief, t_host_ns: int) -> tuple[Posterior, bool]:
        """Posterior after the flow, and whether the flow contradicts within two seconds of one that was used.

        A flow that contradicts for longer means a velocity that has become wrong; it is not used. If no flow was ever
        used, the keystone may be wrong, which matches cannot tell from toe: each such pair doubles all variances, up to
        :data:`_MOST_DOUBT`. A flow that contradicts even then stays a contradiction, and is not used.
        """
        between = flow.between
        conditions = FlowConditions(between.passed_s, flow.turn_covariance, bend, between.stamp_sigma_s)
        innovation = flow_innovation(answer, flow, conditions)
        if not innovation.is_enough:
            return answer, False
        updated = with_flow(answer, innovation, conditions)
        if updated is None:
            used_ns = self._flow_used_ns
            if used_ns is not None:
                return answer, t_host_ns - used_ns <= _CONTRADICTION_NS
            if self.lens_ratio >= _MOST_DOUBT:
                self.flow_left_aside = True
                return answer, True
            self.lens_ratio *= _DOUBT
            return replace(answer, covariance=_DOUBT * answer.covariance), True
        self._flow_used_ns, self.flow_left_aside = t_host_ns, False
        return with_considered_states(updated, answer.mean, answer.covariance, CONSIDERED_IN_FLOW_STATES), False

    def _doubt_lenses(self) -> None:
        """Inflate the covariance if the observed lens terms are larger than their prior allows.

        All lens terms come from one calibration. The error of the mean is linear in errors of priors and noise, with
        gains of past updates. Had the priors of the lenses been wider by a factor, the covariance would be at most that
        factor times what it is. So later pairs have more weight.
        """
        lens = self._covariance[LENS, LENS]
        ratio = lens_ratio(self._mean[LENS], lens, np.array(self._prior.lens) ** 2, self.lens_ratio)
        if ratio > _CLEARLY_WORSE * self.lens_ratio:
            self._covariance, self.lens_ratio = ratio / self.lens_ratio * self._covariance, ratio

    def _first_variances(self) -> Floats:
        """Variances of the persistent states before any pair; each pair sets those of bend, fast part and velocity."""
        prior, none = self._prior, [0.0] * 3
        constants = [prior.yaw_bias_rad**2, prior.bend_scale**2]
        return np.array([*prior.variances(), 0.0, *constants, *none, *none, *[prior.turn_rate_radps**2] * 3])

    def predict(self, t_host_ns: int, bend: BendBelief = NO_BEND) -> tuple[Floats, Floats]:
        """Rotation and lens terms (12,) and their covariance (12, 12) at a time at or after the last update.

        The rotation consists of the slow part and the error of scale. It has no fast part of a pair.
        """
        mean, covariance = self._predicted(t_host_ns, bend, FastBelief(np.zeros((3, 3))), self._velocity_covariance)
        gather = with_lens_rows(rotation_rows(bend))[:, :SLOW_STATES]
        return gather @ mean[:SLOW_STATES], gather @ covariance[:SLOW_STATES, :SLOW_STATES] @ gather.T

    def _predicted(self, t_host_ns: int, bend: BendBelief, fast: FastBelief, velocity: Floats) -> tuple[Floats, Floats]:
        """Mean and covariance before the pair: the rotation walks, the bend's error shrinks as the tracker learns.

        The tracker's error after learning is independent of the part ``1 - s1^2/s0^2`` of its variance that it has
        learned. So mean and deviations shrink by ``k = s1^2/s0^2``, and noise of variance ``s1^2 - k^2 s0^2`` is added.
        """
        first = self._updated_ns is None
        passed_s = 0.0 if self._updated_ns is None else max(t_host_ns - self._updated_ns, 0) * 1e-9
        keep = np.ones(PERSISTENT_STATES)
        keep[:3] = np.exp(-passed_s / self._prior.time_s)
        before, now = self._bend_variance, bend.sigma_rad**2
        learnt = 0.0 if first or before <= 0.0 else min(now / before, 1.0)
        keep[BEND] = learnt * np.exp(-passed_s / bend.time_s)
        fresh = np.zeros(PERSISTENT_STATES)
        fresh[:3] = (1.0 - keep[:3] ** 2) * self._prior.rotation_rad**2
        fresh[BEND] = now - keep[BEND] ** 2 * before
        before_fast, now_fast = float(np.trace(self._fast_covariance)), float(np.trace(fast.covariance))
        if fast.time_s > 0.0 and before_fast > 0.0:
            keep[FAST] = min(now_fast / before_fast, 1.0) * np.exp(-passed_s / fast.time_s)
        else:
            keep[FAST] = 0.0
        keep[VELOCITY] = np.exp(-passed_s / _VELOCITY_TIME_S)
        covariance = self._covariance * np.outer(keep, keep) + np.diag(fresh)
        covariance[FAST, FAST] += without_negative_eigenvalues(
            fast.covariance - keep[SLOW_STATES] ** 2 * self._fast_covariance
        )
        covariance[VELOCITY, VELOCITY] += without_negative_eigenvalues(
            velocity - keep[VELOCITY.start] ** 2 * self._velocity_covariance
        )
        return keep * self._mean, covariance

    def _refuse(self, rays: Rays, sigma_rad: Floats, t_host_ns: int) -> Reject | None:
        if len(sigma_rad) < _MIN_MATCHES:
            return Reject.NO_MATCHES
        if self._updated_ns is not None and t_host_ns < self._updated_ns:
            return Reject.TIME_BACKWARDS
        arrays = (rays.left_m, rays.left, rays.right_m, rays.right, sigma_rad)
        return None if all(bool(np.all(np.isfinite(array))) for array in arrays) else Reject.NOT_FINITE


def flow_innovation(answer: Posterior, flow: FlowView, conditions: FlowConditions) -> FlowInnovation:
    """Innovation of a flow, linear about the posterior and, where that may be large, about the pair's own turn."""
    mean = answer.mean
    sound = flow.without(answer.outlier)
    states = (
        rotation_rows(conditions.bend) @ mean,
        mean[LENS],
        mean[VELOCITY],
        conditions.passed_s * mean[TURN_RATE],
        mean[BASELINE] + mean[SHIFT],
    )
    innovation = sound.innovation(*states)
    may_be_large = float(np.trace(conditions.turn_covariance)) > _LINEAR_TURN_RAD**2
    for _ in range(_TURN_ROUNDS if may_be_large and innovation.is_enough else 0):
        innovation = sound.innovation(*states, pair_turn_rad(answer, innovation, conditions))
    return innovation


def _describe(answer: Posterior, bend: BendBelief, verdict: MatchVerdict, flow_contradicts: bool) -> EpipolarUpdate:
    total = rotation_rows(bend)
    slow = total.copy()
    slow[:, BEND_SCALE:] = 0.0
    joint = with_lens_rows(total)
    return EpipolarUpdate(
        slow_rad=slow @ answer.mean,
        slow_covariance=slow @ answer.covariance @ slow.T,
        total_rad=total @ answer.mean,
        total_covariance=total @ answer.covariance @ total.T,
        lens=answer.mean[LENS],
        joint_covariance=joint @ answer.covariance @ joint.T,
        parallax_scale=answer.scale,
        used=answer.used,
        flow=answer.flow,
        verdict=verdict,
        flow_contradicts=flow_contradicts,
    )

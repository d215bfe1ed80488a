"""The slow part of the cameras' relative rotation, from the epipolar geometry of matched features, with covariance.

In the epipolar frame (x along the baseline, z where the cameras look, y across) matched rays have equal slopes y when
the extrinsics are true. A right camera that is really turned by ``phi`` beyond what is believed, and a baseline that
really points to ``(1, b_y, b_z)``, leave the parallax

    ``y_l - y_r = -phi_x (1 + y^2) + phi_y x y + phi_z x + b_y d + b_z (x_r y_l - y_r x_l)``,   ``d = x_l - x_r``

so pitch ``phi_x`` and roll ``phi_z`` are seen strongly, yaw ``phi_y`` only through ``x y``, and the baseline only
through depth that varies. Yaw is the toe that falsifies ranges; its covariance tells how weakly a picture shows it.
What a calibration left in the two lenses is carried as six constants with a prior; see
:mod:`companion.core.stereo.lens_residual`.

The wing tracker's own slow error (trim bend, tilt bias) turns the cameras about one known axis; it is a state of its
own, so that what the accelerometers know of it counts, and only that: see :class:`BendBelief`. An error of scale of the
tracker (gyros, slope factor) turns them by a constant share of the fast bend: another state, that pairs teach together.

Matches of one pair, and of pairs that follow each other, share errors: interpolation, lenses and blur leave hundredths
of a pixel that stay in their places. Across the lines they look like a yaw that is none. That false yaw is a constant
state of its own, seen with the true one and never told apart from it by any number of pairs.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from companion.core.stereo.consistency_gate import KNOCK_RAD, Innovation, MatchTest, MatchVerdict
from companion.core.stereo.geometry import Rig
from companion.core.stereo.lens_residual import CONSIDERED, OBSERVED, PAIR_TERMS, lens_ratio, parallax_columns
from companion.core.stereo.rotation import exp_rotation
from companion.core.stereo.triangulation import Rays
from companion.records import Floats, Reject

PITCH, YAW, ROLL, BASELINE_Y, BASELINE_Z = range(5)
_BASELINE = slice(BASELINE_Y, BASELINE_Z + 1)
_PARALLAX_STATES = BASELINE_Z + 1 + PAIR_TERMS  # states that the parallax has a column of its own for
_LENS = slice(BASELINE_Z + 1, _PARALLAX_STATES)
_CONSIDERED = [_LENS.start + term for term in CONSIDERED]
BEND, YAW_BIAS, BEND_SCALE = range(_PARALLAX_STATES, _PARALLAX_STATES + 3)
_SLOW = BEND_SCALE + 1  # states of the slow part
_PERSISTENT = _SLOW + 3  # with the error of the fast part: states that stay from pair to pair
_ALL = _PERSISTENT + 5  # with this pair's error of the baseline's direction, and its innovation
_FAST, _SHIFT = slice(_SLOW, _PERSISTENT), slice(_PERSISTENT, _PERSISTENT + 2)
_INNOVATION = slice(_PERSISTENT + 2, _ALL)
_CLEARLY_WORSE = 1.5  # chosen: good lenses look so much worse than they are in one flight of eight
_MIN_MATCHES = 12  # three of a rotation, and three times as many to tell outliers by (choice)
_GAUSS_NEWTON_STEPS = 10  # steps of the reweighted solution (choice)
# degrees of freedom of the matches' errors: outliers fade, good matches keep nearly all their weight
_STUDENT_DOF = 5.0
_MAD_TO_SIGMA = 1.4826  # of a Gaussian (derived)
_VARIANCE_FLOOR_RAD2 = 1e-17  # rad^2: what is known exactly has a finite information
# trace for a pair's own baseline: a tenth of its length flown between exposures (choice); far more is singular
_MAX_SHIFT_RAD2 = 0.01
# the tracker's fast error is neither white nor quite Gaussian: it counts twice its sigma in tests
_FAST_VARIANCE_FACTOR = 3.0
# share of the knock's prior that stays, so that a rotation which no match sees has a finite sigma too
_PRIOR_REMAINDER = 1e-3


SYSTEMATIC_DOWN_RAD = (1e-4, 3e-4, 1e-4)
"""Pitch, yaw and roll that a rendered pair over ground shows for seconds without having turned, rad (1 sigma)."""


DEFAULT_LENS = (0.0007, 0.002, 0.0006, 0.0006, 0.00024, 0.00024, 0.001)
"""Sigma of the difference of two lenses that were calibrated as the defaults of an airframe's camera say."""


@dataclass(frozen=True, slots=True)
class ExtrinsicsPrior:
    """Prior of the slow relative rotation and of the lenses' differences, before any picture.

    Attributes
    ----------
    rotation_rad : float
        Sigma of each axis, at the start and after a long time unseen: thermal set, mounting, what no model has.
    walk_rad_rts : float
        How fast it wanders, per square root of a second; it is pulled back so that its sigma stays ``rotation_rad``.
    baseline_rad : float
        Sigma of the baseline's direction, a constant: mounting, static bend that differs between the wings, keystone
        that both lenses share.
    lens : tuple of float
        Sigma of each term of the lens residual, in the order of ``lens_residual``; constants.
    yaw_bias_rad : float
        Sigma of the yaw that errors common to all pairs make up; a constant.
    bend_scale : float
        Sigma of the relative error of the tracked bend's fast part; a constant of a flight.
    parallax_rad : float
        What slanted surfaces and lens models leave in every single match, beyond its stated sigma.
    systematic_rad : tuple of float
        Pitch, yaw and roll that interpolation, lenses, slopes and the cameras' places feign for seconds: no knock.
    """

    rotation_rad: float = 0.005
    walk_rad_rts: float = 0.0005
    baseline_rad: float = 0.001
    lens: tuple[float, ...] = DEFAULT_LENS
    yaw_bias_rad: float = 0.0
    bend_scale: float = 0.0
    parallax_rad: float = 0.00005
    systematic_rad: tuple[float, float, float] = SYSTEMATIC_DOWN_RAD

    def variances(self) -> Floats:
        """Diagonal (12,) of the first covariance, bend and steady error left out."""
        sigmas = [self.rotation_rad] * 3 + [self.baseline_rad] * 2 + list(self.lens)
        return np.array(sigmas, dtype=np.float64) ** 2

    @property
    def time_s(self) -> float:
        """Correlation time of the rotation: an Ornstein-Uhlenbeck process with this sigma and walk."""
        return 2.0 * (self.rotation_rad / max(self.walk_rad_rts, 1e-12)) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class BendBelief:
    """Errors of the wing tracker that last, slopes common to both tips: slow error, and one of scale.

    Attributes
    ----------
    direction : (3,) float64
        Relative rotation per radian of that slope, in the epipolar frame.
    sigma_rad : float
        Of the slope, now.
    time_s : float
        How long the error stays what it is: that of the inertial biases.
    fast_rad : float
        The fast part of the tracked slope: an error of scale turns the cameras by a constant share of it.
    """

    direction: Floats
    sigma_rad: float
    time_s: float
    fast_rad: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class FastBelief:
    """Error of the wing tracker's fast part: a process of first order.

    Attributes
    ----------
    covariance : (3, 3) float64
        Of pitch, yaw, roll in the epipolar frame, now; rad^2.
    time_s : float
        Correlation time; 0: independent from pair to pair.
    """

    covariance: Floats
    time_s: float = 0.0


NO_BEND = BendBelief(np.zeros(3), 0.0, 1000.0)
NO_SHIFT = np.zeros((2, 2))


@dataclass(frozen=True, slots=True, eq=False)
class EpipolarUpdate:
    """Relative rotation of the right camera beyond the believed one, as vectors in the epipolar frame.

    Attributes
    ----------
    slow_rad, slow_covariance : (3,), (3, 3) float64
        Pitch, yaw, roll of the slow part alone, the bend's included: what to carry to the next pair.
    total_rad, total_covariance : (3,), (3, 3) float64
        Slow part and this pair's error of the fast part: what to correct this pair by.
    lens, joint_covariance : (7,), (10, 10) float64
        Terms of the lens residual; covariance of total rotation and lens terms together.
    baseline_rad : (2,) float64
        Error of the baseline's direction toward y and z.
    parallax_scale : float
        How much larger than their stated sigma the parallaxes are; at least 1, and paid for in every covariance.
    used : int
        Matches with at least half their weight.
    verdict : MatchVerdict
        Whether the matches go with what was believed before them.
    """

    slow_rad: Floats
    slow_covariance: Floats
    total_rad: Floats
    total_covariance: Floats
    lens: Floats
    joint_covariance: Floats
    baseline_rad: Floats
    parallax_scale: float
    used: int
    verdict: MatchVerdict


class EpipolarFilter:
    """Iterated, robust Kalman filter of the slow relative rotation, one update per matched pair.

    The fast part comes from the wing tracker: its pose is in the rays that are given, its error has the covariance and
    the correlation time that are given. The slow part walks at random.

    Each pair is solved with a rotation of its own that may be anything, the innovation. Where it goes with zero, it is
    set to zero again; where it contradicts, the pair has it (a stamp that is wrong), and where the contradiction stays
    the slow part has it (a camera that was knocked): see :class:`~companion.core.stereo.consistency_gate.MatchTest`.
    """

    def __init__(self, rig: Rig, prior: ExtrinsicsPrior) -> None:
        self.epipolar_from_body = epipolar_frame(rig)
        self._prior = prior
        self._mean = np.zeros(_PERSISTENT)
        self._covariance = np.diag(self._first_variances())
        self._fast_covariance = np.zeros((3, 3))
        self._bend_variance = 0.0
        self.lens_ratio = 1.0
        """Prior variance of the considered lens terms over the stated one."""
        self._updated_ns: int | None = None
        self._test = MatchTest()
        self._systematic_rad2 = np.diag(prior.systematic_rad) ** 2

    @property
    def has_matches(self) -> bool:
        """Whether any matches have been taken."""
        return self._updated_ns is not None

    def reopen(self, sigma_rad: float = KNOCK_RAD) -> None:
        """Doubt the rotation about every axis by a sigma more: only what matches tell from now on counts."""
        self._covariance[:3, :3] += sigma_rad**2 * np.eye(3)
        self._test = MatchTest()

    def update(
        self,
        rays: Rays,
        sigma_rad: Floats,
        fast: FastBelief,
        t_host_ns: int,
        bend: BendBelief = NO_BEND,
        shift_covariance: Floats = NO_SHIFT,
    ) -> EpipolarUpdate | Reject:
        """Take the matches of one pair.

        Parameters
        ----------
        rays : Rays
            Matched rays in body axes, by the believed fast part (``triangulation.match_rays``).
        sigma_rad : (n,) float64
            One-sigma of each parallax.
        fast : FastBelief
            Error of the believed fast relative rotation.
        t_host_ns : int
            Mid-exposure.
        bend : BendBelief
            Slow error of the believed bend; none where the fast covariance has it all.
        shift_covariance : (2, 2) float64
            Of this pair's own baseline direction, y and z: flight between the exposures.

        Returns
        -------
        EpipolarUpdate, or the Reject (too few matches, time backwards, not finite); then nothing has changed.
        """
        refused = self._refuse(rays, sigma_rad, t_host_ns)
        if refused is not None:
            return refused
        mean, predicted = self._predicted(t_host_ns, bend, fast)
        epipolar_rays = in_frame(rays, self.epipolar_from_body)
        noise_rad = np.hypot(sigma_rad, self._prior.parallax_rad)
        prior = _joint(predicted, shift_covariance / max(float(np.trace(shift_covariance)) / _MAX_SHIFT_RAD2, 1.0))
        answer = _solve(epipolar_rays, noise_rad, mean, prior, bend)
        verdict, granted_rad2 = self._test.take(
            _innovation(answer).loosened(self._systematic_rad2 + _FAST_VARIANCE_FACTOR * fast.covariance)
        )
        if verdict is MatchVerdict.KNOCKED:
            prior[:3, :3] += KNOCK_RAD**2 * np.eye(3)
            answer = _solve(epipolar_rays, noise_rad, mean, prior, bend)
        answer = _considered(_bound(answer, granted_rad2), mean, prior)
        self._mean, self._covariance, self._updated_ns = (
            answer.mean[:_PERSISTENT],
            answer.covariance[:_PERSISTENT, :_PERSISTENT],
            t_host_ns,
        )
        self._bend_variance, self._fast_covariance = bend.sigma_rad**2, fast.covariance
        self._doubt_lenses()
        return _describe(answer, bend, verdict)

    def _doubt_lenses(self) -> None:
        """Begin again with wider priors of the considered lens terms where the observed ones are wrong by more.

        What matches told of the toe was weighed against lenses that were taken for better. The observed lens terms
        remain known.
        """
        lens = self._covariance[_LENS, _LENS]
        ratio = lens_ratio(self._mean[_LENS], lens, np.array(self._prior.lens) ** 2)
        if ratio > _CLEARLY_WORSE * self.lens_ratio:
            mean, observed = np.zeros(_PERSISTENT), [_LENS.start + term for term in OBSERVED]
            mean[observed] = self._mean[observed]
            variances = self._first_variances()
            variances[_CONSIDERED] *= ratio
            variances[observed] = np.diag(self._covariance)[observed]
            self._mean, self._covariance, self.lens_ratio = mean, np.diag(variances), ratio
            self._bend_variance, self._fast_covariance = 0.0, np.zeros((3, 3))

    def _first_variances(self) -> Floats:
        """Variances (18,) of the states before any pair; those of bend and fast part come with each pair."""
        prior = self._prior
        return np.array([*prior.variances(), 0.0, prior.yaw_bias_rad**2, prior.bend_scale**2, 0.0, 0.0, 0.0])

    def predict(self, t_host_ns: int, bend: BendBelief = NO_BEND) -> tuple[Floats, Floats]:
        """Rotation and lens terms (10,) and their covariance (10, 10) at a time at or after the last update.

        The rotation is slow part and error of scale; this pair's own fast part is not in it.
        """
        mean, covariance = self._predicted(t_host_ns, bend, FastBelief(np.zeros((3, 3))))
        gather = _with_lens(_gather(bend))[:, :_SLOW]
        return gather @ mean[:_SLOW], gather @ covariance[:_SLOW, :_SLOW] @ gather.T

    def _predicted(self, t_host_ns: int, bend: BendBelief, fast: FastBelief) -> tuple[Floats, Floats]:
        """Mean and covariance before the pair: the rotation wanders, the bend's error shrinks as the tracker learns.

        The tracker's next error is independent of what it learns until then, so of the part ``1 - s1^2/s0^2`` that it
        learns nothing is left: mean and deviations shrink by ``s1^2/s0^2``, and its own sigma fills the rest.
        """
        first = self._updated_ns is None
        passed_s = 0.0 if self._updated_ns is None else max(t_host_ns - self._updated_ns, 0) * 1e-9
        keep = np.ones(_PERSISTENT)
        keep[:3] = np.exp(-passed_s / self._prior.time_s)
        before, now = self._bend_variance, bend.sigma_rad**2
        learnt = 0.0 if first or before <= 0.0 else min(now / before, 1.0)
        keep[BEND] = learnt * np.exp(-passed_s / bend.time_s)
        fresh = np.zeros(_PERSISTENT)
        fresh[:3] = (1.0 - keep[:3] ** 2) * self._prior.rotation_rad**2
        fresh[BEND] = now - keep[BEND] ** 2 * before
        before_fast, now_fast = float(np.trace(self._fast_covariance)), float(np.trace(fast.covariance))
        if fast.time_s > 0.0 and before_fast > 0.0:
            keep[_FAST] = min(now_fast / before_fast, 1.0) * np.exp(-passed_s / fast.time_s)
        else:
            keep[_FAST] = 0.0
        covariance = self._covariance * np.outer(keep, keep) + np.diag(fresh)
        covariance[_FAST, _FAST] += _positive(fast.covariance - keep[_SLOW] ** 2 * self._fast_covariance)
        return keep * self._mean, covariance

    def _refuse(self, rays: Rays, sigma_rad: Floats, t_host_ns: int) -> Reject | None:
        if len(sigma_rad) < _MIN_MATCHES:
            return Reject.NO_MATCHES
        if self._updated_ns is not None and t_host_ns < self._updated_ns:
            return Reject.TIME_BACKWARDS
        arrays = (rays.left_m, rays.left, rays.right_m, rays.right, sigma_rad)
        return None if all(bool(np.all(np.isfinite(array))) for array in arrays) else Reject.NOT_FINITE


def epipolar_frame(rig: Rig) -> Floats:
    """Rotation (3, 3) from body axes to the rig's epipolar frame at rest."""
    apart = rig.right.rest.position_body_m - rig.left.rest.position_body_m
    x = apart / np.linalg.norm(apart)
    look = rig.left.rest.camera_from_body[2] + rig.right.rest.camera_from_body[2]
    z = look - (look @ x) * x
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z])


def in_frame(rays: Rays, frame_from_body: Floats) -> Rays:
    """Express rays in another frame."""
    arrays = (rays.left_m, rays.left, rays.right_m, rays.right)
    return Rays(*(np.asarray(array @ frame_from_body.T, dtype=np.float64) for array in arrays))


def with_right_rotated(rays: Rays, rotation_rad: Floats, epipolar_from_body: Floats) -> Rays:
    """Rays in body axes with the right ones turned by a rotation vector of the epipolar frame."""
    turn = epipolar_from_body.T @ exp_rotation(rotation_rad) @ epipolar_from_body
    return Rays(rays.left_m, rays.left, rays.right_m, rays.right @ turn.T)


def parallax(epipolar_rays: Rays, state: Floats) -> tuple[Floats, Floats]:
    """Parallax (n,) that a state (12,) leaves, and how it falls with each of its entries (n, 12).

    Parameters
    ----------
    epipolar_rays : Rays
        Matched rays in the epipolar frame.
    state : (12,) float64
        Pitch, yaw, roll of the right camera in all, baseline y and z, terms of the lens residual.
    """
    left, right = epipolar_rays.left, epipolar_rays.right @ exp_rotation(state[:3]).T
    x_l, y_l = left[:, 0] / left[:, 2], left[:, 1] / left[:, 2]
    x_r, y_r = right[:, 0] / right[:, 2], right[:, 1] / right[:, 2]
    apart = epipolar_rays.right_m - epipolar_rays.left_m
    toward = apart[:, 1:] / apart[:, :1] + state[_BASELINE]
    disparity, twisted = x_l - x_r, x_r * y_l - y_r * x_l
    lens = parallax_columns(np.column_stack([x_l, y_l]), np.column_stack([x_r, y_r]))
    residual_rad = y_l - y_r - toward[:, 0] * disparity - toward[:, 1] * twisted - lens @ state[_LENS]
    columns = np.stack([-(1.0 + y_r**2), x_r * y_r, x_r, disparity, twisted], axis=1)
    return residual_rad, np.concatenate([columns, lens], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Posterior:
    mean: Floats
    covariance: Floats
    scale: float
    used: int


def _positive(covariance: Floats) -> Floats:
    """Covariance (3, 3) without its negative eigenvalues."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def _joint(persistent_covariance: Floats, shift_covariance: Floats) -> Floats:
    """Covariance of what stays from pair to pair, this pair's baseline and innovation, before a pair."""
    joint = np.zeros((_ALL, _ALL))
    joint[:_PERSISTENT, :_PERSISTENT] = persistent_covariance
    joint[_SHIFT, _SHIFT], joint[_INNOVATION, _INNOVATION] = shift_covariance, KNOCK_RAD**2 * np.eye(3)
    return joint


def _solve(epipolar_rays: Rays, sigma_rad: Floats, carried: Floats, covariance: Floats, bend: BendBelief) -> _Posterior:
    """Maximum a posteriori by Gauss-Newton; bend, fast part and innovation add to the first three."""
    mean = np.concatenate([carried, np.zeros(_ALL - _PERSISTENT)])
    gather = _gather(bend)
    gather[YAW, YAW_BIAS] = 1.0
    prior_information = np.linalg.inv(covariance + _VARIANCE_FLOOR_RAD2 * np.eye(len(mean)))
    state, scale = mean.copy(), 1.0
    weight, information = np.ones(len(sigma_rad)), prior_information
    for _ in range(_GAUSS_NEWTON_STEPS):
        total = np.concatenate([gather @ state, state[3:_PARALLAX_STATES]])
        total[_BASELINE] += state[_SHIFT]
        residual_rad, columns = parallax(epipolar_rays, total)
        design = columns[:, :3] @ gather
        design[:, 3:_PARALLAX_STATES], design[:, _SHIFT] = columns[:, 3:], columns[:, _BASELINE]
        # the first rounds see the rotation itself and take it for noise; as it shrinks, outliers come to stand alone
        unit = residual_rad / sigma_rad
        scale = max(_MAD_TO_SIGMA * float(np.median(np.abs(unit))), 1.0)
        unit = unit / scale
        weight = (_STUDENT_DOF + 1.0) / (_STUDENT_DOF + unit**2)
        weighted = design * (np.minimum(weight, 1.0) / (scale * sigma_rad))[:, np.newaxis]
        # Fisher information counts weighted squares, the pull counts weighted residuals
        information = prior_information + weighted.T @ (design / (scale * sigma_rad)[:, np.newaxis])
        pull = weighted.T @ unit + prior_information @ (mean - state)
        state = state + np.linalg.solve(information, pull)
    return _Posterior(state, np.linalg.inv(information), scale, int(np.sum(weight > 0.5)))


def _innovation(answer: _Posterior) -> Innovation:
    """Innovation with its own prior taken out: zero within its covariance, if all is well."""
    information = np.linalg.inv(answer.covariance[_INNOVATION, _INNOVATION])
    pull = information @ answer.mean[_INNOVATION]
    covariance = np.asarray(
        np.linalg.inv(information - (1.0 - _PRIOR_REMAINDER) / KNOCK_RAD**2 * np.eye(3)), dtype=np.float64
    )
    return Innovation(np.asarray(covariance @ pull, dtype=np.float64), covariance)


def _bound(answer: _Posterior, granted_rad2: Floats) -> _Posterior:
    """The answer with ``doubt`` (3, 3) in place of the innovation's wide prior: zero binds it to what is believed."""
    block, innovation = answer.covariance[_INNOVATION, _INNOVATION], _innovation(answer)
    gain = np.linalg.solve(innovation.covariance + granted_rad2, granted_rad2).T
    mean, covariance = gain @ innovation.rotation_rad, granted_rad2 - gain @ granted_rad2
    follow = np.linalg.solve(block, answer.covariance[_INNOVATION]).T
    return dataclasses.replace(
        answer,
        mean=answer.mean + follow @ (mean - answer.mean[_INNOVATION]),
        covariance=answer.covariance + follow @ (covariance - block) @ follow.T,
    )


def _considered(answer: _Posterior, mean: Floats, prior: Floats) -> _Posterior:
    """The answer with the considered states as they were before (Schmidt 1966); the others have the best gain."""
    after, covariance = answer.mean.copy(), answer.covariance.copy()
    after[_CONSIDERED] = mean[_CONSIDERED]
    block = np.ix_(_CONSIDERED, _CONSIDERED)
    covariance[block] = prior[block]
    return dataclasses.replace(answer, mean=after, covariance=covariance)


def _gather(bend: BendBelief) -> Floats:
    """Rows (3, all states) that add up the relative rotation: slow part, fast part and innovation."""
    rows = np.zeros((3, _ALL))
    rows[:, :3] = rows[:, _FAST] = rows[:, _INNOVATION] = np.eye(3)
    rows[:, BEND], rows[:, BEND_SCALE] = bend.direction, bend.fast_rad * bend.direction
    return rows


def _with_lens(rotation: Floats) -> Floats:
    """Rows that give the lens terms, below those that add up a rotation."""
    return np.concatenate([rotation, np.eye(rotation.shape[1])[_LENS]])


def _describe(answer: _Posterior, bend: BendBelief, verdict: MatchVerdict) -> EpipolarUpdate:
    total = _gather(bend)
    slow = total.copy()
    slow[:, BEND_SCALE:] = 0.0
    joint = _with_lens(total)
    return EpipolarUpdate(
        slow_rad=slow @ answer.mean,
        slow_covariance=slow @ answer.covariance @ slow.T,
        total_rad=total @ answer.mean,
        total_covariance=total @ answer.covariance @ total.T,
        lens=answer.mean[_LENS],
        joint_covariance=joint @ answer.covariance @ joint.T,
        baseline_rad=answer.mean[_BASELINE],
        parallax_scale=answer.scale,
        used=answer.used,
        verdict=verdict,
    )

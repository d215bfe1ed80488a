"""Toe from known motion: features of two left images, and the velocity over ground and rates between them.

The autopilot measures its velocity over ground and its rates. A feature whose ray is ``r`` in the later left image and
whose inverse depth is ``s`` (1/m) there lies in the earlier left camera along

    ``R r + s T``,   ``R = C_0 Q C_1'``,   ``T = C_0 (Q p_1 + m - p_0)``

with the poses ``C, p`` of the left camera in the body axes of the earlier (0) and the later (1) exposure, the body's
turn ``Q`` and its path ``m`` between them. Stereo gives ``s`` up to the toe (``ds = dtheta/baseline``), the images give
the direction. Flown at 22 m/s for 0.15 s, a feature at 60 m moves by 55 mrad. So a velocity that is right to 1.4 %
bounds the toe to 0.5 mrad there, and the range to 1.4 % at any distance, independent of the lens residuals.
Equations and limits: FLOW.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from companion.core.stereo.geometry import Pose
from companion.core.stereo.lens_residual import (
    PAIR_TERMS,
    LensAxes,
    left_fields,
    left_terms,
    quarter_turns,
    straightened,
)
from companion.core.stereo.rotation import exp_rotation, skew
from companion.core.stereo.triangulation import RangeAxis, Rays, triangulate
from companion.records import Bools, Floats, Ints

LONGEST_NS = 600_000_000
"""Longest time between two left images: after more a feature has left the picture (choice)."""
LEAST_FLOW = 12
"""Fewest features for a rotation, a velocity and the toe (choice)."""
_STEP = 1e-6  # step of the difference quotients, rad or unit of a term (numerical)
_NONE: Floats = np.zeros(3)
_STRAIGHT: Floats = np.zeros(2)


@dataclass(frozen=True, slots=True, eq=False)
class FlowInnovation:
    """Places of m features in the earlier image, observed less predicted, as ray slopes.

    Rows 2i and 2i + 1 belong to feature i: along its image path, and across it.

    Attributes
    ----------
    residual_rad, sigma_rad : (2m,) float64
        Residual as a slope, and its one-sigma by matching.
    rotation : (2m, 3) float64
        Change of the prediction per radian of relative rotation, epipolar axes, through the inverse depth alone. The
        half turn of the left camera's own axes is left out: under 2 % of the yaw's column, but 30 % and more of those
        of pitch and roll, which hardly change the inverse depth.
    lens : (2m, 9) float64
        Change per unit of each term of the pair's lens residual.
    baseline : (2m, 2) float64
        Change per radian of the baseline's direction, along the epipolar frame's y and z.
    turn : (2m, 3) float64
        Change per radian of error of the body's turn, a rotation vector in epipolar axes, about the left camera: its
        way from the body's origin, of the place's inverse depth, is left out.
    velocity : (2m, 3) float64
        Change per m/s of error of the velocity, epipolar axes.
    stamps : (2m, 2) float64
        Change per second by which the earlier and the later exposure were later than stamped.
    """

    residual_rad: Floats
    sigma_rad: Floats
    rotation: Floats
    lens: Floats
    baseline: Floats
    turn: Floats
    velocity: Floats
    stamps: Floats

    @property
    def columns(self) -> Floats:
        """Change of the prediction (2m, 22) by rotation, lens, baseline, turn, velocity and stamps."""
        return np.concatenate([self.rotation, self.lens, self.baseline, self.turn, self.velocity, self.stamps], axis=1)

    @property
    def finite(self) -> Bools:
        """Mask (2m,) of the rows of features both of whose rows are finite."""
        measured = np.isfinite(self.residual_rad) & np.isfinite(self.sigma_rad) & np.isfinite(self.columns).all(axis=1)
        return np.repeat(measured.reshape(-1, 2).all(axis=1), 2)

    @property
    def is_enough(self) -> bool:
        """Whether at least :data:`LEAST_FLOW` features are finite."""
        return int(np.count_nonzero(self.finite)) >= 2 * LEAST_FLOW


@dataclass(frozen=True, slots=True, eq=False)
class FlightBetween:
    """The body's motion from the earlier to the later exposure of the left camera.

    Attributes
    ----------
    passed_s : float
        Time between the exposures.
    turn_rad : (3,) float64
        Turn of the body, a rotation vector, body axes.
    moved_m : (3,) float64
        Path of the body, in the body axes of the earlier exposure.
    velocity_covariance : (3, 3) float64
        Covariance of the velocity that the path was taken from, body axes, (m/s)^2.
    turn_covariance : (3, 3) float64
        Covariance of the left camera's turn beyond that by rates and tracker, body axes, rad^2.
    camera_rates_radps : (2, 3) float64
        Rates of turn of the left camera at both exposures, body axes.
    stamp_sigma_s : float
        One-sigma of each exposure's stamp.
    """

    passed_s: float
    turn_rad: Floats
    moved_m: Floats
    velocity_covariance: Floats
    turn_covariance: Floats
    camera_rates_radps: Floats = field(default_factory=lambda: np.zeros((2, 3)))
    stamp_sigma_s: float = 0.0


class _LeftCamera(NamedTuple):
    """Motion of the left camera: rotations (3, 3) as named, and its path (3,) in the earlier camera's axes."""

    earlier_from_body: Floats
    body_from_later: Floats
    path_m: Floats


@dataclass(frozen=True, slots=True, eq=False)
class FlowView:
    """Features of a pair that were tracked into an earlier left image, and all that predicts their places there.

    Attributes
    ----------
    match_index : (m,) int64
        Index of each feature among the pair's matches.
    rays : Rays
        Matched rays (m) of the pair by the tracked bend, body axes.
    sigma_rad : (m,) float64
        One-sigma of each match along the epipolar line, as a slope.
    earlier, later : (m, 3) float64
        Rays in the axes of the left camera at both exposures, of unit depth.
    flow_sigma_rad : (m,) float64
        One-sigma of the earlier place, as a slope.
    earlier_pose, later_pose : Pose
        Pose of the left camera by the tracked bend, in the body axes of its exposure.
    between : FlightBetween
        Motion of the body between the two left exposures.
    epipolar_from_body : (3, 3) float64
        Rotation to the epipolar frame at rest.
    axes : LensAxes
        Axes of both cameras at the pair's exposures, body axes.
    """

    match_index: Ints
    rays: Rays
    sigma_rad: Floats
    earlier: Floats
    later: Floats
    flow_sigma_rad: Floats
    earlier_pose: Pose
    later_pose: Pose
    between: FlightBetween
    epipolar_from_body: Floats
    axes: LensAxes

    @property
    def velocity_covariance(self) -> Floats:
        """Covariance (3, 3) of the velocity over ground, epipolar axes, (m/s)^2."""
        return self._in_epipolar_axes(self.between.velocity_covariance)

    @property
    def turn_covariance(self) -> Floats:
        """Covariance (3, 3) of the left camera's turn beyond that by rates and tracker, epipolar axes, rad^2."""
        return self._in_epipolar_axes(self.between.turn_covariance)

    def _in_epipolar_axes(self, covariance: Floats) -> Floats:
        turned: Floats = self.epipolar_from_body @ covariance @ self.epipolar_from_body.T
        return turned

    def without(self, outlier: Bools) -> FlowView:
        """The view without the features of those matches of the pair that a mask (n,) marks."""
        keep = ~outlier[self.match_index]
        return replace(
            self,
            match_index=self.match_index[keep],
            rays=self.rays.at(keep),
            sigma_rad=self.sigma_rad[keep],
            earlier=self.earlier[keep],
            later=self.later[keep],
            flow_sigma_rad=self.flow_sigma_rad[keep],
        )

    def innovation(
        self,
        rotation_rad: Floats,
        lens: Floats,
        velocity_mps: Floats = _NONE,
        turn_rad: Floats = _NONE,
        baseline: Floats = _STRAIGHT,
        pair_turn_rad: Floats = _NONE,
    ) -> FlowInnovation:
        """Places in the earlier image, observed less predicted, and the derivatives of the prediction.

        Parameters
        ----------
        rotation_rad : (3,) float64
            Relative rotation, epipolar axes.
        lens : (9,) float64
            Lens terms.
        velocity_mps, turn_rad : (3,) float64
            Estimated errors of velocity and turn, epipolar axes: true less stated by the autopilot.
        baseline : (2,) float64
            Estimated error of the baseline's direction, y and z, rad.
        pair_turn_rad : (3,) float64
            The pair's own error of the turn, beyond ``turn_rad``: rows are linear about it, residuals those without it.
        """
        inverse_pm, sigma_pm = self._inverse_depths(self.rays, [(rotation_rad, lens, baseline)])
        left, per_term = left_terms(lens)
        quarter = quarter_turns(self.epipolar_from_body @ self.later_pose.camera_from_body.T)
        bent_earlier, bent_later = left_fields(self.earlier, quarter), left_fields(self.later, quarter)
        earlier, later = (self.earlier - bent_earlier @ left)[:, :2], self.later - bent_later @ left
        moved = self._moved(rotation_rad, velocity_mps, turn_rad + pair_turn_rad)
        in_body = later @ moved.body_from_later.T
        at_infinity = in_body @ moved.earlier_from_body.T

        slopes, project = _projected(at_infinity + inverse_pm[:, np.newaxis] * moved.path_m)
        residual, per_inverse = earlier - slopes, project @ moved.path_m
        place_variance, depth_variance = self.flow_sigma_rad**2, (per_inverse**2).sum(axis=1) * sigma_pm**2
        # Rows are taken at the depth adjusted by both noises (Gauss-Helmert). At the depth by stereo alone, its noise
        # would be in rows and residual alike, and bias velocity, radial term and rates of turn.
        depth_correction_pm = (per_inverse * residual).sum(axis=1) * sigma_pm**2 / (place_variance + depth_variance)
        adjusted_pm = inverse_pm + depth_correction_pm
        expected, project = _projected(at_infinity + adjusted_pm[:, np.newaxis] * moved.path_m)
        bent_earlier = left_fields(np.column_stack([expected, np.ones(len(expected))]), quarter)
        per_inverse = project @ moved.path_m
        per_state = self._per_state(self._nearer(depth_correction_pm), rotation_rad, lens, baseline)
        per_left = bent_earlier[:, :2] - project @ (moved.earlier_from_body @ moved.body_from_later) @ bent_later
        per_depth = per_inverse[:, :, np.newaxis] * per_state[:, np.newaxis, :]
        per_depth[:, :, 3 : 3 + PAIR_TERMS] += per_left @ per_term
        per_motion = self._per_motion(moved, in_body, project, adjusted_pm)
        residual = residual + per_motion[:, :, :3] @ pair_turn_rad
        columns = np.concatenate([per_depth, per_motion, per_motion @ self._motion_per_stamp()], axis=2)
        variance = np.stack([place_variance + depth_variance, place_variance], axis=1)
        return _along_and_across(per_inverse, residual, variance, columns)

    def _moved(self, rotation_rad: Floats, velocity_mps: Floats, turn_rad: Floats) -> _LeftCamera:
        """The left camera's motion with half of a relative rotation, and errors of velocity and turn, epipolar axes."""
        half = self._half_turn(rotation_rad)
        body_from_epipolar = self.epipolar_from_body.T
        turned = exp_rotation(body_from_epipolar @ turn_rad) @ exp_rotation(self.between.turn_rad)
        moved_m = self.between.moved_m + self.between.passed_s * (body_from_epipolar @ velocity_mps)
        shift_m = turned @ self.later_pose.position_body_m + moved_m - self.earlier_pose.position_body_m
        earlier_from_body = self.earlier_pose.camera_from_body @ half
        body_from_later = turned @ (self.later_pose.camera_from_body @ half).T
        return _LeftCamera(earlier_from_body, body_from_later, earlier_from_body @ shift_m)

    def _per_motion(self, moved: _LeftCamera, in_body: Floats, project: Floats, inverse_pm: Floats) -> Floats:
        """Change (m, 2, 6) of the predicted places by the body's turn and by its velocity, epipolar axes."""
        per_turn = -moved.earlier_from_body @ skew(in_body) @ self.epipolar_from_body.T
        path_per_velocity_s = self.between.passed_s * (moved.earlier_from_body @ self.epipolar_from_body.T)
        per_velocity = project @ path_per_velocity_s * inverse_pm[:, np.newaxis, np.newaxis]
        return np.concatenate([project @ per_turn, per_velocity], axis=2)

    def _motion_per_stamp(self) -> Floats:
        """Errors of turn and velocity (6, 2), epipolar axes, per second by which each exposure was later than stamped.

        A longer flight turns the camera further at its rate, and moves it further along the path.
        """
        velocity_per_stamp_mps2 = self.between.moved_m / self.between.passed_s**2
        longer = np.array(
            [np.concatenate([self.epipolar_from_body @ rate, self.epipolar_from_body @ velocity_per_stamp_mps2])
             for rate in self.between.camera_rates_radps]
        ).T  # fmt: skip
        return np.asarray(longer * np.array([-1.0, 1.0]))

    def _nearer(self, change_pm: Floats) -> Rays:
        """Matched rays whose inverse depths are larger by a change (m,): the right ones turned along the baseline."""
        rays, x, z = self.rays, self.epipolar_from_body[0], self.epipolar_from_body[2]
        baseline_m = np.linalg.norm(rays.right_m - rays.left_m, axis=1)
        closer = (baseline_m * change_pm * (rays.right @ z))[:, np.newaxis] * x
        return replace(rays, right=rays.right - closer)

    def _per_state(self, rays: Rays, rotation_rad: Floats, lens: Floats, baseline: Floats) -> Floats:
        """Change (m, 14) of the inverse depths of matched rays by rotation, lens and baseline."""
        changed = [(rotation_rad, lens, baseline)]
        changed += [(rotation_rad + _STEP * axis, lens, baseline) for axis in np.eye(3)]
        changed += [(rotation_rad, lens + _STEP * term, baseline) for term in np.eye(PAIR_TERMS)]
        changed += [(rotation_rad, lens, baseline + _STEP * axis) for axis in np.eye(2)]
        table = self._inverse_depths(rays, changed)[0].reshape(len(changed), -1)
        per_state: Floats = (table[1:] - table[0]).T / _STEP
        return per_state

    def _inverse_depths(self, rays: Rays, states: Sequence[tuple[Floats, Floats, Floats]]) -> tuple[Floats, Floats]:
        """Inverse depths, 1/m, of m matched rays along the left optical axis for k states, and their sigmas, (k m,).

        A state is rotation, lens terms and baseline direction. The optical axis is that of the first state.
        """
        stacked = Rays.stacked([self._turned(rays, *state) for state in states])
        look = self.later_pose.camera_from_body[2] @ self._half_turn(states[0][0])
        # Tangents across the axis are not needed. The camera has flown on since the pose's instant (6 cm at 20 m/s).
        start_m = rays.left_m[0] if len(rays.left_m) else self.later_pose.position_body_m
        sight = RangeAxis(start_m, look, np.zeros((2, 3)))
        depths = triangulate(stacked, sight, np.tile(self.sigma_rad, len(states)))
        return depths.inverse_pm, depths.sigma_pm

    def _half_turn(self, rotation_rad: Floats) -> Floats:
        """Half of a relative rotation (3,), epipolar axes, as a matrix in body axes."""
        return exp_rotation(0.5 * (self.epipolar_from_body.T @ rotation_rad))

    def _turned(self, rays: Rays, rotation_rad: Floats, lens: Floats, baseline: Floats) -> Rays:
        """Rays with half of the relative rotation in each camera, the right one moved, the lens residual taken out."""
        half = self._half_turn(rotation_rad)
        baseline_m = np.linalg.norm(rays.right_m - rays.left_m, axis=1)[:, np.newaxis]
        right_m = rays.right_m + baseline_m * (baseline @ self.epipolar_from_body[1:])
        turned = Rays(rays.left_m, rays.left @ half, right_m, rays.right @ half.T)
        return straightened(turned, lens, self.axes.turned(half))


def _along_and_across(path: Floats, residual: Floats, variance: Floats, columns: Floats) -> FlowInnovation:
    """Innovation in the axes of each feature, along its image path (m, 2), where depth noise shows, and across it.

    ``residual`` (m, 2) and ``columns`` (m, 2, 22) are in image axes, ``variance`` (m, 2) is along and across the path.
    """
    along = path / np.linalg.norm(path, axis=1)[:, np.newaxis]
    axes = np.stack([along, along[:, ::-1] * np.array([-1.0, 1.0])], axis=1)
    rows = (axes @ columns).reshape(2 * len(residual), columns.shape[2])
    in_axes, sigma = (axes @ residual[..., np.newaxis]).ravel(), np.sqrt(variance).ravel()
    return FlowInnovation(in_axes, sigma, *np.split(rows, np.cumsum([3, PAIR_TERMS, 2, 3, 3]), axis=1))


def _projected(directions: Floats) -> tuple[Floats, Floats]:
    """Slopes (m, 2) of directions (m, 3), and their derivative (m, 2, 3)."""
    slopes = directions[:, :2] / directions[:, 2:]
    derivative = np.zeros((len(slopes), 2, 3))
    derivative[:, 0, 0] = derivative[:, 1, 1] = 1.0 / directions[:, 2]
    derivative[:, :, 2] = -slopes / directions[:, 2:]
    return slopes, derivative

"""Update of the epipolar filter's states by one pair: matches, its innovation, considered states, flow.

Residuals have Student's t distribution (Lange, Little and Taylor 1989). The rotation is exact in every Gauss-Newton
step. Each pair has a free rotation, the innovation, and an error of the baseline's direction. Both are white.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.core.stereo.consistency_gate import KNOCK_RAD, Innovation
from companion.core.stereo.epipolar_geometry import parallax
from companion.core.stereo.epipolar_states import (
    ALL_STATES,
    BASELINE,
    CONSIDERED_IN_FLOW_STATES,
    INNOVATION,
    LENS,
    PARALLAX_STATES,
    PERSISTENT_STATES,
    SHIFT,
    TURN_RATE,
    VELOCITY,
    YAW,
    YAW_BIAS,
    BendBelief,
    rotation_rows,
)
from companion.core.stereo.flow import FlowInnovation
from companion.core.stereo.lens_residual import LensAxes
from companion.core.stereo.triangulation import Rays
from companion.records import Bools, Floats
from companion.units import MAD_TO_SIGMA

_GAUSS_NEWTON_STEPS = 10  # steps of the reweighted solution (choice)
# degrees of freedom of the matches' errors: outliers lose weight, good matches keep nearly all of theirs (choice)
_STUDENT_DOF = 5.0
_VARIANCE_FLOOR_RAD2 = 1e-17  # rad^2: states without variance keep a finite information (numerical)
# share of the innovation's prior that stays: a rotation which no match shows has a finite sigma too (choice)
_PRIOR_REMAINDER = 1e-3
_FLOW_ROUNDS = 3  # reweightings of the flow, which is nearly linear (choice)
# sigma of the left camera's turn between two exposures, rad per axis, that neither rates nor tracked bend show: twist,
# rates between their samples (choice: a tenth of a pixel); errors of gyro and tracked bend come with each pair
_FLOW_TURN_RAD = 1e-4
PAIR_TURN = slice(ALL_STATES, ALL_STATES + 3)
"""States of a flow's solution behind those of the filter: the pair's own error of the left camera's turn."""
# residual of an outlier (choice): the flow loses one in 185 of the sound features
_OUTLIER_SIGMAS = 3.0
_FLOW_SIGMAS = 4.0  # a flow that moves yaw or velocity by more contradicts the states (choice)
_FLOW_DOUBT_SIGMAS = 2.5  # what it moves beyond this is added to the covariance: one pair in eighty by chance (choice)


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """Mean (all states,) and covariance given a pair, scale of its parallaxes, and mask (n,) of its outliers.

    ``used`` is the number of matches with more than half their weight. ``flow`` is the number of features in the flow
    update, 0 without one.
    """

    mean: Floats
    covariance: Floats
    scale: float
    used: int
    outlier: Bools
    flow: int = 0


def joint_prior(persistent_covariance: Floats, shift_covariance: Floats) -> Floats:
    """Prior covariance (n, n) of all states: persistent ones, this pair's baseline direction and innovation.

    ``persistent_covariance`` (p, p), and ``shift_covariance`` (2, 2) of the baseline's direction.
    """
    joint = np.zeros((ALL_STATES, ALL_STATES))
    joint[:PERSISTENT_STATES, :PERSISTENT_STATES] = persistent_covariance
    joint[SHIFT, SHIFT], joint[INNOVATION, INNOVATION] = shift_covariance, KNOCK_RAD**2 * np.eye(3)
    return joint


def maximum_a_posteriori(
    epipolar_rays: Rays, axes: LensAxes, sigma_rad: Floats, carried: Floats, covariance: Floats, bend: BendBelief
) -> Posterior:
    """Posterior by reweighted Gauss-Newton steps.

    Parameters
    ----------
    epipolar_rays : Rays
        n matched rays in the epipolar frame.
    axes : LensAxes
        Axes of both cameras, in the epipolar frame.
    sigma_rad : (n,) float64
        One-sigma of each parallax.
    carried, covariance : (persistent states,), (all states, all states) float64
        Prior mean of the persistent states, and prior covariance of all states.
    bend : BendBelief
        Axis about which the tracker's slow error turns the cameras.
    """
    mean = np.concatenate([carried, np.zeros(ALL_STATES - PERSISTENT_STATES)])
    gather = rotation_rows(bend)
    gather[YAW, YAW_BIAS] = 1.0
    prior_information = _inverse(covariance + _VARIANCE_FLOOR_RAD2 * np.eye(len(mean)))
    state, scale = mean.copy(), 1.0
    weight, information = np.ones(len(sigma_rad)), prior_information
    for _ in range(_GAUSS_NEWTON_STEPS):
        total = np.concatenate([gather @ state, state[3:PARALLAX_STATES]])
        total[BASELINE] += state[SHIFT]
        residual_rad, columns = parallax(epipolar_rays, axes, total)
        design = columns[:, :3] @ gather
        design[:, 3:PARALLAX_STATES], design[:, SHIFT] = columns[:, 3:], columns[:, BASELINE]
        # the first scale contains the rotation itself; as its residual shrinks, outliers stand out
        unit = residual_rad / sigma_rad
        scale = _scale(unit)
        unit = unit / scale
        weight = (_STUDENT_DOF + 1.0) / (_STUDENT_DOF + unit**2)
        weighted = design * (np.minimum(weight, 1.0) / (scale * sigma_rad))[:, np.newaxis]
        # information: weighted squares of the design; pull: weighted residuals and the prior
        information = prior_information + weighted.T @ (design / (scale * sigma_rad)[:, np.newaxis])
        pull = weighted.T @ unit + prior_information @ (mean - state)
        state = state + np.linalg.solve(information, pull)
    outlier: Bools = np.abs(unit) > _OUTLIER_SIGMAS
    return Posterior(state, _inverse(information), scale, int(np.sum(weight > 0.5)), outlier)


def innovation_of(answer: Posterior) -> Innovation:
    """Innovation with its own prior taken out: zero within its covariance, if nothing is wrong."""
    information = np.linalg.inv(answer.covariance[INNOVATION, INNOVATION])
    pull = information @ answer.mean[INNOVATION]
    covariance = np.asarray(
        np.linalg.inv(information - (1.0 - _PRIOR_REMAINDER) / KNOCK_RAD**2 * np.eye(3)), dtype=np.float64
    )
    return Innovation(np.asarray(covariance @ pull, dtype=np.float64), covariance)


def with_bound_innovation(answer: Posterior, granted_rad2: Floats) -> Posterior:
    """The posterior with a granted covariance (3, 3), rad^2, as the innovation's prior: 0 binds the innovation to 0."""
    block, innovation = answer.covariance[INNOVATION, INNOVATION], innovation_of(answer)
    gain = np.linalg.solve(innovation.covariance + granted_rad2, granted_rad2).T
    mean, covariance = gain @ innovation.rotation_rad, granted_rad2 - gain @ granted_rad2
    follow = np.linalg.solve(block, answer.covariance[INNOVATION]).T
    return dataclasses.replace(
        answer,
        mean=answer.mean + follow @ (mean - answer.mean[INNOVATION]),
        covariance=answer.covariance + follow @ (covariance - block) @ follow.T,
    )


def with_considered_states(answer: Posterior, mean: Floats, prior: Floats, considered: list[int]) -> Posterior:
    """The posterior with the considered states as before the update (Schmidt 1966).

    The other states keep their mean and covariance, whose gain accounts for the considered ones. ``mean`` (n,) and
    ``prior`` (n, n) are those before.
    """
    after, covariance = answer.mean.copy(), answer.covariance.copy()
    after[considered] = mean[considered]
    block = np.ix_(considered, considered)
    covariance[block] = prior[block]
    return dataclasses.replace(answer, mean=after, covariance=covariance)


class FlowConditions(NamedTuple):
    """Conditions of a flow.

    Attributes
    ----------
    passed_s : float
        Time between the exposures, s.
    turn_covariance : (3, 3) float64
        Covariance of the left camera's turn beyond that by rates and tracker, epipolar axes, rad^2.
    bend : BendBelief
        Axis about which the tracker's slow error turns the cameras.
    stamp_sigma_s : float
        One-sigma of each exposure's stamp, s.
    """

    passed_s: float
    turn_covariance: Floats
    bend: BendBelief
    stamp_sigma_s: float = 0.0


def with_flow(answer: Posterior, flow: FlowInnovation, conditions: FlowConditions) -> Posterior | None:
    """The posterior updated by the flow since an earlier pair; None if that contradicts, or has too few features.

    The flow's rows are linear about the posterior, with Student's t as in :func:`maximum_a_posteriori`. Besides the
    constant rate error, this pair has errors of its own (:data:`PAIR_TURN`, stamps), which are marginalised.

    Parameters
    ----------
    answer : Posterior
        Posterior given the pair's matches.
    flow : FlowInnovation
        Flow observed less predicted by the mean of that posterior.
    conditions : FlowConditions
        Time between the exposures, and what is believed of the pair's own errors.
    """
    if not flow.is_enough:
        return None
    change, covariance = _solved_flow(answer, flow, conditions)
    tested = np.vstack([rotation_rows(conditions.bend)[YAW], np.eye(ALL_STATES)[VELOCITY]])
    change, covariance = change[:ALL_STATES], covariance[:ALL_STATES, :ALL_STATES]
    moved = (tested @ change) ** 2
    removed = np.einsum("ij,jk,ik->i", tested, answer.covariance - covariance, tested)
    if not np.isfinite(change).all() or (moved > _FLOW_SIGMAS**2 * removed).any():
        return None
    beyond = 1.0 - _FLOW_DOUBT_SIGMAS**2 * removed / np.maximum(moved, _VARIANCE_FLOOR_RAD2)
    doubted = change.copy()
    doubted[CONSIDERED_IN_FLOW_STATES] = 0.0  # they are put back by the caller, with their covariance
    covariance = covariance + max(float(beyond.max()), 0.0) * np.outer(doubted, doubted)
    return dataclasses.replace(
        answer, mean=answer.mean + change, covariance=covariance, flow=int(flow.finite.sum()) // 2
    )


def pair_turn_rad(answer: Posterior, flow: FlowInnovation, conditions: FlowConditions) -> Floats:
    """Error (3,) of the left camera's turn in this pair, epipolar axes, rad, by the arguments of :func:`with_flow`."""
    return _solved_flow(answer, flow, conditions)[0][PAIR_TURN]


def _solved_flow(answer: Posterior, flow: FlowInnovation, conditions: FlowConditions) -> tuple[Floats, Floats]:
    """Change by the flow, and covariance after it, of all states and the pair's errors of turn and stamps (n,).

    The turn's has sigma :data:`_FLOW_TURN_RAD` per axis, and ``turn_covariance`` besides.
    """
    passed_s, turn_covariance, bend, stamp_sigma_s = conditions
    finite, add_up = flow.finite, rotation_rows(bend)
    stamps = slice(PAIR_TURN.stop, PAIR_TURN.stop + 2)
    design = np.zeros((len(finite), stamps.stop))
    design[:, :ALL_STATES] = flow.rotation @ add_up
    design[:, LENS], design[:, BASELINE], design[:, SHIFT] = flow.lens, flow.baseline, flow.baseline
    design[:, VELOCITY], design[:, TURN_RATE] = flow.velocity, passed_s * flow.turn
    design[:, PAIR_TURN], design[:, stamps] = flow.turn, flow.stamps
    design = design[finite] / flow.sigma_rad[finite, np.newaxis]
    normalised = flow.residual_rad[finite] / flow.sigma_rad[finite]
    prior = np.zeros((stamps.stop, stamps.stop))
    prior[:ALL_STATES, :ALL_STATES] = answer.covariance
    prior[PAIR_TURN, PAIR_TURN] = _FLOW_TURN_RAD**2 * np.eye(3) + turn_covariance
    prior[stamps, stamps] = stamp_sigma_s**2 * np.eye(2)
    root = _square_root(prior)
    whitened_design, identity = design @ root, np.eye(len(root))
    change, covariance = np.zeros(len(prior)), prior
    for _ in range(_FLOW_ROUNDS):
        residual = normalised - design @ change
        scale = _scale(residual)
        weight = np.minimum((_STUDENT_DOF + 1.0) / (_STUDENT_DOF + (residual / scale) ** 2), 1.0) / scale**2
        # The error of a wrong feature is in rows and residual alike, which biases toe and velocity the same way in
        # every pair. So it has no weight, neither along its path nor across it.
        outlier = np.abs(residual).reshape(-1, 2).max(axis=1) > _OUTLIER_SIGMAS * scale
        weight[np.repeat(outlier, 2)] = 0.0
        information = identity + whitened_design.T @ (whitened_design * weight[:, np.newaxis])
        covariance = root @ np.linalg.solve(information, root.T)
        change = covariance @ (design.T @ (weight * normalised))
    return change, covariance


def _scale(normalised: Floats) -> float:
    """Scale of residuals (n,) in their stated sigmas, at least 1: the rms of those that are no outliers.

    Outliers raise the median by the share that they are of all, so it only tells them from the others.
    """
    size = np.abs(normalised)
    sound = size[size <= _OUTLIER_SIGMAS * MAD_TO_SIGMA * float(np.median(size))]
    return max(float(np.sqrt(np.mean(sound**2))), 1.0)


def _inverse(matrix: Floats) -> Floats:
    """Inverse of a positive definite matrix, scaled first: the variances differ by many orders."""
    unit = 1.0 / np.sqrt(np.diag(matrix))
    inverse: Floats = np.linalg.inv(matrix * np.outer(unit, unit)) * np.outer(unit, unit)
    return inverse


def _square_root(covariance: Floats) -> Floats:
    """Square root (n, n) of a covariance, scaled first: the variances differ by many orders."""
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    unit = np.where(sigma > 0.0, sigma, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    root: Floats = unit[:, np.newaxis] * vectors * np.sqrt(np.maximum(values, 0.0))
    return root

"""Measurement rows in plain numpy: ``native/epochs.c``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.core.kernels.arrays import Epochs
from companion.core.tracking.rigid_body import _PADDING, BEFORE, _RootNoise
from companion.core.tracking.states import M_LEFT, P_LEFT, P_ROOT, ROWS, Y_LEFT, Z_LEFT
from companion.core.tracking.streams import CHANNELS, StreamSamples
from companion.records import Bools, Floats, Ints
from companion.units import GRAVITY_MPS2
from sitl_tests.native.averaging import EpochAverages
from sitl_tests.reference.kernels.error_jacobians import (
    SensedMotion,
    central_difference,
    mean_before,
    sensitivities,
    with_earlier_rigid,
)
from sitl_tests.reference.kernels.resampling import VERTICAL
from sitl_tests.reference.kernels.streams import averages

_Vector = Floats | tuple[float, float, float]
_MIN_FORCE_MPS2 = 1.0  # chosen: in free fall the lateral axis does not see the slope
_ROOT_MOMENT_SIGMAS = 5.0  # chosen: of the root's own first moment
_TILT_FOR_LATERAL_ERROR = 0.05  # chosen, rad: tip slope by which a lateral error enters a vertical row
_LATERAL, _ROLL = 1, 3  # channels


class _Averaged(NamedTuple):
    """Averages of all streams over a run of epochs.

    ``sends`` (3, 6): axes of each station; ``resolved`` (2, n): epochs whose first moments are valid.
    """

    step_s: float
    root: Floats
    tip: Floats
    moment: Floats
    covered: Bools
    sends: Bools
    resolved: Bools
    filtered: bool
    levers_m: Floats


def build_epochs(
    root: StreamSamples,
    left: StreamSamples,
    right: StreamSamples,
    first_ns: int,
    step_ns: int,
    count: int,
    sends: Bools,
    levers_m: Floats,
    noise: _RootNoise,
    error_columns: Ints,
    parameter_count: int,
) -> Epochs:
    """Epochs with ``BEFORE`` and ``_PADDING`` more on either side, for derivatives and smoothing."""
    edges_ns = first_ns + step_ns * np.arange(-BEFORE, count + _PADDING + 1)
    at_root, at_left, at_right = averages(root, edges_ns), averages(left, edges_ns), averages(right, edges_ns)
    steady = _steady(at_root, noise.mps2_rthz, step_ns * 1e-9)
    averaged = _Averaged(
        step_ns * 1e-9,
        at_root.mean,
        np.stack((at_left.mean, at_right.mean), axis=1),
        np.stack((at_left.moment, at_right.moment), axis=1),
        np.stack((at_root.covered, at_left.covered, at_right.covered)),
        sends,
        np.stack((steady & at_left.resolved, steady & at_right.resolved)),
        root.filtered,
        levers_m,
    )
    aliasing_noise = np.stack((at_left.aliasing_noise, at_right.aliasing_noise), axis=1)
    root_motion_variance = _root_motion_variance(averaged, noise.usual_sigma)
    return _rows_and_jacobians(
        averaged, edges_ns[:-1], aliasing_noise, root_motion_variance, error_columns, parameter_count
    )


def _rows_and_jacobians(
    averaged: _Averaged,
    start_ns: Ints,
    aliasing_noise: Floats,
    root_motion_variance: Floats,
    error_columns: Ints,
    parameter_count: int,
) -> Epochs:
    """Measurement rows, their linearisation terms and their Jacobian with respect to the bias parameters."""
    motion, present = _motion(averaged), _present(averaged)
    gains = _lateral_gain(motion, present)
    n = len(present)
    rows, vertical_mps2, lateral_mps2, slope_rate_gain = (
        np.zeros((n, ROWS)),
        np.zeros((n, 2)),
        np.zeros((n, 2)),
        np.zeros((n, 2)),
    )
    earlier = [with_earlier_rigid(motion, side, VERTICAL) for side in range(2)]
    for k in range(n):
        for side in range(2):
            force = motion.tip[k, side, 2]
            rows[k, Z_LEFT + side] = force - motion.rigid[k, side, 2]
            rows[k, M_LEFT + side] = motion.moment[k, side] - motion.step_s / 12.0 * motion.d_rigid_z[k, side]
            rows[k, Y_LEFT + side] = np.arctan((motion.tip[k, side, 1] - motion.rigid[k, side, 1]) * gains[k, side])
            rows[k, P_LEFT + side] = motion.tip[k, side, 3]
            if present[k, Z_LEFT + side]:
                vertical_mps2[k, side] = earlier[side][k]
                lateral_mps2[k, side] = motion.rigid[k, side, 1] * (1.0 - 2.0 * side)
            if present[k, Y_LEFT + side]:
                slope_rate_gain[k, side] = (
                    -motion.moment[k, side] * motion.step_s * np.abs(gains[k, side]) * np.sign(force)
                )
        rows[k, P_ROOT] = motion.omega[k, 0]
        for row in range(ROWS):
            if not present[k, row]:
                rows[k, row] = 0.0
    load_g, earlier_load_g = np.zeros(n), np.zeros(n)
    force_before = mean_before(motion.f_root[:, 2:], motion.root_present)[:, 0]
    if averaged.sends[0, VERTICAL]:
        for k in range(n):
            if averaged.covered[0, k]:
                load_g[k] = -motion.f_root[k, 2] / GRAVITY_MPS2 - 1.0
                earlier_load_g[k] = -force_before[k] / GRAVITY_MPS2 - 1.0
    body_rate_radps = motion.omega.copy()
    goes_on = averaged.covered[0, 1:]
    body_rate_radps[:-1][goes_on] = 0.5 * (motion.omega[:-1] + motion.omega[1:])[goes_on]
    sensitivity = sensitivities(motion, gains, present, error_columns, parameter_count)
    for k in range(n):
        for side in range(2):
            if not present[k, Y_LEFT + side]:
                gains[k, side] = 0.0
    return Epochs(
        start_ns,
        rows,
        present,
        vertical_mps2,
        lateral_mps2,
        slope_rate_gain,
        gains,
        load_g,
        body_rate_radps,
        mean_before(motion.omega_dot[:, :1], motion.root_present)[:, 0],
        earlier_load_g,
        sensitivity,
        aliasing_noise,
        root_motion_variance,
        np.zeros(n, dtype=np.bool_),
        averaged.covered[0],
    )


def _motion(averaged: _Averaged) -> SensedMotion:
    """Rigid motion at the tips and what they sensed, with derivatives."""
    root_present, step_s = averaged.covered[0], averaged.step_s
    smooth = _smoothed(averaged.root, root_present) if averaged.filtered else averaged.root
    f_root, omega = smooth[:, :3].copy(), smooth[:, 3:].copy()
    omega_dot = central_difference(omega, step_s, root_present)
    n = len(smooth)
    rigid, d_rigid_z, d_tip = np.empty((n, 2, 3)), np.empty((n, 2)), np.empty((n, 2, 6))
    for side in range(2):
        arm = averaged.levers_m[side]
        for k in range(n):
            tangential, centripetal = _cross(omega_dot[k], arm), _cross(omega[k], _cross(omega[k], arm))
            for axis in range(3):
                rigid[k, side, axis] = f_root[k, axis] + tangential[axis] + centripetal[axis]
            rigid[k, side, 2] -= omega_dot[k, 0] * arm[1]  # the filter's business
        d_rigid_z[:, side] = central_difference(rigid[:, side, 2].copy(), step_s, root_present)
        d_tip[:, side] = central_difference(averaged.tip[:, side].copy(), step_s, averaged.covered[1 + side])
    d_root = central_difference(f_root, step_s, root_present)
    tip = averaged.tip.copy()  # an axis that is not sent leaks into the others all the same: as the rigid wing's
    for side in range(2):
        for axis in range(CHANNELS):
            if not averaged.sends[1 + side, axis]:
                tip[:, side, axis] = rigid[:, side, axis] if axis < _ROLL else omega[:, axis - _ROLL]
    return SensedMotion(
        step_s,
        tip,
        averaged.moment,
        d_tip,
        rigid,
        d_rigid_z,
        f_root,
        d_root,
        omega,
        omega_dot,
        averaged.levers_m,
        averaged.covered[0],
    )


def _steady(root: EpochAverages, noise_mps2_rthz: float, step_s: float) -> Bools:
    """Epochs in which the root moves as its means say, (n,).

    A shaken support moves otherwise inside an epoch, and so does the wing on it: a first moment is no bending then.
    """
    slope = central_difference(root.mean[:, VERTICAL].copy(), step_s, root.covered)
    beyond = np.abs(root.moment - step_s / 12.0 * slope)
    steady: Bools = ~root.resolved | (beyond < _ROOT_MOMENT_SIGMAS * noise_mps2_rthz / np.sqrt(24.0 * step_s))
    return steady


def _present(averaged: _Averaged) -> Bools:
    """Rows that were measured, (n, 9)."""
    root = averaged.covered[0]
    present = np.zeros((len(root), ROWS), np.bool_)
    present[:, P_ROOT] = root & averaged.sends[0, _ROLL]
    for side in range(2):
        covered_tip, sends = averaged.covered[1 + side], averaged.sends[1 + side]
        present[:, Z_LEFT + side] = covered_tip & root & sends[VERTICAL]
        present[:, Y_LEFT + side] = present[:, Z_LEFT + side] & sends[_LATERAL]
        present[:, M_LEFT + side] = covered_tip & root & sends[VERTICAL] & averaged.resolved[side]
        present[:, P_LEFT + side] = covered_tip & sends[_ROLL]
    return present


def _smoothed(values: Floats, present: Bools) -> Floats:
    """Weights 1/4, 1/2, 1/4 over neighbouring epochs.

    A filtered root that sends at a few hundred hertz leaves noise in its epochs that alternates from one to the next,
    several times its sensor's; rigid motion is too slow to be changed (2 % at a twentieth of the epoch rate).
    """
    out = values.copy()
    for k in range(1, len(values) - 1):
        if present[k - 1] and present[k] and present[k + 1]:
            out[k] = 0.25 * (values[k - 1] + values[k + 1]) + 0.5 * values[k]
    return out


def _root_motion_variance(averaged: _Averaged, usual_sigma: Floats) -> Floats:
    """Variances (n, 3) by motion that the filtered root does not resolve, where smoothing removes more than usual.

    Motion faster than the smoothing and the interpolation between filtered samples is wrong by about as much as
    smoothing changes it: measured on blows of 20 ms as well as on noise in the samples.
    """
    n = len(averaged.root)
    out = np.zeros((n, 3))
    if not averaged.filtered:
        return out
    smooth = _smoothed(averaged.root, averaged.covered[0])
    removed, lever = np.zeros((n, 3)), np.abs(averaged.levers_m).max()
    for k in range(n):
        change = np.abs(averaged.root[k] - smooth[k])
        rate_change, rate_norm = np.sqrt((change[_ROLL:] ** 2).sum()), np.sqrt((smooth[k, _ROLL:] ** 2).sum())
        centripetal = lever * rate_change * (2.0 * rate_norm + rate_change)  # of the centripetal force
        beyond = rate_change > usual_sigma[2]
        removed[k, 2] = change[_ROLL] if change[_ROLL] > usual_sigma[2] else 0.0
        removed[k, 1] = change[_LATERAL] + centripetal if beyond or change[_LATERAL] > usual_sigma[1] else 0.0
        removed[k, 0] = (
            change[VERTICAL] if change[VERTICAL] > usual_sigma[0] else 0.0
        ) + _TILT_FOR_LATERAL_ERROR * removed[k, 1]
    for k in range(n):
        for column in range(3):
            out[k, column] = removed[max(k - 1, 0) : k + 2, column].max() ** 2
    return out


def _cross(a: _Vector, b: _Vector) -> _Vector:
    """Cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _lateral_gain(motion: SensedMotion, present: Bools) -> Floats:
    """Inverse vertical specific force (n, 2), signed for the side; removes the slope rows in free fall."""
    gains = np.empty((len(present), 2))
    for k in range(len(present)):
        for side in range(2):
            force = motion.tip[k, side, 2]
            if np.abs(force) < _MIN_FORCE_MPS2:
                present[k, Y_LEFT + side] = False
                force = -GRAVITY_MPS2
            gains[k, side] = (1.0 - 2.0 * side) / force
    return gains

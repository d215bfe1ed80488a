"""Discrete wing model of the filter: what one averaged step of all sensors says about the state.

Each family obeys ``q'' + 2 zeta omega q' + omega^2 (q - q_static) = g`` with ``g`` white noise through two real poles;
each further mode has a load of the same spectral shape, correlated with the first. Over one step of length h the
sensors deliver:

- vertical, mean of ``-w''`` = ``-(w1' - w0') / h``, exactly, gust load included, so that measurement and process noise
  are correlated as they are in nature;
- vertical, first moment ``integral (t - middle) (-w'') dt / h^2`` = ``-((w1' + w0')/2 - (w1 - w0)/h) / h``, exactly:
  under a nearly white gust the path inside the step would be lost without it;
- lateral over vertical specific force: mean slope, ``(psi0 + psi1)/2 - h (psi1' - psi0')/12``, error (omega h)^4/720,
  beside the force of a moving tip, which is linearised at each step (``find_moving_tip`` in ``native/filter.c``);
- roll rate: mean slope rate ``(psi1 - psi0) / h``, exactly, on top of the rigid roll rate.

All are linear in the state before and after the step: ``z = H1 x1 + H0 x0 + noise`` with ``x1 = A x0 + b u + w``. The
rigid roll jerk is white: its density lets the acceleration change by 3 rad/s^2 (one sigma) in 16 ms, far more than the
gyros leave open, and yet smooth. A white acceleration would be unphysical, and a vertical-only antisymmetric mode would
drown in the root gyro's differentiated noise. The acceleration itself fades as slowly as a manoeuvre: one that fades at
5 Hz is predicted 6 % too small in the middle of the next step, and of Euler's force on a wing of 41 mm trim these are
2.5 mm.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from companion.core.tracking.discretise import stationary_covariance, van_loan
from companion.core.tracking.parameters import ModeParameters
from companion.core.tracking.states import (
    M_LEFT,
    MODE_STATES,
    P_LEFT,
    P_ROOT,
    ROWS,
    Y_LEFT,
    Z_LEFT,
    ModeFamily,
    SensorNoise,
    StateLayout,
)
from companion.records import Floats

WingParameters = tuple[ModeParameters, ModeParameters]
# chosen: far above what the gyros leave open, and smooth; see the module's text
_ROLL_JERK_DENSITY_RAD2PS5 = 2.0 * (2.0 * np.pi * 5.0) * 3.0**2
_ROLL_ACCEL_CORNER_RADPS = 2.0 * np.pi * 0.1  # chosen: no manoeuvre holds a roll acceleration for longer
_MOMENT_PATH_RATIO = 0.02  # chosen: path inside a step over gyro noise, both variances, from which moments pay
_ROLL_TIME_S = 10.0  # for which a rate may last that no station sends: no aircraft rolls for longer (choice)
_ROLL_SIGMA_RADPS = 3.0  # chosen: prior of the roll rate, wider than any aircraft's


@dataclass(frozen=True, slots=True)
class DiscreteWingModel:
    """One step of the wing and its sensors.

    Attributes
    ----------
    step_s : float
        h.
    parameters : (symmetric, antisymmetric)
    lever_y_m : (float, float)
        Body y of left and right tip relative to the root.
    transition : (n, n + 1) float64
        ``[A | b]``: the last column takes the static bend.
    H : (9, n + 1) float64
        ``H1 [A | b] + H0``: the measurement in terms of state and static bend before the step.
    noise : (n, n) float64
        Process noise Q of one step.
    cross_cov : (n, 9) float64
        ``Q H1^T``.
    process_noise_in_rows : (9, 9) float64
        ``H1 Q H1^T``, to which sensor noise is added.
    load_noise, load_cross_cov, load_noise_in_rows : (n, n), (n, 9), (9, 9) float64
        Parts of the last three by the loads alone.
    motion_covariance : (n, n) float64
        Of modes and loads of a wing that has been in this gust for ever; zero for all other states.
    slope : (2, n) float64
        Left and right tip slope of a state, rad.
    aliasing_variance : float
        Variance of a vertical mean, on average, by edges that cut samples, (m/s^2)^2.
    moments_beside_gyro : bool
        The load is so white that the path inside a step matters beside a gyro's noise: the moments measure it.
    """

    step_s: float
    parameters: WingParameters
    lever_y_m: tuple[float, float]
    transition: Floats
    H: Floats
    noise: Floats
    cross_cov: Floats
    process_noise_in_rows: Floats
    load_noise: Floats
    load_cross_cov: Floats
    load_noise_in_rows: Floats
    motion_covariance: Floats
    slope: Floats
    aliasing_variance: float
    moments_beside_gyro: bool


def build_model(
    layout: StateLayout, noise: SensorNoise, parameters: WingParameters, lever_y_m: tuple[float, float], step_s: float
) -> DiscreteWingModel:
    """Discretise the wing with these modal and gust parameters.

    Parameters
    ----------
    layout : StateLayout
        State vector of the airframe.
    noise : SensorNoise
        Noise of the averaged rows.
    parameters : (symmetric, antisymmetric)
        Modal and gust parameters of each family.
    lever_y_m : (float, float)
        Body y of left and right tip relative to the root.
    step_s : float
        h.

    Returns
    -------
    DiscreteWingModel

    Raises
    ------
    ValueError
        If a mode is not stable.
    """
    n = layout.size
    a, q = propagation(layout, noise, parameters, step_s)
    before, after = _measurement_rows(layout, lever_y_m, step_s)
    bend = np.zeros(n)
    bend[layout.symmetric.q] = 1.0
    transition = np.hstack([a, (bend - a @ bend)[:, None]])
    H = after @ transition
    H[:, :n] += before
    by_load = np.zeros_like(q)
    modes = slice(0, layout.antisymmetric.span.stop)
    by_load[modes, modes] = q[modes, modes]
    load_noise_in_rows = after @ by_load @ after.T
    loads = [q[family.v, family.v] for family in layout.families]
    for load in loads:
        # the path between two samples is not in what is made of samples, which each tip has at instants of its own
        load_noise_in_rows[M_LEFT:Y_LEFT, M_LEFT:Y_LEFT] += load * noise.sample_s**2 / (12.0 * step_s**4) * np.eye(2)
    # an epoch's edge cuts a sample, each tip's at another place: a bridge of variance density * sample / 6 at each
    aliasing_variance = sum(load * noise.sample_s / (3.0 * step_s**3) for load in loads)
    slope_matrix = slope_rows(layout)
    paths = [load * slope_matrix[1, family.q] ** 2 for load, family in zip(loads, layout.families, strict=True)]
    moments_beside_gyro = bool(sum(paths) / 12.0 > _MOMENT_PATH_RATIO * noise.sensor_variance[P_LEFT:P_ROOT].min())
    return DiscreteWingModel(
        step_s,
        parameters,
        lever_y_m,
        transition,
        H,
        q,
        q @ after.T,
        after @ (q - by_load) @ after.T + load_noise_in_rows,
        by_load,
        by_load @ after.T,
        load_noise_in_rows,
        _motion_covariance(layout, a, q),
        slope_matrix,
        float(aliasing_variance),
        moments_beside_gyro,
    )


def _motion_covariance(layout: StateLayout, transition: Floats, noise: Floats) -> Floats:
    """Stationary covariance (n, n) of modes and loads; zero for all other states."""
    covariance = np.zeros((layout.size, layout.size))
    for family in layout.families:
        block = (family.span, family.span)
        covariance[block] = stationary_covariance(transition[block], noise[block])
    return covariance


def stationary(layout: StateLayout, noise: SensorNoise, model: DiscreteWingModel) -> Floats:
    """Prior covariance of the state: a wing that has been in this gust for ever, biases at their prior.

    Parameters
    ----------
    layout : StateLayout
        State vector of the airframe.
    noise : SensorNoise
        Noise of the averaged rows.
    model : DiscreteWingModel
        Model that the filter runs on.

    Returns
    -------
    (n, n) float64
    """
    covariance = model.motion_covariance.copy()
    covariance[layout.roll_rate, layout.roll_rate], covariance[layout.roll_accel, layout.roll_accel] = (
        _ROLL_SIGMA_RADPS**2,
        _ROLL_JERK_DENSITY_RAD2PS5 / (2.0 * _ROLL_ACCEL_CORNER_RADPS),
    )
    covariance[layout.bias_states, layout.bias_states] = noise.bias_prior_covariance
    return covariance


def propagation(
    layout: StateLayout, noise: SensorNoise, parameters: WingParameters, step_s: float
) -> tuple[Floats, Floats]:
    """Transition and process noise of the whole state over any time.

    Parameters
    ----------
    layout : StateLayout
        State vector of the airframe.
    noise : SensorNoise
        Noise of the averaged rows.
    parameters : (symmetric, antisymmetric)
        Modal and gust parameters of each family.
    step_s : float
        Time h of one step, s.

    Returns
    -------
    transition, noise : (n, n) float64
    """
    n = layout.size
    a, q = np.zeros((n, n)), np.zeros((n, n))
    modal = slice(0, layout.antisymmetric.span.stop)
    a[modal, modal], q[modal, modal] = modal_propagation(layout, parameters, step_s)
    rigid = slice(layout.roll_rate, layout.roll_accel + 1)
    a[rigid, rigid], q[rigid, rigid] = _rigid_propagation(step_s, senses_roll=layout.senses_roll)
    decay = float(np.exp(-step_s / noise.bias_time_s))
    a[layout.bias_states, layout.bias_states] = decay * np.eye(len(layout.row_bias_states))
    q[layout.bias_states, layout.bias_states] = noise.bias_prior_covariance * (1.0 - decay**2)
    return a, q


@functools.lru_cache(maxsize=4)
def _rigid_propagation(step_s: float, *, senses_roll: bool) -> tuple[Floats, Floats]:
    """Transition and process noise (2, 2) of the rigid roll, which depends on no modal parameter.

    A rate that no station sends dies away: a free integral would wander without bound.
    """
    system = np.array([[0.0 if senses_roll else -1.0 / _ROLL_TIME_S, 1.0], [0.0, -_ROLL_ACCEL_CORNER_RADPS]])
    return van_loan(system, np.diag([0.0, _ROLL_JERK_DENSITY_RAD2PS5]), step_s)


def modal_propagation(layout: StateLayout, parameters: WingParameters, step_s: float) -> tuple[Floats, Floats]:
    """Transition and process noise of the modes and their loads, the leading block of the state.

    Parameters
    ----------
    layout : StateLayout
        State vector of the airframe.
    parameters : (symmetric, antisymmetric)
        Modal and gust parameters of each family.
    step_s : float
        Time h of one step, s.

    Returns
    -------
    transition, noise : (m, m) float64
    """
    m = layout.antisymmetric.span.stop
    a, q = np.zeros((m, m)), np.zeros((m, m))
    for family, values in zip(layout.families, parameters, strict=True):
        a[family.span, family.span], q[family.span, family.span] = van_loan(*_family_system(values), step_s)
    return a, q


def _family_system(p: ModeParameters) -> tuple[Floats, Floats]:
    """Continuous system matrix (4 m, 4 m) of one family and the two-sided density of its white noise."""
    p = p.cautious()
    size = MODE_STATES * len(p.modes)
    f, w = np.zeros((size, size)), np.zeros((size, size))
    corner_1, corner_2 = 2.0 * np.pi * p.corner_1_hz, 2.0 * np.pi * p.corner_2_hz
    for q, mode, white_load in zip(range(0, size, MODE_STATES), p.modes, p.white_loads, strict=True):
        v, gust_1, gust_2 = q + 1, q + 2, q + 3
        omega = 2.0 * np.pi * mode.frequency_hz
        f[q, v], f[v, q], f[v, v], f[v, gust_2] = 1.0, -(omega**2), -2.0 * mode.damping * omega, 1.0
        f[gust_1, gust_1], f[gust_2, gust_1], f[gust_2, gust_2] = -corner_1, corner_2, -corner_2
        w[gust_1, gust_1] = corner_1**2 * white_load / 2.0
        for other in range(2, q, MODE_STATES):  # the loads of the modes below
            coherence = p.modes[other // MODE_STATES].coherence * mode.coherence
            w[other, gust_1] = w[gust_1, other] = coherence * np.sqrt(w[other, other] * w[gust_1, gust_1])
    return f, w


def _shape_terms(family: ModeFamily) -> list[tuple[int, int, float]]:
    """Deflection state, rate state and slope factor (rad/m) of each mode."""
    return [(q, v, mode.slope_factor_radpm.value) for (q, v), mode in zip(family.pairs, family.modes, strict=True)]


def slope_rows(layout: StateLayout) -> Floats:
    """Rows that give the left and right tip slope (rad) from a state, (2, n)."""
    rows = np.zeros((2, layout.size))
    for family in layout.families:
        for q, _, factor in _shape_terms(family):
            rows[:, q] = np.array(family.sign) * factor
    return rows


def lift_rows(layout: StateLayout, rank: int) -> tuple[Floats, Floats]:
    """Rows (2, n) that give, from a state, both tips' lift (m) by the modes of a rank, and those that give its rate."""
    lift, rate = np.zeros((2, layout.size)), np.zeros((2, layout.size))
    for family in layout.families:
        for q, v in family.pairs[rank : rank + 1]:
            lift[:, q] = rate[:, v] = family.sign
    return lift, rate


@functools.lru_cache(maxsize=4)
def _measurement_rows(layout: StateLayout, lever_y_m: tuple[float, float], h: float) -> tuple[Floats, Floats]:
    """Measurement matrices ``H0``, ``H1`` on the state before and after a step of ``h``, (9, n) each.

    Modal parameters change neither.
    """
    before, after = np.zeros((ROWS, layout.size)), np.zeros((ROWS, layout.size))
    roll_rate = [layout.roll_rate, layout.roll_accel]
    mean_before, mean_after = np.array([0.5, h / 12.0]), np.array([0.5, -h / 12.0])
    # a positive slope turns the left tip about +x, the right about -x
    for side, sense_of_rotation in ((0, 1.0), (1, -1.0)):
        z, m, y, p = Z_LEFT + side, M_LEFT + side, Y_LEFT + side, P_LEFT + side
        for family in layout.families:
            for q, v, factor in _shape_terms(family):
                sign = family.sign[side]
                after[z, v], before[z, v] = -sign / h, sign / h
                after[m, [q, v]] = sign / h * np.array([1.0 / h, -0.5])
                before[m, [q, v]] = sign / h * np.array([-1.0 / h, -0.5])
                slope = sign * factor
                after[y, [q, v]], before[y, [q, v]] = slope * mean_after, slope * mean_before
                after[p, q], before[p, q] = sense_of_rotation * slope / h, -sense_of_rotation * slope / h
        lever = lever_y_m[side]  # the rigid roll acceleration lifts one tip and lowers the other
        after[z, layout.roll_rate], before[z, layout.roll_rate] = lever / h, -lever / h
        after[m, layout.roll_accel], before[m, layout.roll_accel] = lever / 12.0, -lever / 12.0
        after[p, roll_rate], before[p, roll_rate] = mean_after, mean_before
    after[P_ROOT, roll_rate], before[P_ROOT, roll_rate] = mean_after, mean_before
    for row, index in layout.row_bias_states:
        before[row, index] = 1.0  # of the lateral rows: divided by the vertical specific force at each step
    return before, after

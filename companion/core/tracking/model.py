"""The discrete wing model that the filter runs on: what one averaged step of all sensors says about the state.

Each family obeys ``q'' + 2 zeta omega q' + omega^2 (q - q_static) = g`` with ``g`` white noise through two real
poles; a second mode has a load of the same colour, in part the same. Over one step of length h the sensors deliver:

- vertical, mean of ``-w''`` = ``-(w1' - w0') / h``, exactly, gust load included, so that measurement and process
  noise are correlated in the way they are in nature;
- vertical, first moment ``integral (t - middle) (-w'') dt / h^2`` = ``-((w1' + w0')/2 - (w1 - w0)/h) / h``, exactly:
  under a nearly white gust the path inside the step would be lost without it;
- lateral over vertical specific force: mean slope, ``(psi0 + psi1)/2 - h (psi1' - psi0')/12``, error (omega h)^4/720;
- roll rate: mean slope rate ``(psi1 - psi0) / h``, exactly, on top of the rigid roll rate.

All are linear in the state before and after the step: ``z = H1 x1 + H0 x0 + noise`` with ``x1 = A x0 + b u + w``.
The rigid roll acceleration has 3 rad/s^2 below 5 Hz: far more than the gyros leave open, and yet smooth. As white noise
it would be unphysical, and a vertical-only antisymmetric mode would drown in the root gyro's differentiated noise.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from companion.core.tracking.discretise import stationary_covariance, van_loan
from companion.core.tracking.parameters import ModeParameters
from companion.core.tracking.states import (
    FAMILY_STATES,
    M_LEFT,
    P_LEFT,
    P_ROOT,
    ROWS,
    Y_LEFT,
    Z_LEFT,
    Family,
    Layout,
    Noise,
)
from companion.records import Floats

Parameters = tuple[ModeParameters, ModeParameters]
_TURN_RADPS2, _TURN_CORNER_RADPS = 3.0, 2.0 * np.pi * 5.0
_ROUGH = 0.02
_ROLL_SIGMA_RADPS = 3.0  # before the first measurement


@dataclass(frozen=True, slots=True)
class StepModel:
    """One step of the wing and its sensors.

    Attributes
    ----------
    step_s : float
    parameters : (symmetric, antisymmetric)
    transition : (n, n + 1) float64
        ``[A | b]``: the last column takes the static bend.
    sense : (9, n + 1) float64
        ``G``: the measurement in terms of state and static bend before the step.
    noise : (n, n) float64
        Process noise Q.
    cross : (n, 9) float64
        ``Q H1^T``.
    measured : (9, 9) float64
        ``H1 Q H1^T``, to which sensor noise is added.
    slope : (2, n) float64
        Left and right tip slope of a state.
    cut : float
        Variance that a vertical mean has on average by edges that cut samples.
    rough : bool
        The load is so white that the path inside a step matters beside a gyro's noise: the moments tell it.
    """

    step_s: float
    parameters: Parameters
    transition: Floats
    sense: Floats
    noise: Floats
    cross: Floats
    measured: Floats
    slope: Floats
    cut: float
    rough: bool


def build_model(
    layout: Layout, noise: Noise, parameters: Parameters, lever_y_m: tuple[float, float], step_s: float
) -> StepModel:
    """Discretise the wing with these parameters; ``lever_y_m`` places the tips relative to the root (body y)."""
    n = layout.size
    a, q = propagation(layout, noise, parameters, step_s)
    before, after = _rows(layout, lever_y_m, step_s)
    bend = np.zeros(n)
    bend[layout.symmetric.q] = 1.0
    transition = np.hstack([a, (bend - a @ bend)[:, None]])
    sense = after @ transition
    sense[:, :n] += before
    measured = after @ q @ after.T
    cut = 0.0
    for family in layout.families:  # the path between two samples is not in what is made of samples
        load = q[family.v, family.v]
        lost = load * noise.sample_s**2 / (12.0 * step_s**4)
        measured[M_LEFT:Y_LEFT, M_LEFT:Y_LEFT] += lost * np.eye(2)  # each tip's samples lie at instants of their own
        # a cell's edge cuts a sample, each tip's at another place: a bridge of variance density * sample / 6 at each
        cut += load * noise.sample_s / (3.0 * step_s**3)
    slopes = slope_rows(layout)
    path = sum(q[family.v, family.v] * slopes[1, family.q] ** 2 for family in layout.families) / 12.0
    rough = bool(path > _ROUGH * noise.own[P_LEFT:P_ROOT].min())
    return StepModel(step_s, parameters, transition, sense, q, q @ after.T, measured, slopes, float(cut), rough)


def stationary(layout: Layout, noise: Noise, model: StepModel) -> Floats:
    """Covariance of a wing that has been in this gust for ever (biases: their prior), (n, n)."""
    static = np.zeros((layout.size, layout.size))
    for family in layout.families:
        own = (family.span, family.span)
        static[own] = stationary_covariance(model.transition[own], model.noise[own])
    static[layout.roll, layout.roll], static[layout.turn, layout.turn] = _ROLL_SIGMA_RADPS**2, _TURN_RADPS2**2
    static[layout.biases, layout.biases] = noise.bias_prior
    return static


def propagation(layout: Layout, noise: Noise, parameters: Parameters, step_s: float) -> tuple[Floats, Floats]:
    """Transition and process noise of the whole state over any time ``step_s``: (n, n) each."""
    n = layout.size
    a, q = np.zeros((n, n)), np.zeros((n, n))
    modal = slice(0, layout.antisymmetric.span.stop)
    a[modal, modal], q[modal, modal] = modal_propagation(layout, parameters, step_s)
    rigid = slice(layout.roll, layout.turn + 1)
    a[rigid, rigid], q[rigid, rigid] = _rigid_propagation(step_s)
    decay = float(np.exp(-step_s / noise.bias_time_s))
    a[layout.biases, layout.biases] = decay * np.eye(len(layout.bias))
    q[layout.biases, layout.biases] = noise.bias_prior * (1.0 - decay**2)
    return a, q


@functools.lru_cache(maxsize=4)
def _rigid_propagation(step_s: float) -> tuple[Floats, Floats]:
    """As :func:`propagation`, of the rigid roll, which knows no parameters."""
    corner = _TURN_CORNER_RADPS
    system = np.array([[0.0, 1.0], [0.0, -corner]])
    return van_loan(system, np.diag([0.0, 2.0 * corner * _TURN_RADPS2**2]), step_s)


def modal_propagation(layout: Layout, parameters: Parameters, step_s: float) -> tuple[Floats, Floats]:
    """As :func:`propagation`, of the modes and their loads alone; they come first."""
    m = layout.antisymmetric.span.stop
    a, q = np.zeros((m, m)), np.zeros((m, m))
    for family, values in zip(layout.families, parameters, strict=True):
        a[family.span, family.span], q[family.span, family.span] = van_loan(*_family_system(values), step_s)
    return a, q


def _family_system(p: ModeParameters) -> tuple[Floats, Floats]:
    f, w = np.zeros((FAMILY_STATES, FAMILY_STATES)), np.zeros((FAMILY_STATES, FAMILY_STATES))
    omega, omega_2 = 2.0 * np.pi * p.frequency_hz, 2.0 * np.pi * p.frequency_2_hz
    corner_1, corner_2 = 2.0 * np.pi * p.corner_1_hz, 2.0 * np.pi * p.corner_2_hz
    for q, own, damping in ((0, omega, p.damping), (4, omega_2, p.damping_2)):
        v, gust_1, gust_2 = q + 1, q + 2, q + 3
        f[q, v], f[v, q], f[v, v], f[v, gust_2] = 1.0, -(own**2), -2.0 * damping * own, 1.0
        f[gust_1, gust_1], f[gust_2, gust_1], f[gust_2, gust_2] = -corner_1, corner_2, -corner_2
    w[2, 2] = corner_1**2 * p.white_load / 2.0
    w[6, 6] = corner_1**2 * p.white_load_2 / 2.0
    w[2, 6] = w[6, 2] = p.coherence * np.sqrt(w[2, 2] * w[6, 6])
    return f, w


def _shape_terms(family: Family) -> list[tuple[int, int, float]]:
    return [
        (family.q, family.v, family.mode.slope_factor_radpm.value),
        (family.q2, family.v2, family.second.slope_factor_radpm.value),
    ]


def slope_rows(layout: Layout) -> Floats:
    """Tip slopes, left and right, of a state: (2, n)."""
    rows = np.zeros((2, layout.size))
    for family in layout.families:
        for q, _, factor in _shape_terms(family):
            rows[:, q] = np.array(family.sign) * factor
    return rows


@functools.lru_cache(maxsize=4)
def _rows(layout: Layout, lever_y_m: tuple[float, float], h: float) -> tuple[Floats, Floats]:
    """What the sensors make of the state before and after a step of ``h``, (9, n) each; parameters change neither."""
    before, after = np.zeros((ROWS, layout.size)), np.zeros((ROWS, layout.size))
    roll = [layout.roll, layout.turn]
    mean_before, mean_after = np.array([0.5, h / 12.0]), np.array([0.5, -h / 12.0])
    for side, turn in ((0, 1.0), (1, -1.0)):  # a positive slope turns the left tip about +x, the right about -x
        z, m, y, p = Z_LEFT + side, M_LEFT + side, Y_LEFT + side, P_LEFT + side
        for family in layout.families:
            for q, v, factor in _shape_terms(family):
                sign = family.sign[side]
                after[z, v], before[z, v] = -sign / h, sign / h
                after[m, [q, v]] = sign / h * np.array([1.0 / h, -0.5])
                before[m, [q, v]] = sign / h * np.array([-1.0 / h, -0.5])
                slope = sign * factor
                after[y, [q, v]], before[y, [q, v]] = slope * mean_after, slope * mean_before
                after[p, q], before[p, q] = turn * slope / h, -turn * slope / h
        lever = lever_y_m[side]  # the rigid roll acceleration lifts one tip and lowers the other
        after[z, layout.roll], before[z, layout.roll] = lever / h, -lever / h
        after[m, layout.turn], before[m, layout.turn] = lever / 12.0, -lever / 12.0
        after[p, roll], before[p, roll] = mean_after, mean_before
    after[P_ROOT, roll], before[P_ROOT, roll] = mean_after, mean_before
    for row, index in layout.bias:
        before[row, index] = 1.0  # of the lateral rows: divided by the vertical specific force at each step
    return before, after

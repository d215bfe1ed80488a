"""Published quantities of a state with covariance: phase, amplitude, instantaneous frequency, slopes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.core.tracking.parameters import DAMPING, FREQUENCY, ModeParameters
from companion.core.tracking.states import ModeFamily, StateLayout
from companion.records import Floats, ModeEstimate


@dataclass(frozen=True, slots=True)
class TipEstimate:
    """Modal coordinates, rates and tip slopes: ``[q (2), q' (2), slope (2)]``, m, m/s, rad, with covariance.

    Attributes
    ----------
    values : (6,) float64
    covariance : (6, 6) float64
    slow_slope_sigma_rad : float
        Sigma of one tip's symmetric slope by bias parameters and drifting biases.
    """

    values: Floats
    covariance: Floats
    slow_slope_sigma_rad: float


def tip_output_matrix(layout: StateLayout, slope: Floats) -> Floats:
    """Rows that give ``[q_sym, q_anti, q_sym', q_anti', slope_left, slope_right]`` from a state.

    Parameters
    ----------
    layout : StateLayout
        State vector of the airframe.
    slope : (2, n) float64
        From :func:`companion.core.tracking.model.slope_rows`.

    Returns
    -------
    (6, n) float64
    """
    rows = np.zeros((6, layout.size))
    for at, family in enumerate(layout.families):
        rows[at, family.q] = rows[2 + at, family.v] = 1.0
    rows[4:] = slope
    return rows


def slope_factor_jacobian(layout: StateLayout, state: Floats) -> Floats:
    """Derivative of the left and right tip slope with respect to the bias parameters through the slope factors.

    Parameters
    ----------
    layout : StateLayout
        State vector of the airframe.
    state : (n,) float64
        About which the product of slope factor and deflection is linearised.

    Returns
    -------
    (2, c) float64
        rad per unit of each parameter.
    """
    rows = np.zeros((2, len(layout.bias_parameters)))
    for column, q, _, sign in layout.slope_factors:
        rows[:, column - 1] += np.array(sign) * state[q]
    return rows


def tip_estimate(
    layout: StateLayout,
    rows: Floats,
    state: Floats,
    covariance: Floats,
    bias_sensitivity: Floats,
    bias_parameters: Floats,
    bias_parameter_covariance: Floats,
) -> TipEstimate:
    """Modal coordinates, rates and slopes of a state, with the covariance of state and bias parameters.

    Parameters
    ----------
    layout : StateLayout
        State vector of the airframe.
    rows : (6, n) float64
        From :func:`tip_output_matrix`.
    state : (n,) float64
        State vector.
    covariance : (n, n) float64
        Of the state, given the bias parameters.
    bias_sensitivity : (n, c) float64
        Derivative of the state by the bias parameters.
    bias_parameters : (c,) float64
        Estimates.
    bias_parameter_covariance : (c, c) float64
        Their covariance.

    Returns
    -------
    TipEstimate
    """
    factor = slope_factor_jacobian(layout, state)
    values = rows @ state
    values[4:] += factor @ bias_parameters
    bias_jacobian = rows @ bias_sensitivity
    bias_jacobian[4:] += factor
    total = rows @ covariance @ rows.T + bias_jacobian @ bias_parameter_covariance @ bias_jacobian.T
    mean = 0.5 * (rows[4] + rows[5])
    bias_covariance = covariance[layout.bias_states, layout.bias_states]
    bias_gain = mean @ covariance[:, layout.bias_states]
    slow = bias_gain @ np.linalg.solve(bias_covariance, bias_gain) + 0.25 * float(
        (bias_jacobian[4] + bias_jacobian[5]) @ bias_parameter_covariance @ (bias_jacobian[4] + bias_jacobian[5])
    )
    return TipEstimate(values, 0.5 * (total + total.T), float(np.sqrt(max(slow, 0.0))))


def mode_estimate(
    family: ModeFamily, parameters: ModeParameters, state: Floats, covariance: Floats, static_m: float, rms_m: float
) -> ModeEstimate:
    """Describe one mode as ``q = static + amplitude cos(phase)``, ``q' = -omega amplitude sin(phase)``.

    The instantaneous frequency is the phase's rate by the modal equation, gust load included.

    Parameters
    ----------
    family : ModeFamily
        Which modes.
    parameters : ModeParameters
        Modal and gust parameters of each family.
    state : (n,) float64
        State vector.
    covariance : (n, n) float64
        With the deflection measured from the static bend.
    static_m : float
        Static bend, m.
    rms_m : float
        Activity of the mode, m.

    Returns
    -------
    ModeEstimate
    """
    relative = parameters.log_sigma
    frequency_sigma = parameters.frequency_hz * float(relative[FREQUENCY])
    amplitude, amplitude_sigma, phase, phase_sigma, instantaneous, instantaneous_sigma = _oscillation(
        state,
        covariance,
        (family.q, family.v, family.gust_2),
        static_m,
        parameters.frequency_hz,
        parameters.damping,
        frequency_sigma,
    )
    return ModeEstimate(
        frequency_hz=parameters.frequency_hz,
        frequency_sigma_hz=frequency_sigma,
        damping=parameters.damping,
        damping_sigma=parameters.damping * float(relative[DAMPING]),
        amplitude_m=amplitude,
        amplitude_sigma_m=amplitude_sigma,
        phase_rad=phase,
        phase_sigma_rad=phase_sigma,
        instantaneous_hz=instantaneous,
        instantaneous_sigma_hz=instantaneous_sigma,
        rms_m=rms_m,
    )


@compiled
def _oscillation(
    state: Floats,
    covariance: Floats,
    index: tuple[int, int, int],
    static_m: float,
    frequency_hz: float,
    damping: float,
    frequency_sigma_hz: float,
) -> tuple[float, float, float, float, float, float]:
    """Amplitude, phase and instantaneous frequency of one mode, each with its sigma."""
    q, v, load = state[index[0]] - static_m, state[index[1]], state[index[2]]
    omega = 2.0 * np.pi * frequency_hz
    s = v / omega
    square = q * q + s * s
    power = max(square, 1e-18)
    pull = -2.0 * damping * omega * v - omega**2 * q + load
    rate = (v * s - q * pull / omega) / power
    by_state = np.array([q, s / omega, 0.0]) / np.sqrt(power)
    by_phase = np.array([s, -q / omega, 0.0]) / power
    by_rate = _rate_gradient(q, v, omega, damping, pull, rate, power)
    two_pi = 2.0 * np.pi
    return (
        np.sqrt(square),
        np.sqrt(max(_variance(by_state, covariance, index), 0.0)),
        np.arctan2(-s, q),
        np.sqrt(max(_variance(by_phase, covariance, index), 0.0)),
        rate / two_pi,
        np.sqrt(_variance(by_rate, covariance, index) + (two_pi * frequency_sigma_hz) ** 2) / two_pi,
    )


@compiled
def _variance(by: Floats, covariance: Floats, index: tuple[int, int, int]) -> float:
    """Variance ``g^T P g`` over three states."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += by[i] * by[j] * covariance[index[i], index[j]]
    return total


@compiled
def _rate_gradient(q: float, v: float, omega: float, damping: float, pull: float, rate: float, square: float) -> Floats:
    """Gradient of the phase rate with respect to deflection, rate and load."""
    by_q = (-pull / omega + q * omega - 2.0 * q * rate) / square
    by_v = (2.0 * v / omega + 2.0 * damping * q - 2.0 * v / omega**2 * rate) / square
    return np.array([by_q, by_v, -q / omega / square])

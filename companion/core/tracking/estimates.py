"""Published quantities of a state with covariance: phase, amplitude, instantaneous frequency, slopes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.parameters import DAMPING, FREQUENCY, ModeParameters
from companion.core.tracking.smoother import SmoothedState, error_after
from companion.core.tracking.states import ModeFamily, StateLayout
from companion.native.library import ARRAY, REAL, kernel
from companion.records import Floats, ModeEstimate

_LAG_S = 0.1  # chosen: about the time between two pairs
_LONGEST_S = 5.0  # chosen: beyond, it makes no difference
_SAME_BIAS = 1e-9  # chosen, of a correlation's largest eigenvalue: below, rounding errors alone tell biases apart


@dataclass(frozen=True, slots=True)
class TipEstimate:
    """Modal coordinates, rates and tip slopes: ``[q (2), q' (2), slope (2)]``, m, m/s, rad, with covariance.

    Attributes
    ----------
    values : (6,) float64
    covariance : (6, 6) float64
    slow_slope_sigma_rad : float
        Sigma of one tip's symmetric slope by bias parameters and drifting biases.
    slope_by_bias : (c,) float64
        Derivative of that slope by the bias parameters.
    """

    values: Floats
    covariance: Floats
    slow_slope_sigma_rad: float
    slope_by_bias: Floats


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
    smoothed: SmoothedState,
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
    smoothed : SmoothedState
        State at the instant, given the bias parameters.
    bias_parameters : (c,) float64
        Estimates.
    bias_parameter_covariance : (c, c) float64
        Their covariance.

    Returns
    -------
    TipEstimate
    """
    factor = slope_factor_jacobian(layout, smoothed.state)
    values = rows @ smoothed.state
    values[4:] += factor @ bias_parameters
    bias_jacobian = rows @ smoothed.bias_sensitivity
    bias_jacobian[4:] += factor
    total = rows @ smoothed.covariance @ rows.T + bias_jacobian @ bias_parameter_covariance @ bias_jacobian.T
    mean = 0.5 * (rows[4] + rows[5])
    by_bias: Floats = 0.5 * (bias_jacobian[4] + bias_jacobian[5])
    slow = _variance_by_biases(smoothed.covariance, mean, layout.bias_states) + float(
        by_bias @ bias_parameter_covariance @ by_bias
    )
    return TipEstimate(values, 0.5 * (total + total.T), float(np.sqrt(max(slow, 0.0))), by_bias)


def bias_parameter_estimates(kalman: SeparatedBiasFilter) -> dict[str, tuple[float, float]]:
    """Estimate and sigma of every bias parameter, by name, as deviations from the airframe's."""
    sigma = np.sqrt(np.diag(kalman.bias_parameter_covariance))
    return dict(
        zip(
            kalman.layout.bias_parameters,
            zip(kalman.bias_parameters.tolist(), sigma.tolist(), strict=True),
            strict=True,
        )
    )


def mode_estimate(
    family: ModeFamily, parameters: ModeParameters, state: Floats, covariance: Floats, static_m: float, rms_m: float
) -> ModeEstimate:
    """Describe one mode as ``q = static + amplitude cos(phase)``, ``q' = -omega amplitude sin(phase)``.

    The swing is about the static bend and, as far as that is uncertain, the bend by a slow load.

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
    index = np.array([family.q, family.v, family.gust_2])
    block = covariance[index[:, None], index]
    about = _about_slow_load(block, parameters.frequency_hz)
    amplitude, amplitude_sigma, phase, phase_sigma, instantaneous, instantaneous_sigma = oscillation(
        about @ state[index],
        about @ block @ about.T,
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


def _about_slow_load(covariance: Floats, frequency_hz: float) -> Floats:
    """Map (3, 3) of deflection, rate and load to those about the bend by the part of the load that nobody knows.

    Vertical axes show how far the wing swings, and hardly how far a slow load bends it. What is common to the errors of
    deflection and load is taken out of both, at most the whole bend ``load / omega^2``.
    """
    most = 1.0 / (2.0 * np.pi * frequency_hz) ** 2
    common, load = float(covariance[0, 2]), float(covariance[2, 2])
    ratio = min(max(common / load, 0.0), most) if load > 0.0 else 0.0
    return np.array([[1.0, 0.0, -ratio], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0 - ratio / most]])


_oscillation = kernel("estimate_oscillation", ARRAY, ARRAY, REAL, REAL, REAL, REAL, ARRAY)


def oscillation(
    state: Floats, covariance: Floats, static_m: float, frequency_hz: float, damping: float, frequency_sigma_hz: float
) -> list[float]:
    """Amplitude, phase and instantaneous frequency of a mode, with their sigmas, by deflection, rate and load (3,)."""
    out = np.empty(6)
    _oscillation(state, covariance, static_m, frequency_hz, damping, frequency_sigma_hz, out)
    described: list[float] = out.tolist()
    return described


def fast_slope_time_s(kalman: SeparatedBiasFilter, slope: Floats, step: int) -> float:
    """Correlation time of the error of the mean slope that is not the biases', from the last tenth of a second, s.

    The filter's error at one step, carried on by its closed loop, against its covariance; 0 where too few steps are
    known.

    Parameters
    ----------
    kalman : SeparatedBiasFilter
        Filter with its history.
    slope : (2, n) float64
        From :func:`companion.core.tracking.model.slope_rows`.
    step : int
        At its end.
    """
    lag = round(_LAG_S / kalman.model.step_s)
    first = step - lag
    if first <= kalman.steps - kalman.history_length or first < 0:
        return 0.0
    mean, history, size = 0.5 * (slope[0] + slope[1]), kalman.history, kalman.history_length
    before, after = history.covariance[first % size], history.covariance[step % size]
    by_biases, by_biases_after = (_variance_by_biases(at, mean, kalman.layout.bias_states) for at in (before, after))
    variance = math.sqrt(
        max(float(mean @ before @ mean) - by_biases, 0.0) * max(float(mean @ after @ mean) - by_biases_after, 0.0)
    )
    remaining_variance = float(mean @ error_after(history, first, lag, before @ mean)) - by_biases
    if not 0.0 < remaining_variance < variance:
        return 0.0 if remaining_variance <= 0.0 else _LONGEST_S
    return min(-lag * kalman.model.step_s / math.log(remaining_variance / variance), _LONGEST_S)


def _variance_by_biases(covariance: Floats, mean: Floats, biases: slice) -> float:
    """Part of the mean slope's variance that follows from the drifting biases, rad^2.

    A bias may have no variance, and two may have the root's alone: their covariance may be singular.
    """
    variance = np.diag(covariance)[biases]
    unit = np.divide(1.0, np.sqrt(np.abs(variance)), out=np.zeros(len(variance)), where=variance > 0.0)
    gain = mean @ covariance[:, biases] * unit
    correlation = covariance[biases, biases] * np.outer(unit, unit)
    return float(gain @ np.linalg.pinv(correlation, rcond=_SAME_BIAS, hermitian=True) @ gain)

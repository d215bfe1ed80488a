"""The forecast in plain numpy: ``native/forecast.c``."""

from __future__ import annotations

import numpy as np

from companion.core.tracking.prediction import _FilterSnapshot, _OutputIndices
from companion.records import Floats, Ints


def powers(transition: Floats, noise: Floats, modal_states: Ints, count: int) -> tuple[Floats, Floats]:
    """``E A^k``, (m, count, n), and ``E W_k E^T``, (m, m, count), for the selected states ``E``."""
    transition_powers, process_cov = (
        np.empty((len(modal_states), count, len(noise))),
        np.empty((len(modal_states), len(modal_states), count)),
    )
    rows, covariance = np.eye(len(noise))[modal_states], np.zeros_like(noise)
    for k in range(count):
        rows = rows @ transition
        covariance = transition @ covariance @ transition.T + noise
        transition_powers[:, k], process_cov[:, :, k] = rows, covariance[modal_states][:, modal_states]
    return transition_powers, process_cov


def run_ahead(
    transition_powers: Floats, noise: Floats, slope: Floats, indices: _OutputIndices, snapshot: _FilterSnapshot
) -> tuple[Floats, Floats]:
    """Modal coordinates and slope rates at all instants, (2, k, 2), and covariances, (2, k, 2, 2).

    Modal states follow from the state by ``transition_powers`` (m, k, n), with process covariance ``noise`` (m, m, k).
    The modal coordinates' covariance is that of their deviation from the static bend.
    """
    m, count, n = transition_powers.shape
    static_state = np.zeros(n)
    static_state[indices.static] = snapshot.state_and_sensitivity[-1] @ snapshot.one_and_bias
    from_static = snapshot.state_and_sensitivity[:n].copy()
    from_static[indices.static] -= snapshot.state_and_sensitivity[-1]
    deviation, bias_sensitivity = from_static @ snapshot.one_and_bias, from_static[:, 1:]
    covariance = (
        snapshot.covariance[:n, :n] + bias_sensitivity @ snapshot.bias_parameter_covariance @ bias_sensitivity.T
    )
    outputs = _outputs(slope, indices, snapshot.one_and_bias)
    rows = (outputs @ transition_powers.reshape(m, -1)).reshape(-1, n)
    rows_cov, row_values = (rows @ covariance).reshape(4, count, n), (rows @ deviation).reshape(4, count)
    outputs_noise, unit_weights = (outputs @ noise.reshape(m, -1)).reshape(4, m, count), np.ones(n)
    rows_of, static_values = rows.reshape(4, count, n), outputs @ static_state[indices.modal_states]
    values, spread = np.empty((2, count, 2)), np.empty((2, count, 2, 2))
    for pair in range(2):
        for i in range(2):
            first_output = 2 * pair + i
            values[pair, :, i] = row_values[first_output] + static_values[first_output]
            for j in range(i, 2):
                second_output = 2 * pair + j
                covariance_ij = (rows_cov[first_output] * rows_of[second_output]) @ unit_weights + outputs[
                    second_output
                ] @ outputs_noise[first_output]
                spread[pair, :, i, j] = covariance_ij
                spread[pair, :, j, i] = covariance_ij
    for k in range(len(indices.rate)):
        rate, at = (
            transition_powers[indices.rate[k]] @ deviation + static_state[indices.modal_states[indices.rate[k]]],
            indices.constant[k],
        )
        spread[1, :, 0, 0] += snapshot.bias_parameter_covariance[at, at] * rate**2
        spread[1, :, 1, 1] += snapshot.bias_parameter_covariance[at, at] * rate**2
    return values, spread


def _outputs(slope: Floats, indices: _OutputIndices, one_and_bias: Floats) -> Floats:
    """Rows of modal coordinates and slope rates, slope factors as estimated, on the modal states, (4, m)."""
    outputs = np.zeros((4, slope.shape[1]))
    for side in range(2):
        outputs[side, indices.q[side]] = 1.0
        outputs[2 + side] = slope[side]
        for k in range(len(indices.rate)):
            outputs[2 + side, indices.rate[k]] += indices.signs[k, side] * one_and_bias[1 + indices.constant[k]]
    return outputs


def rate_squares(states: Floats, first: int, count: int, rate_states: Ints, one_and_bias: Floats) -> Floats:
    """Sum of squares of both families' rates over ``count`` steps of the history from ``first`` on, (2,)."""
    rates = states[np.arange(first, first + count) % len(states)][:, rate_states] @ one_and_bias
    squares: Floats = (rates**2).sum(axis=0)
    return squares


def oscillation(
    state: Floats, covariance: Floats, static_m: float, frequency_hz: float, damping: float, frequency_sigma_hz: float
) -> tuple[float, float, float, float, float, float]:
    """Amplitude, phase and instantaneous frequency of one mode, each with its sigma."""
    q, v, load = state[0] - static_m, state[1], state[2]
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
        np.sqrt(max(float(by_state @ covariance @ by_state), 0.0)),
        np.arctan2(-s, q),
        np.sqrt(max(float(by_phase @ covariance @ by_phase), 0.0)),
        rate / two_pi,
        np.sqrt(float(by_rate @ covariance @ by_rate) + (two_pi * frequency_sigma_hz) ** 2) / two_pi,
    )


def _rate_gradient(q: float, v: float, omega: float, damping: float, pull: float, rate: float, square: float) -> Floats:
    """Gradient of the phase rate with respect to deflection, rate and load."""
    by_q = (-pull / omega + q * omega - 2.0 * q * rate) / square
    by_v = (2.0 * v / omega + 2.0 * damping * q - 2.0 * v / omega**2 * rate) / square
    return np.array([by_q, by_v, -q / omega / square])

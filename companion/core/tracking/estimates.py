"""From a state with covariance to what is published: phase, amplitude, instantaneous frequency, slopes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.core.tracking.parameters import DAMPING, FREQUENCY, ModeParameters
from companion.core.tracking.states import Family, Layout
from companion.records import Floats, ModeEstimate


@dataclass(frozen=True, slots=True)
class Tips:
    """Modal coordinates and slopes: ``[q (2), q' (2), slope (2)]`` with covariance.

    Attributes
    ----------
    values : (6,) float64
    covariance : (6, 6) float64
    slow_slope_sigma_rad : float
        Sigma of one tip's symmetric slope by constants and biases.
    """

    values: Floats
    covariance: Floats
    slow_slope_sigma_rad: float


def tip_rows(layout: Layout, slope: Floats) -> Floats:
    """Rows that give ``[q_sym, q_anti, q_sym', q_anti', slope_left, slope_right]`` from a state, (6, n)."""
    rows = np.zeros((6, layout.size))
    for at, family in enumerate(layout.families):
        rows[at, family.q] = rows[2 + at, family.v] = 1.0
    rows[4:] = slope
    return rows


def slope_by_factor(layout: Layout, state: Floats, index: str = "q") -> Floats:
    """Derivative of the tip slopes (``index`` "q") or slope rates ("v") by the constants, (2, c)."""
    rows = np.zeros((2, len(layout.constants)))
    for name, family in zip(("symmetric", "antisymmetric"), layout.families, strict=True):
        first, second = (family.q, family.q2) if index == "q" else (family.v, family.v2)
        for key, at in ((f"slope.{name}", first), (f"slope.second_{name}", second)):
            column = layout.column(key)
            if column is not None:
                rows[:, column - 1] += np.array(family.sign) * state[at]
    return rows


def tips(
    layout: Layout,
    rows: Floats,
    state: Floats,
    covariance: Floats,
    by_constants: Floats,
    constants: Floats,
    constants_covariance: Floats,
) -> Tips:
    """Modal coordinates, rates and slopes of a state, everything unknown in their covariance.

    ``rows`` come from :func:`tip_rows`; ``covariance`` (n, n) is the state's given the constants, ``by_constants``
    (n, c) the state's derivative by them.
    """
    factor = slope_by_factor(layout, state)
    values = rows @ state
    values[4:] += factor @ constants
    turned = rows @ by_constants
    turned[4:] += factor
    total = rows @ covariance @ rows.T + turned @ constants_covariance @ turned.T
    mean = 0.5 * (rows[4] + rows[5])
    shared = covariance[layout.biases, layout.biases]
    leak = mean @ covariance[:, layout.biases]
    slow = leak @ np.linalg.solve(shared, leak) + 0.25 * float(
        (turned[4] + turned[5]) @ constants_covariance @ (turned[4] + turned[5])
    )
    return Tips(values, 0.5 * (total + total.T), float(np.sqrt(max(slow, 0.0))))


def mode_estimate(
    family: Family, parameters: ModeParameters, state: Floats, covariance: Floats, static_m: float, rms_m: float
) -> ModeEstimate:
    """Describe one mode as ``q = static + amplitude cos(phase)``, ``q' = -omega amplitude sin(phase)``.

    ``covariance`` is of the deflection less the static bend. The instantaneous frequency is the phase's rate by the
    modal equation, gust load included.
    """
    relative = parameters.log_sigma
    frequency_sigma = parameters.frequency_hz * float(relative[FREQUENCY])
    amplitude, amplitude_sigma, phase, phase_sigma, instantaneous, instantaneous_sigma = _swing(
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
def _swing(
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
    floor = max(square, 1e-18)
    pull = -2.0 * damping * omega * v - omega**2 * q + load
    rate = (v * s - q * pull / omega) / floor
    by_state = np.array([q, s / omega, 0.0]) / np.sqrt(floor)
    by_phase = np.array([s, -q / omega, 0.0]) / floor
    by_rate = _rate_gradient(q, v, omega, damping, pull, rate, floor)
    turns = 2.0 * np.pi
    return (
        np.sqrt(square),
        np.sqrt(max(_variance(by_state, covariance, index), 0.0)),
        np.arctan2(-s, q),
        np.sqrt(max(_variance(by_phase, covariance, index), 0.0)),
        rate / turns,
        np.sqrt(_variance(by_rate, covariance, index) + (turns * frequency_sigma_hz) ** 2) / turns,
    )


@compiled
def _variance(by: Floats, covariance: Floats, index: tuple[int, int, int]) -> float:
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += by[i] * by[j] * covariance[index[i], index[j]]
    return total


@compiled
def _rate_gradient(q: float, v: float, omega: float, damping: float, pull: float, rate: float, square: float) -> Floats:
    by_q = (-pull / omega + q * omega - 2.0 * q * rate) / square
    by_v = (2.0 * v / omega + 2.0 * damping * q - 2.0 * v / omega**2 * rate) / square
    return np.array([by_q, by_v, -q / omega / square])

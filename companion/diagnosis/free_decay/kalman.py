"""A Kalman filter over many hypotheses at once: modes whose frequency and damping change from step to step.

    u' = omega_0 v,    v' = -(omega^2 / omega_0) u - 2 zeta omega v + load

with u = omega_0 q, m/s; omega and zeta are constant within a step, and the transition over it is exact. An
accelerometer feels load and spring alike, so a sample is the mean acceleration of its step, y = sum of (v_k - v_(k-1))
/ step, plus noise. The load drives both state and sample, and the filter has their covariance. The last state is the
sensor's zero, which wanders.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.native.library import ARRAY, RECORD, kernel, packed
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class Modes:
    """k modes over t steps under a batch of b hypotheses.

    Attributes
    ----------
    omega_radps, zeta : (b, t, k)
    load : (b, t, k)
        Two-sided density of the white load on each mode, (m/s^2)^2 s.
    noise : (b, t)
        Variance of a sample's noise, (m/s^2)^2.
    start : (b,)
        Variance of each mode's acceleration and of the sensor's zero before the first sample, (m/s^2)^2.
    drift : (b,)
        Variance by which the sensor's zero wanders in a second, (m/s^2)^2/s.
    """

    omega_radps: Floats
    zeta: Floats
    load: Floats
    noise: Floats
    start: Floats
    drift: Floats


@dataclass(frozen=True, slots=True)
class Filtered:
    """Innovations and their variances (b, t); predictions a few steps ahead (b, t), stamped when they come true.

    ``state`` (b, t, n) is that after each step.
    """

    innovation: Floats
    variance: Floats
    state: Floats
    ahead: Floats | None = None


class Steps(NamedTuple):
    """A batch in matrices: n states, u and v of each mode and the sensor's zero.

    Attributes
    ----------
    transition, process_noise : (t, b, n, n)
        Of the state over a step, and the covariance of what the load adds.
    H : (t, b, n)
        Row by which the state before a step shows in its sample.
    cross_covariance : (t, b, n)
        Covariance of what the load adds to the state and to the sample.
    variance : (t, b)
        Of the sample given the state before.
    start : (b, n)
        Variances of the state before the first sample.
    """

    transition: Floats
    process_noise: Floats
    H: Floats
    cross_covariance: Floats
    variance: Floats
    start: Floats


_pack_steps = packed(Steps)
_filter = kernel("decay_filter", RECORD, ARRAY, ARRAY, ARRAY, ARRAY)


def run(modes: Modes, y: Floats, step_s: float | Floats, ahead: int = 0) -> Filtered:
    """Filter ``y`` (b, t) under each hypothesis; with ``ahead`` > 0 also predict so many steps.

    Steps are of one length or of each hypothesis's, (b,). The predictions take frequency and damping as they are when
    the prediction is made.
    """
    steps = matrices(modes, step_s)
    count, batch, order = steps.H.shape
    innovation, variance = np.empty((count, batch)), np.empty((count, batch))
    state = np.empty((count, batch, order))
    _filter(_pack_steps(steps), np.ascontiguousarray(y.T), innovation, variance, state)
    return Filtered(innovation.T, variance.T, state.swapaxes(0, 1), _ahead(steps, state, ahead) if ahead else None)


def _ahead(steps: Steps, states: Floats, ahead: int) -> Floats:
    """Sample ``ahead`` steps after each state, by that state's own transition; (b, t)."""
    moved = states[:, :, :, None]
    for _ in range(ahead - 1):
        moved = steps.transition @ moved
    predicted = np.einsum("tbi,tbi->bt", steps.H, moved[..., 0])
    stamped: Floats = np.zeros_like(predicted)
    stamped[:, ahead:] = predicted[:, :-ahead]
    return stamped


def matrices(modes: Modes, step_s: float | Floats) -> Steps:
    """Write a batch as matrices; the steps may be those of each hypothesis, (b,)."""
    omega, zeta, load = (
        np.ascontiguousarray(field_of.swapaxes(0, 1)) for field_of in (modes.omega_radps, modes.zeta, modes.load)
    )
    reference = omega.mean(axis=0, keepdims=True)
    count, batch, several = omega.shape
    order = 2 * several + 1
    transition = np.zeros((count, batch, order, order))
    process_noise = np.zeros_like(transition)
    H, cross_covariance = np.zeros((count, batch, order)), np.zeros((count, batch, order))
    start = np.empty((batch, order))
    variance = modes.noise.T.copy()
    for k in range(several):
        u, v = 2 * k, 2 * k + 1
        (uu, uv, vu, vv), covariance = _step(omega[..., k], zeta[..., k], reference[..., k], step_s)
        for row, column, value in ((u, u, uu), (u, v, uv), (v, u, vu), (v, v, vv)):
            transition[:, :, row, column] = value
        for row, column, value in zip((u, u, v, v), (u, v, u, v), np.array(covariance)[[0, 1, 1, 2]], strict=True):
            process_noise[:, :, row, column] = load[..., k] * value
        H[:, :, u], H[:, :, v] = vu / step_s, (vv - 1.0) / step_s
        cross_covariance[:, :, u], cross_covariance[:, :, v] = (
            process_noise[:, :, u, v] / step_s,
            process_noise[:, :, v, v] / step_s,
        )
        variance += process_noise[:, :, v, v] / step_s**2
        start[:, u] = start[:, v] = modes.start / reference[0, :, k] ** 2
    transition[:, :, -1, -1] = H[:, :, -1] = 1.0
    process_noise[:, :, -1, -1] = modes.drift * step_s
    start[:, -1] = modes.start
    return Steps(transition, process_noise, H, cross_covariance, variance, start)


def _step(
    omega: Floats, zeta: Floats, reference: Floats, step_s: float | Floats
) -> tuple[tuple[Floats, Floats, Floats, Floats], tuple[Floats, Floats, Floats]]:
    """Transition (uu, uv, vu, vv) of a mode, and covariance (uu, uv, vv) that white load of unit density adds."""
    damped = omega * np.sqrt(1.0 - zeta**2)
    fade = np.exp(-zeta * omega * step_s)
    cosine, sine = np.cos(damped * step_s), np.sin(damped * step_s)
    lean, gain = zeta * omega / damped, reference / damped
    moved = (
        fade * (cosine + lean * sine),
        fade * gain * sine,
        -fade * omega**2 / (reference * damped) * sine,
        fade * (cosine - lean * sine),
    )
    # load answers in u as gain e sin and in v as e (cos - lean sin)
    sines, mixed, cosines = _squares(2.0 * zeta * omega, damped, fade, cosine, sine, step_s)
    across = gain * (mixed - lean * sines)
    return moved, (gain**2 * sines, across, cosines - 2.0 * lean * mixed + lean**2 * sines)


def _squares(
    rate: Floats, damped: Floats, fade: Floats, cosine: Floats, sine: Floats, step_s: float | Floats
) -> tuple[Floats, Floats, Floats]:
    """Integrals over a step of e^(-rate t) times sin^2, sin cos and cos^2 of damped t."""
    both, faded = 2.0 * damped, fade**2
    twice_cosine, twice_sine = cosine**2 - sine**2, 2.0 * sine * cosine
    level = -np.expm1(-rate * step_s) / rate
    scale = 1.0 / (rate**2 + both**2)
    waved = scale * (rate * (1.0 - faded * twice_cosine) + both * faded * twice_sine)
    shifted = scale * (both * (1.0 - faded * twice_cosine) - rate * faded * twice_sine)
    return 0.5 * (level - waved), 0.5 * shifted, 0.5 * (level + waved)

"""The steps of the trials' wing: velocity Verlet, one trial after the other; compiled where numba is installed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def _compiled(function: Callable[..., None]) -> Callable[..., None]:
    try:
        from numba import njit
    except ModuleNotFoundError:
        return function
    compiled: Callable[..., None] = njit(cache=True)(function)
    return compiled


class Laws(NamedTuple):
    """Motion of each of n trials' wings; every entry (n,) but where it says otherwise."""

    spring: Array  # (2, n)
    drag: Array  # (2, n)
    white: Array  # (2, n) per root of the step
    coupling: Array
    square: Array
    drag_coupling: Array
    pole: Array  # of the coloured gust; 0 for white
    second_pole: Array
    mix: Array
    kappa: Array
    square_kappa: Array
    beta: Array
    dry: Array
    gap: Array
    drift: Array  # per second
    follow: Array
    omega2: Array  # of the further oscillator
    zeta2: Array
    share2: Array
    drag_along: Array
    swing: Array
    swing_hz: Array
    faster: Array
    air_damping: float
    shake: Array
    shake_hz: Array
    phase: Array
    kick: Array
    kicks: Array  # (3, n) instants
    slip: Array
    reach: Array


class State(NamedTuple):
    """Where n trials' wings are, changed in place: modes (2, n), a further one (n,), gust filters, slipped springs."""

    q: Array
    v: Array
    a: Array
    q2: Array
    v2: Array
    a2: Array
    load: Array
    load2: Array
    stretch: Array


class Recorded(NamedTuple):
    """The recording, filled row by row: left and right (m, 2, n), the further oscillator (m, n)."""

    position: Array
    speed: Array
    up: Array
    further: Array


def start(n: int) -> State:
    """At rest."""
    pair, single = (2, n), (n,)
    return State(*(np.zeros(shape) for shape in (pair, pair, pair, single, single, single, pair, pair, pair)))


def _advance(
    laws: Any, state: Any, recorded: Any, noise: Any, first: int, dt: float, begun_s: float, channels: Any, keep: int
) -> None:
    """Take ``len(noise)`` steps from number ``first``; ``noise`` (b, 3, n), ``channels`` (b, 2): roller, airspeed."""
    for i in range(noise.shape[2]):
        q_s, q_a, v_s, v_a = state.q[0, i], state.q[1, i], state.v[0, i], state.v[1, i]
        a_s, a_a, q2, v2, a2 = state.a[0, i], state.a[1, i], state.q2[i], state.v2[i], state.a2[i]
        load_s, load_a, late_s, late_a = state.load[0, i], state.load[1, i], state.load2[0, i], state.load2[1, i]
        held_l, held_r = state.stretch[0, i], state.stretch[1, i]
        k_s, k_a, c_s, c_a = laws.spring[0, i], laws.spring[1, i], laws.drag[0, i], laws.drag[1, i]
        pole, pole2, gap, reach = laws.pole[i], laws.second_pole[i], laws.gap[i], laws.reach[i]
        c2, k2 = 2.0 * laws.zeta2[i] * laws.omega2[i], laws.omega2[i] ** 2
        for k in range(noise.shape[0]):
            t = (first + k) * dt + begun_s
            v_s, v_a, v2 = v_s + 0.5 * dt * a_s, v_a + 0.5 * dt * a_a, v2 + 0.5 * dt * a2
            q_s, q_a, q2 = q_s + dt * v_s, q_a + dt * v_a, q2 + dt * v2
            load_s = pole * load_s + (1.0 - pole) * laws.white[0, i] * noise[k, 0, i]
            load_a = pole * load_a + (1.0 - pole) * laws.white[1, i] * noise[k, 1, i]
            late_s = pole2 * late_s + (1.0 - pole2) * load_s
            late_a = pole2 * late_a + (1.0 - pole2) * load_a
            roller, air = channels[k, 0], channels[k, 1]
            swung = 1.0 + laws.swing[i] * math.cos(2.0 * math.pi * laws.swing_hz[i] * t + laws.phase[i])
            wandered = 1.0 + laws.drift[i] * max(t, 0.0) + laws.follow[i] * roller + laws.faster[i] * air
            stiff = wandered**2 * laws.square[i] * swung
            f_s = late_s + laws.mix[i] * late_a - stiff * k_s * q_s - laws.coupling[i] * q_a - laws.drag_along[i] * q2
            f_a = late_a + laws.mix[i] * late_s - stiff * k_a * q_a - laws.coupling[i] * q_s
            f_s += laws.shake[i] * math.cos(2.0 * math.pi * laws.shake_hz[i] * t + laws.phase[i])
            for j in range(3):
                if laws.kick[i] != 0.0 and t <= laws.kicks[j, i] < t + dt:
                    f_s += laws.kick[i] / dt
            w_l, w_r, r_l, r_r = q_s - q_a, q_s + q_a, v_s - v_a, v_s + v_a
            # Bouc and Wen: the spring's stretch follows the deflection and yields smoothly
            ratio_l, ratio_r = (held_l / reach) ** 2, (held_r / reach) ** 2
            held_l += dt * (r_l - 0.5 * ratio_l * (r_l + abs(r_l) * (1.0 if held_l > 0.0 else -1.0)))
            held_r += dt * (r_r - 0.5 * ratio_r * (r_r + abs(r_r) * (1.0 if held_r > 0.0 else -1.0)))
            play_l, play_r = min(max(w_l, -abs(gap)), abs(gap)), min(max(w_r, -abs(gap)), abs(gap))
            sign = 1.0 if gap > 0.0 else -1.0
            bent_l = laws.kappa[i] * w_l**3 + laws.square_kappa[i] * w_l**2 - sign * play_l
            bent_r = laws.kappa[i] * w_r**3 + laws.square_kappa[i] * w_r**2 - sign * play_r
            law_l = k_s * (laws.slip[i] * (w_l - held_l) - bent_l)
            law_r = k_s * (laws.slip[i] * (w_r - held_r) - bent_r)
            law_l -= laws.beta[i] * abs(r_l) * r_l + laws.dry[i] * math.tanh(r_l / 0.005)
            law_r -= laws.beta[i] * abs(r_r) * r_r + laws.dry[i] * math.tanh(r_r / 0.005)
            f_s, f_a = f_s + 0.5 * (law_l + law_r), f_a + 0.5 * (law_r - law_l)
            # the drag is implicit in the second half of the step
            thicker = 1.0 + laws.air_damping * laws.faster[i] * air
            b_s, b_a, b_sa = c_s * thicker, c_a * thicker, laws.drag_coupling[i]
            half_s, half_a = v_s + 0.5 * dt * (f_s - b_sa * v_a), v_a + 0.5 * dt * (f_a - b_sa * v_s)
            v_s, v_a = half_s / (1.0 + 0.5 * dt * b_s), half_a / (1.0 + 0.5 * dt * b_a)
            a_s, a_a = f_s - b_s * v_s - b_sa * v_a, f_a - b_a * v_a - b_sa * v_s
            f2 = laws.white[0, i] * noise[k, 2, i] - k2 * q2 - laws.drag_along[i] * q_s
            v2 = (v2 + 0.5 * dt * f2) / (1.0 + 0.5 * dt * c2)
            a2 = f2 - c2 * v2
            row = (first + k) // keep
            if (first + k) % keep == keep - 1:
                recorded.position[row, 0, i], recorded.position[row, 1, i] = q_s - q_a, q_s + q_a
                recorded.speed[row, 0, i], recorded.speed[row, 1, i] = v_s - v_a, v_s + v_a
                recorded.further[row, i] = q2
            # samples are means over a period, as an accelerometer's own filter makes them
            recorded.up[row, 0, i] += (a_s - a_a + laws.share2[i] * a2) / keep
            recorded.up[row, 1, i] += (a_s + a_a + laws.share2[i] * a2) / keep
        state.q[0, i], state.q[1, i], state.v[0, i], state.v[1, i] = q_s, q_a, v_s, v_a
        state.a[0, i], state.a[1, i], state.q2[i], state.v2[i], state.a2[i] = a_s, a_a, q2, v2, a2
        state.load[0, i], state.load[1, i], state.load2[0, i], state.load2[1, i] = load_s, load_a, late_s, late_a
        state.stretch[0, i], state.stretch[1, i] = held_l, held_r


advance = _compiled(_advance)

"""An independent truth for blind trials: two wing halves or two modes, integrated by velocity Verlet, many at once.

Imports nothing of Spanwise. Every trial of a batch is one entry of the last axis, so that a minute of 4 kHz steps costs
seconds for dozens of trials. Units SI; up positive; sides are [left, right].

w_s'' + 2 z_s W_s w_s' + W_s^2 w_s = g_s and the same for a: s = (wR + wL)/2, a = (wR - wL)/2, plus whatever is hidden.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tools.trial_truths.steps import Laws, Recorded, advance, start

Array = npt.NDArray[np.float64]
STEP_HZ = 4000
SAMPLE_HZ = 1000
GRAVITY = 9.80665
_RUN_IN_S = 3.0
_BLOCK = 4000
_AIR_DAMPING = 8.0  # airspeed moves the damping this much more than the frequency


@dataclass(frozen=True)
class World:
    """The wing that really flies, one entry per trial; every array (n,)."""

    frequency_hz: Array  # (2, n) symmetric, antisymmetric
    damping: Array  # (2, n)
    rms_m: Array  # (2, n)
    slope_radpm: Array
    trim_m: Array
    corner_hz: Array  # 0 white


def integrate(
    world: World, hidden: Mapping[str, Array], duration_s: float, rng: np.random.Generator
) -> dict[str, Array]:
    """Fly. Gives ``t_s`` (m,), ``w_m``, ``v_mps`` and ``up_mps2`` (m, 2, n) at 1 kHz; accelerations are at ``t_up_s``.

    ``hidden`` has the magnitude of each hidden effect per trial, (n,), zero where it is absent.
    """
    n = world.slope_radpm.shape[0]
    zero = np.zeros(n)

    def of(name: str) -> Array:
        return hidden.get(name, zero)

    omega = 2 * np.pi * world.frequency_hz * (1.0 + of("frequency-shift"))
    spring, drag = omega**2, 2.0 * world.damping * (1.0 + of("damping-shift")) * omega
    pair = np.sqrt(spring[0] * spring[1])
    split = of("left-right-frequency")
    coupling, square = 2.0 * split * pair, 1.0 + split**2
    drag_coupling = of("left-right-damping") * np.sqrt(drag[0] * drag[1])
    # intensity of white load that gives the wanted rms: variance = S/(4 zeta omega^3), S one number per rad/s two-sided
    believed = 2 * np.pi * world.frequency_hz
    white = np.sqrt(4.0 * world.damping * believed**3) * world.rms_m
    dt = 1.0 / STEP_HZ
    pole = np.exp(-dt * 2 * np.pi * world.corner_hz)
    coloured = world.corner_hz > 0
    lag = np.sqrt(of("coloured-gust"))
    second_pole = np.where(lag > 0, np.exp(-dt / np.maximum(lag, 1e-9)), 0.0)
    mix = of("left-right-forcing")
    kappa, square_kappa = of("cubic-stiffness"), of("quadratic-stiffness")
    beta, dry, gap = of("quadratic-damping"), of("coulomb-friction"), of("freeplay")
    drift, follow = of("frequency-drift") / 60.0, of("covariate-frequency")
    # one further oscillator stands for a second mode, a close one, or torsion that the first drags along
    close, twist = of("close-mode") > 0, of("torsion-coupling") > 0
    omega2 = 2 * np.pi * np.where(of("second-mode.frequency_hz") > 0, of("second-mode.frequency_hz"), 20.0)
    omega2 = np.where(close, omega[0] * (1.0 + of("close-mode.ratio")), omega2)
    omega2 = np.where(twist, 2 * np.pi * np.maximum(of("torsion-coupling.frequency_hz"), 1.0), omega2)
    zeta2 = np.where(close, world.damping[0], 0.02)
    share2 = np.sqrt(of("second-mode") + of("close-mode") + of("torsion-coupling"))
    drag_along = np.sqrt(of("torsion-coupling")) * omega[0] * omega2
    swing, swing_hz = of("parametric-stiffness"), of("parametric-stiffness.frequency_hz")
    faster = of("airspeed-dependence")
    shake, shake_hz = of("periodic-forcing"), of("periodic-forcing.frequency_hz")
    phase = of("phase_rad")
    kick = of("impulsive-forcing")
    kicks = np.stack([of(f"impulsive-forcing.at{k}_s") for k in range(3)])
    slip, reach = of("hysteresis"), np.where(of("hysteresis") > 0, of("hysteresis.yield_m"), 1.0)
    strength = white * np.sqrt(STEP_HZ)
    laws = Laws(
        spring, drag, strength, coupling, square, drag_coupling, np.where(coloured, pole, 0.0), second_pole, mix,
        kappa, square_kappa, beta, dry, gap, drift, follow, omega2, zeta2, share2, drag_along, swing, swing_hz, faster,
        _AIR_DAMPING, shake, shake_hz, phase, kick, kicks, slip, reach,
    )  # fmt: skip
    keep = STEP_HZ // SAMPLE_HZ
    total = round((duration_s + _RUN_IN_S) * STEP_HZ) // keep * keep
    m = total // keep
    recorded = Recorded(*(np.zeros(shape) for shape in ((m, 2, n), (m, 2, n), (m, 2, n), (m, n))))
    state = start(n)
    for first in range(0, total, _BLOCK):
        steps = np.arange(first, min(first + _BLOCK, total))
        noise = rng.standard_normal((_BLOCK, 3, n))[: len(steps)]
        channels = np.array([(roller(t), airspeed(t)) for t in steps * dt - _RUN_IN_S])
        advance(laws, state, recorded, noise, first, dt, -_RUN_IN_S, channels, keep)
    position, speed, up, further = recorded
    # a close mode bends the wing like the first, a second one 3.4 times as steeply: their slopes move the cameras too
    steep = np.where(close, 1.0, np.where(of("second-mode") > 0, 3.4, 0.0))
    position += (steep * share2 * further)[:, None]
    begun = round(_RUN_IN_S * SAMPLE_HZ)
    t_s = np.arange(1, m - begun + 1) / SAMPLE_HZ
    # a mean over four steps stands for their middle
    t_up_s = t_s - 1.5 / STEP_HZ
    return {"t_s": t_s, "t_up_s": t_up_s, "w_m": position[begun:], "v_mps": speed[begun:], "up_mps2": up[begun:]}


def roller(t: float) -> float:
    """A channel that wanders by itself: three incommensurate slow waves of unit rms together."""
    return float(np.sqrt(2.0 / 3.0) * (np.sin(0.31 * t) + np.sin(0.187 * t + 1.0) + np.sin(0.523 * t + 2.0)))


def airspeed(t: float) -> float:
    """Airspeed about its mean in units of its rms: a slow wander of its own."""
    return float(np.sqrt(2.0 / 3.0) * (np.sin(0.23 * t + 0.4) + np.sin(0.41 * t + 2.2) + np.sin(0.147 * t)))

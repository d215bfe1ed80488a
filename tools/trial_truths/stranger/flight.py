"""One flight of the stranger's aircraft: truth about its file, gust, manoeuvres, what is hidden in its motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import signal

from tools.trial_truths.stranger.beam import Array, Modes, modes
from tools.trial_truths.stranger.steps import Laws, Plant, advance, propagated

STEP_HZ = 4000.0
GRAVITY = 9.80665
RUN_IN_S = 3.0
RMS_M = (0.0045, 0.0026)
DAMPING = (0.028, 0.034, 0.022, 0.024, 0.02, 0.02, 0.02, 0.02)
FREQUENCY_SIGMA, HIGHER_SIGMA, DAMPING_SIGMA, SLOPE_SIGMA = 0.01, 0.03, 0.12, 0.008
RMS_SIGMA = 0.2
PER_G_M, PER_G_SIGMA_M = 0.0135, 0.0004
_EVEN = 0.3  # of a mode's load for the one below it: gusts are as wide as the wing
_SHARED = 0.8  # of the load of a mode: of the gust that the half feels; the rest is the mode's own
_HEAVE_RMS, _HEAVE_HZ = 0.03, 0.5
_AIR_DAMPING = 6.0
_FURTHER_SLOPE = 3.1
SPEED_RMS_MPS = 1.7


@dataclass(frozen=True)
class Motion:
    """Motion, at ``STEP_HZ`` from 0 s on: (m,), or (2, m) for left and right.

    ``bend_m`` and ``up_mps2`` are of the tips, the latter against the ground without the rigid aircraft and any roll;
    ``slope`` is the up-bend slope of either camera's station, static bend included.
    """

    t_s: Array
    bend_m: Array
    up_mps2: Array
    slope: Array
    load_factor: Array
    recoil_mps2: Array
    roll_rate_radps: Array
    side_mps2: Array
    roller: Array
    airspeed_mps: Array


def fly(
    effects: Mapping[str, float], extra: Mapping[str, float], manoeuvres: bool, corner_hz: float, duration_s: float,
    rng: np.random.Generator, slow: Mapping[str, float],
) -> Motion:  # fmt: skip
    """Integrate one flight; ``slow`` has the truth of what the file says of trim and slopes (:func:`drawn`)."""
    design, dt = modes(), 1.0 / STEP_HZ
    count = round((duration_s + RUN_IN_S + 0.5) * STEP_HZ)
    t_s = np.arange(count) * dt - RUN_IN_S
    omega, zeta = _truth(design, effects, rng)
    plant = _plant(design, omega, zeta, effects, dt)
    roller, air = wandering(t_s, extra.get("channel_rad", 0.0), 0.29), wandering(t_s, 2.0, 0.21)
    factor = _load_factor(t_s, manoeuvres, rng)
    roll, side = _rolling(t_s, manoeuvres, rng)
    load = _gust(design, omega, zeta, effects, extra, corner_hz, count, rng)
    per_g_m = slow["per_g_m"] * (1.0 + effects.get("load-dependent-bend", 0.0))
    load[0] += omega[0] ** 2 * per_g_m * (factor - 1.0)
    _kick(load, design, effects, extra, t_s, corner_hz)
    wander = 1.0 + effects.get("frequency-drift", 0.0) / 60.0 * np.maximum(t_s, 0.0)
    wander += effects.get("covariate-frequency", 0.0) * roller + effects.get("airspeed-dependence", 0.0) * air
    thick = 1.0 + _AIR_DAMPING * effects.get("airspeed-dependence", 0.0) * air
    laws = _laws(effects, extra, omega[0], duration_s)
    path, accel = advance(plant, laws, load, wander**2, thick, dt, -RUN_IN_S)
    begun = t_s >= -0.25
    path, accel = path[:, begun], accel[:, begun]
    participation, steep = _further(effects)
    q, a = path[:-1], accel[:-1]
    slope = slow["slope"] * (design.slope_radpm @ q) + participation * steep * path[-1]
    slope += slow["slope"] * design.slope_radpm[:, :1] * slow["trim_m"]
    lifted = design.tip + design.heave  # roll_rate has the roll of the fuselage, which tilts the tips along
    return Motion(
        t_s[begun], design.tip @ q, lifted @ a + participation * accel[-1], slope, factor[begun], design.heave @ a,
        roll[begun] - design.roll_radpm @ (np.gradient(q, dt, axis=1)), side[begun], roller[begun],
        18.0 + SPEED_RMS_MPS * air[begun],
    )  # fmt: skip


def drawn(rng: np.random.Generator) -> dict[str, float]:
    """Slow truths of a flight: slopes relative to the design, bend per g and in trim."""
    return {
        "slope": 1.0 + SLOPE_SIGMA * rng.standard_normal(),
        "per_g_m": PER_G_M + PER_G_SIGMA_M * rng.standard_normal(),
        "trim_m": PER_G_M + 0.00015 * rng.standard_normal(),
    }


def mixing_ratio() -> float:
    """Ratio in which a gust that loads the halves unevenly by a small 1 mixes the loads of the first two modes.

    With ``_SHARED`` of a mode's load from the halves' gusts, (1 - t) and (1 + t) times as strong, the cross density of
    the first two is 2 t ``_SHARED``^2 a b, a^2 and b^2 being their own; loads mixed by r have r (a^2 + b^2).
    """
    first, second = np.sqrt(np.sum(modes().gust ** 2, axis=0))[:2].tolist()
    return float(2.0 * _SHARED**2 * first * second / (first**2 + second**2))


def wandering(t_s: Array, phase_rad: float, radps: float) -> Array:
    """A channel of unit rms that wanders by itself."""
    waves = np.sin(radps * t_s + phase_rad) + np.sin(0.613 * radps * t_s + 1.3) + np.sin(1.71 * radps * t_s + 2.6)
    return np.asarray(np.sqrt(2.0 / 3.0) * waves)


def _truth(design: Modes, effects: Mapping[str, float], rng: np.random.Generator) -> tuple[Array, Array]:
    sigma = np.where(np.arange(len(design.frequency_hz)) < 2, FREQUENCY_SIGMA, HIGHER_SIGMA)
    f_hz = design.frequency_hz * np.exp(sigma * rng.standard_normal(len(sigma)))
    zeta = np.array(DAMPING) * np.exp(DAMPING_SIGMA * rng.standard_normal(len(sigma)))
    omega = 2.0 * np.pi * f_hz * (1.0 + effects.get("frequency-shift", 0.0))
    return omega, zeta * (1.0 + effects.get("damping-shift", 0.0))


def _plant(design: Modes, omega: Array, zeta: Array, effects: Mapping[str, float], dt: float) -> Plant:
    tilt, drag = effects.get("left-right-frequency", 0.0), 2.0 * zeta * omega
    coupling = 2.0 * tilt * design.crosswise + tilt**2 * np.diag(omega**2)
    shape = design.crosswise / np.sqrt(np.outer(omega, omega)) ** 2
    drag_coupling = effects.get("left-right-damping", 0.0) * shape * np.sqrt(np.outer(drag, drag))
    per_force = design.mass_kg[0] / design.mass_kg
    return Plant(
        omega**2, drag, *propagated(omega, zeta, dt), design.tip, per_force, coupling, drag_coupling
    )  # fmt: skip


def _gust(
    design: Modes, omega: Array, zeta: Array, effects: Mapping[str, float], extra: Mapping[str, float],
    corner_hz: float, count: int, rng: np.random.Generator,
) -> Array:  # fmt: skip
    """Loads (n + 1, m): each half feels a gust of its own, each mode a part that is its own."""
    n = len(omega)
    white = rng.standard_normal((n + 3, count))
    tilt = effects.get("left-right-forcing", 0.0)
    halves = white[:2] * np.array([[1.0 - tilt], [1.0 + tilt]])
    shared = (design.gust / np.sqrt(np.sum(design.gust**2, axis=0))).T @ halves
    load = np.vstack([_SHARED * shared + np.sqrt(1.0 - _SHARED**2) * white[2:-1], white[-1:]])
    strength = np.sqrt(np.sum(design.gust**2, axis=0))
    load *= np.append(strength / strength[0] * _EVEN ** (np.arange(n) // 2), 1.0)[:, None]
    for corner in _corners(corner_hz * extra.get("corner_ratio", 1.0), effects):
        pole = np.exp(-2.0 * np.pi * corner / STEP_HZ)
        load = signal.lfilter([1.0 - pole], [1.0, -pole], load, axis=1)
    swell = effects.get("swelling-gust", 0.0)
    if swell:
        load *= 1.0 + swell * np.tanh((np.arange(count) / count - 0.55) * 8.0)
    return np.asarray(load * _level(omega, zeta, effects, corner_hz) * extra.get("loudness", 1.0))


def _corners(corner_hz: float, effects: Mapping[str, float]) -> list[float]:
    lag2 = effects.get("coloured-gust", 0.0)
    return ([corner_hz] if corner_hz else []) + ([1.0 / (2.0 * np.pi * np.sqrt(lag2))] if lag2 > 0.0 else [])


def _level(omega: Array, zeta: Array, effects: Mapping[str, float], corner_hz: float) -> float:
    """Load per unit of noise that bends the believed wing by the rms asked for (the density at the first mode)."""
    believed = omega[0] / (1.0 + effects.get("frequency-shift", 0.0))
    damping = zeta[0] / (1.0 + effects.get("damping-shift", 0.0))
    passed = 1.0 if not corner_hz else 1.0 / (1.0 + (believed / (2.0 * np.pi * corner_hz)) ** 2)
    return float(np.sqrt(4.0 * damping * believed**3 / passed * STEP_HZ) * RMS_M[0])


def _kick(
    load: Array, design: Modes, effects: Mapping[str, float], extra: Mapping[str, float], t_s: Array, corner_hz: float
) -> None:
    """Loads that shake the wing at instants or frequencies of its own."""
    del corner_hz
    shake = effects.get("periodic-forcing", 0.0)
    if shake:
        load[0] += shake * np.cos(2.0 * np.pi * extra["periodic-forcing.frequency_hz"] * t_s + extra["phase_rad"])
    sweep = effects.get("run-up", 0.0)
    if sweep:
        t = np.maximum(t_s, 0.0)
        load[0] += sweep * np.sin(2.0 * np.pi * (9.0 * t + 0.5 * 0.22 * t**2))
    blow = effects.get("impulsive-forcing", 0.0)
    for k in range(3 if blow else 0):
        since = t_s - extra[f"impulsive-forcing.at{k}_s"]
        pulse = np.where((since >= 0.0) & (since < 0.006), np.sin(np.pi * since / 0.006), 0.0) * np.pi / 0.012
        load[0] += blow * pulse
        load[1] += 0.4 * blow * pulse * design.tip[1, 1]


def _laws(effects: Mapping[str, float], extra: Mapping[str, float], omega: float, duration_s: float) -> Laws:
    close, twist = effects.get("close-mode", 0.0) > 0.0, effects.get("torsion-coupling", 0.0) > 0.0
    further = 0.0
    for name in ("second-mode", "torsion-coupling"):
        further = 2.0 * np.pi * extra[f"{name}.frequency_hz"] if effects.get(name, 0.0) > 0.0 else further
    further = omega * (1.0 + extra["close-mode.ratio"]) if close else further
    reach_m = extra["hysteresis.yield_m"] if "hysteresis" in effects else 1.0
    return Laws(
        *(effects.get(name, 0.0) for name in ("cubic-stiffness", "quadratic-stiffness", "fifth-stiffness",
        "bilinear-stiffness", "quadratic-damping", "coulomb-friction", "freeplay", "amplitude-damping", "hysteresis")),
        reach_m, effects.get("parametric-stiffness", 0.0), extra.get("parametric-stiffness.frequency_hz", 1.0),
        extra.get("phase_rad", 0.0), effects.get("frequency-jump", 0.0), 0.45 * duration_s, further,
        DAMPING[0] if close else 0.018,
        np.sqrt(effects["torsion-coupling"]) * omega * further if twist else 0.0,
    )  # fmt: skip


def _further(effects: Mapping[str, float]) -> tuple[float, float]:
    """How much of the further oscillator a tip shows, and how it turns the cameras."""
    power = sum(max(effects.get(name, 0.0), 0.0) for name in ("second-mode", "close-mode", "torsion-coupling"))
    steep = 1.37 if "close-mode" in effects else 1.37 * _FURTHER_SLOPE if "second-mode" in effects else 0.0
    return float(np.sqrt(power)), steep


def _load_factor(t_s: Array, manoeuvres: bool, rng: np.random.Generator) -> Array:
    pole = np.exp(-2.0 * np.pi * _HEAVE_HZ / STEP_HZ)
    heave = rng.standard_normal(len(t_s))
    for _ in range(2):
        heave = signal.lfilter([1.0 - pole], [1.0, -pole], heave)
    factor = 1.0 + _HEAVE_RMS * heave / heave.std()
    if manoeuvres:
        for at_s in np.arange(6.0, t_s[-1] - 4.0, 9.0) + rng.uniform(
            -1.5, 1.5, len(np.arange(6.0, t_s[-1] - 4.0, 9.0))
        ):
            factor += rng.uniform(-0.25, 0.5) * _bump(t_s, at_s, 2.4)
    return np.asarray(factor)


def _rolling(t_s: Array, manoeuvres: bool, rng: np.random.Generator) -> tuple[Array, Array]:
    """Roll rate and lateral specific force."""
    roll, side = np.zeros(len(t_s)), 0.4 * wandering(t_s, rng.uniform(0.0, 6.0), 0.8)
    if manoeuvres:
        for at_s in np.arange(9.0, t_s[-1] - 5.0, 11.0):
            roll += rng.choice((-1.0, 1.0)) * 0.5 * (_bump(t_s, at_s, 1.8) - _bump(t_s, at_s + 2.2, 1.8))
            side += rng.uniform(0.5, 1.5) * _bump(t_s, at_s + 1.1, 3.0)
    return roll, side


def _bump(t_s: Array, at_s: float, width_s: float) -> Array:
    x = np.clip((t_s - at_s) / width_s, -0.5, 0.5)
    return np.asarray(np.cos(np.pi * x) ** 2)

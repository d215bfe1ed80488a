"""Blind trials: what is hidden, and the tables that a laboratory would have recorded. Imports nothing of Spanwise.

A trial's label is sealed: only its hash is published before the diagnosis is made.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tools.trial_truths.strengths import (
    CLOSE,
    IN_SAMPLES,
    ONE_WAY,
    close_mode_sigmas,
    participation,
    sigma_of,
    widening,
)
from tools.trial_truths.wing import GRAVITY, Array, World, airspeed, integrate, roller

BASELINE_M = 1.98
FOCAL_PX = 800.0
MATCH_PX = 0.3
AIRSPEED_RMS_MPS = 2.0
BELIEF: dict[str, Any] = {
    "frequency_hz": (5.0, 6.4),
    "frequency_sigma": 0.01,
    "damping": 0.03,
    "damping_sigma": 0.1,
    "slope_radpm": 1.39,
    "slope_sigma": 0.01,
    "trim_m": 0.0149,
    "trim_sigma_m": 0.0002,
    "toe_sigma_rad": 1.4e-4,
    "focal_sigma": 0.00035,
    "scale_sigma": 0.005,
    "delay_sigma_s": 0.0002,
    "bias_sigma_mps2": 0.02,
    "rms_m": (0.005, 0.003),
    "rms_sigma": 0.2,
    "corner_sigma": 0.15,
}


def hide(names: list[str], strength: tuple[float, float], rng: np.random.Generator, snr_db: float = 20.0) -> Hidden:
    """Draw magnitude (in posterior sigmas at this SNR), sign, side and whatever else an effect leaves open."""
    effects = {}
    loudness = float(np.exp(BELIEF["rms_sigma"] * rng.standard_normal()))
    beside = float(rng.choice((-1.0, 1.0)) * rng.uniform(0.0975, 0.1))
    for name in names:
        if name in IN_SAMPLES:
            effects[name] = float(rng.uniform(*IN_SAMPLES[name])) * widening(name, snr_db)
        elif name == "close-mode":
            effects[name] = participation(strength, beside, rng)
        else:
            sign = 1.0 if name in ONE_WAY else rng.choice((-1.0, 1.0))
            size = float(sign * sigma_of(name, snr_db, loudness) * rng.uniform(*strength))
            # a damping ratio is stated by its logarithm
            effects[name] = float(np.expm1(size)) if name == "damping-shift" else size
    extra = {
        "second-mode.frequency_hz": rng.uniform(12.0, 35.0),
        "torsion-coupling.frequency_hz": rng.uniform(10.0, 28.0),
        "close-mode.ratio": beside,
        "parametric-stiffness.frequency_hz": rng.uniform(0.3, 3.0),
        "periodic-forcing.frequency_hz": rng.uniform(3.0, 25.0),
        "tone.frequency_hz": rng.uniform(8.0, 40.0),
        "hysteresis.yield_m": loudness * rng.uniform(0.0015, 0.004),
        "phase_rad": rng.uniform(0.0, 2.0 * np.pi),
        **{f"impulsive-forcing.at{k}_s": rng.uniform(15.0 * k + 5.0, 15.0 * k + 15.0) for k in range(3)},
    }
    extra = {name: float(value) for name, value in extra.items()} | {"loudness": loudness}
    return Hidden(effects, int(rng.integers(0, 2)), rng.bytes(8).hex(), extra)


@dataclass(frozen=True)
class Hidden:
    """Effects that a trial hides: names with magnitudes, and the seal that is published beforehand."""

    effects: dict[str, float]
    side: int = 1
    salt: str = ""
    extra: dict[str, float] = field(default_factory=dict)

    def strength(self, name: str, snr_db: float) -> float:
        """Magnitude in posterior sigmas."""
        if name == "close-mode":
            return float(np.interp(self.effects[name], CLOSE[0], close_mode_sigmas(self.extra["close-mode.ratio"])))
        if name == "damping-shift":
            return abs(float(np.log1p(self.effects[name]))) / sigma_of(name, snr_db)
        return abs(self.effects[name]) / sigma_of(name, snr_db, self.extra.get("loudness", 1.0))

    @property
    def seal(self) -> str:
        """Hash of the label."""
        return hashlib.sha256((self.salt + json.dumps(self.effects, sort_keys=True)).encode()).hexdigest()


@dataclass(frozen=True)
class Tables:
    """One recording: accelerometers (m, 2) vertical specific force, ranges, covariates.

    ``root`` has the axes of a root sensor by letter (z and y in m/s^2, p in rad/s), where there is one.
    """

    t_s: Array
    force_z_mps2: Array
    range_t_s: Array
    range_m: Array
    reference_m: Array
    roller: Array
    airspeed: Array
    root: dict[str, tuple[Array, Array]] = field(default_factory=dict)


def fly(
    hidden: list[Hidden],
    snr_db: float | Sequence[float],
    seed: int,
    duration_s: float = 60.0,
    colour_hz: float | Sequence[float] = 0.0,
) -> list[Tables]:
    """Record every trial: truth drawn from the belief's priors, the hidden effect on top.

    ``snr_db`` and the gust's believed corner ``colour_hz`` (0: white) may differ from trial to trial.
    """
    rng = np.random.default_rng(seed)
    n = len(hidden)
    snr = np.broadcast_to(np.asarray(snr_db, dtype=np.float64), n)
    corner = np.broadcast_to(np.asarray(colour_hz, dtype=np.float64), n)
    names = {name for entry in hidden for name in entry.effects}
    magnitude = {name: np.array([entry.effects.get(name, 0.0) for entry in hidden]) for name in names}
    for key in {key for entry in hidden for key in entry.extra}:
        of = key.partition(".")[0]
        magnitude[key] = np.array(
            [entry.extra.get(key, 0.0) if of in entry.effects or of == key else 0.0 for entry in hidden]
        )
    draw = rng.standard_normal
    world = World(
        np.array(BELIEF["frequency_hz"])[:, None] * np.exp(BELIEF["frequency_sigma"] * draw((2, n))),
        BELIEF["damping"] * np.exp(BELIEF["damping_sigma"] * draw((2, n))),
        np.array(BELIEF["rms_m"])[:, None] * [entry.extra.get("loudness", 1.0) for entry in hidden],
        BELIEF["slope_radpm"] * (1.0 + BELIEF["slope_sigma"] * draw(n)),
        BELIEF["trim_m"] + BELIEF["trim_sigma_m"] * draw(n),
        corner * np.exp(BELIEF["corner_sigma"] * draw(n)),
    )
    flight = integrate(world, magnitude, duration_s, rng)
    return [_record(flight, world, hidden[i], i, float(snr[i]), rng) for i in range(n)]


def noise_density(snr_db: float) -> float:
    """One-sided root density of the accelerometers at which the believed motion has this ratio in the band.

    Tip acceleration of both believed modes (variance omega^4 rms^2, without the gust's own broad part) against noise
    from 1.5 to 51.2 Hz.
    """
    omega = 2 * np.pi * np.array(BELIEF["frequency_hz"])
    variance = float(np.sum((omega**2 * np.array(BELIEF["rms_m"])) ** 2))
    return float(np.sqrt(variance / 10 ** (snr_db / 10) / (51.2 - 1.5)))


def _record(
    flight: dict[str, Array], world: World, hidden: Hidden, i: int, snr_db: float, rng: np.random.Generator
) -> Tables:
    effects, t_s = hidden.effects, flight["t_s"]
    force = np.empty((len(t_s), 2))
    for s in range(2):
        force[:, s] = _force(flight, hidden, i, s, snr_db, rng)
    stamps, recorded = _stamped(t_s, effects, rng)
    at = np.arange(0.1, t_s[-1] - 0.1, 0.1) + rng.uniform(0, 0.04)
    reference = 45.0 + 25.0 * np.sin(2 * np.pi * at / 40.0) + 10.0 * np.sin(2 * np.pi * at / 13.0)
    toe = _toe(flight, world, effects, i, at, rng)
    baseline = BASELINE_M + effects.get("baseline-error", 0.0)
    focal = FOCAL_PX * (1.0 + BELIEF["focal_sigma"] * rng.standard_normal() + effects.get("focal-error", 0.0))
    disparity = focal * (baseline / reference + toe) + MATCH_PX * rng.standard_normal(len(at))
    return Tables(
        stamps,
        force[recorded],
        at,
        FOCAL_PX * BASELINE_M / disparity,
        reference,
        np.array([roller(t) for t in stamps]),
        17.0 + AIRSPEED_RMS_MPS * np.array([airspeed(t) for t in stamps]),
    )


def _force(flight: dict[str, Array], hidden: Hidden, i: int, s: int, snr_db: float, rng: np.random.Generator) -> Array:
    """Vertical specific force (m,) as the accelerometer of one side reads it."""
    effects, t_s = hidden.effects, flight["t_s"]
    here = effects if s == hidden.side else {}  # effects of one side alone
    late = BELIEF["delay_sigma_s"] * rng.standard_normal()
    delay = effects.get("stream-delay", 0.0)
    late += max(delay if s == 1 else -delay, 0.0)
    shift = np.full(len(t_s), late)
    if s == 1:
        shift += effects.get("clock-skew", 0.0) / 60.0 * t_s
    up = _cubic(flight["t_up_s"], flight["up_mps2"][:, s, i], t_s - shift)
    lag = effects.get("sensor-filter", 0.0)
    if lag > 0:
        up = _one_pole(up, np.exp(-0.001 / lag))
    up = up + effects.get("accel-cubic", 0.0) * up**3
    scale = 1.0 + BELIEF["scale_sigma"] * rng.standard_normal() + here.get("accel-scale", 0.0)
    bias = BELIEF["bias_sigma_mps2"] * rng.standard_normal() + here.get("accel-bias", 0.0)
    tone = here.get("tone", 0.0) * np.sin(2 * np.pi * hidden.extra.get("tone.frequency_hz", 17.0) * t_s)
    white = noise_density(snr_db) * np.sqrt(500.0) * rng.standard_normal(len(t_s))
    return _through_converter(-(GRAVITY + up) * scale + bias + tone + white, effects, s == hidden.side)


def _through_converter(force: Array, effects: Mapping[str, float], here: bool) -> Array:
    """A range too small on one side, steps too coarse on both."""
    if here and "saturation" in effects:
        limit = GRAVITY + effects["saturation"]
        force = np.clip(force, -limit, limit)
    step = effects.get("quantisation", 0.0)
    return np.round(force / step) * step if step > 0 else np.round(force, 6)


def _stamped(t_s: Array, effects: Mapping[str, float], rng: np.random.Generator) -> tuple[Array, np.ndarray]:
    """Stamps wander a little (inside specification) or too much, with samples lost."""
    lost = effects.get("dropout-jitter", 0.0)
    recorded = rng.uniform(size=len(t_s)) >= lost
    wander = (2e-5 if not lost else 3e-4) * np.clip(rng.standard_normal(int(recorded.sum())), -1.5, 1.5)
    return t_s[recorded] + wander, recorded


def _toe(
    flight: dict[str, Array], world: World, effects: dict[str, float], i: int, at: Array, rng: np.random.Generator
) -> Array:
    t_s = flight["t_s"]
    jitter_s = np.sqrt(max(effects.get("exposure-jitter", 0.0), 0.0)) * 1e-6
    late = effects.get("exposure-delay", 0.0) + jitter_s * rng.standard_normal(len(at))
    toe = np.full(len(at), effects.get("convergence-offset", 0.0) + BELIEF["toe_sigma_rad"] * rng.standard_normal())
    for s in range(2):
        w = flight["w_m"][:, s, i]
        lag = effects.get("mount-lag", 0.0)
        if lag > 0:
            w = _one_pole(w, np.exp(-0.001 / lag))
        w = _mounted(w, effects)
        gain = 1.0 + (effects.get("camera-asymmetry", 0.0) if s else -effects.get("camera-asymmetry", 0.0))
        toe += gain * world.slope_radpm[i] * (_cubic(t_s, w, at + late) + world.trim_m[i])
    return toe


def _mounted(w: Array, effects: Mapping[str, float]) -> Array:
    """Through a mount that rings, and a shutter that takes its time."""
    softness, readout2 = effects.get("mount-resonance", 0.0), effects.get("rolling-shutter", 0.0)
    if softness > 0:
        from scipy.signal import lfilter

        # trapezoidal rule (Tustin) of 1/(c s^2 + 2 z sqrt(c) s + 1), warped so that it rings where it should
        faster = 1.0 / (np.sqrt(softness) * np.tan(0.5e-3 / np.sqrt(softness)))  # 2000/s for a slow one
        k, d = softness * (0.5 * faster) ** 2, 0.02 * np.sqrt(softness) * 0.5 * faster
        a = np.array([4 * k + 4 * d + 1, 2 - 8 * k, 4 * k - 4 * d + 1])
        w = np.asarray(lfilter(np.array([1.0, 2.0, 1.0]) / a[0], a / a[0], w))
    if readout2 > 0:
        width = max(round(np.sqrt(readout2) * 1000.0), 1)
        shares = np.ones(width + 1)
        shares[[0, -1]] = 0.5
        if width % 2:  # an odd width is centred between samples: split it
            shares = 0.5 * (np.append(shares, 0.0) + np.append(0.0, shares))
        w = np.convolve(w, shares / shares.sum(), mode="same")
    return w


def _one_pole(values: Array, a: float) -> Array:
    """Exact for an input that is straight between samples (first-order lag, time constant -1 ms/ln a)."""
    from scipy.signal import lfilter  # takes most of a second to import

    tau = -0.001 / np.log(a)
    ramp = tau / 0.001 * (1 - a)
    return np.asarray(lfilter([1 - ramp, ramp - a], [1, -a], values))


def _cubic(t: Array, values: Array, at: Array) -> Array:
    """Four-point Lagrange interpolation on an even grid."""
    x = np.clip((at - t[0]) * 1000.0, 1.0, len(t) - 2.001)  # the ends hold
    k = np.clip(np.floor(x).astype(int), 1, len(t) - 3)
    u = x - k
    p0, p1, p2, p3 = (values[k + j] for j in (-1, 0, 1, 2))
    return np.asarray(
        p0 * (-u * (u - 1) * (u - 2) / 6)
        + p1 * ((u + 1) * (u - 1) * (u - 2) / 2)
        - p2 * ((u + 1) * u * (u - 2) / 2)
        + p3 * ((u + 1) * u * (u - 1) / 6)
    )

"""Recording of a flight in the stranger's laboratory: nodes, root sensor and cameras, each with its own chain."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import signal
from scipy.interpolate import CubicSpline

from tools.trial_truths.cases import Hidden, Tables
from tools.trial_truths.stranger.beam import SEMISPAN_M, Array
from tools.trial_truths.stranger.flight import GRAVITY, STEP_HZ, Motion

NODE_HZ, ROOT_HZ, CAMERA_HZ = 800.0, 400.0, 9.0
NODE_CORNER_HZ, ROOT_CORNER_HZ = 188.0, 60.0
TIP_M, BASELINE_M, FOCAL_PX, MATCH_PX = SEMISPAN_M, 2.34, 800.0, 0.3
BAND_HZ = 40.0
SCALE_SIGMA, DELAY_SIGMA_S, BIAS_SIGMA_MPS2 = 0.005, 0.0002, 0.02
TOE_SIGMA_RAD, FOCAL_SIGMA = 0.00014, 0.00035
_ROOT_NOISE_MPS2_RTHZ, _GYRO_NOISE_RADPS_RTHZ = 0.004, 6e-5


def record(motion: Motion, hidden: Hidden, snr_db: float, duration_s: float, rng: np.random.Generator) -> Tables:
    """Pass a motion through every sensor, with what is hidden there."""
    effects, extra = hidden.effects, hidden.extra
    t_s = np.arange(round(duration_s * NODE_HZ)) / NODE_HZ
    rigid = -GRAVITY * motion.load_factor
    turning = np.gradient(motion.roll_rate_radps, 1.0 / STEP_HZ)
    shown = np.stack([_tip(motion, effects, side, rigid, turning) for side in range(2)])
    shown[0] += effects.get("crosstalk", 0.0) * (shown[1] - rigid)
    density = noise_density(motion, snr_db)
    force = np.empty((len(t_s), 2))
    stamps, rows = _stamped(t_s, effects, rng)
    for side in range(2):
        late_s = _late(t_s, side, hidden, duration_s) + DELAY_SIGMA_S * rng.standard_normal()
        force[:, side] = _read(CubicSpline(motion.t_s, shown[side])(t_s - late_s), t_s, side, hidden, density, rng)
    root = _root(motion, rigid, duration_s, rng)
    at_s = np.arange(0.2, duration_s - 0.2, 1.0 / CAMERA_HZ) + rng.uniform(0.0, 0.05)
    reference_m = 42.0 + 18.0 * np.sin(2.0 * np.pi * at_s / 33.0 + extra.get("channel_rad", 0.0))
    reference_m += 8.0 * np.sin(2.0 * np.pi * at_s / 11.0)
    return Tables(
        stamps, force[rows], at_s, _ranges(motion, hidden, at_s, reference_m, rng), reference_m,
        np.interp(stamps, motion.t_s, motion.roller), np.interp(stamps, motion.t_s, motion.airspeed_mps), root,
    )  # fmt: skip


def noise_density(motion: Motion, snr_db: float) -> float:
    """One-sided root density that lies ``snr_db`` below the tips' own motion in the band."""
    lower = signal.butter(4, BAND_HZ, fs=STEP_HZ, output="sos")
    power = float(np.mean(np.var(signal.sosfilt(lower, motion.up_mps2, axis=1), axis=1)))
    return float(np.sqrt(power * 10.0 ** (-0.1 * snr_db) / BAND_HZ))


def _tip(motion: Motion, effects: Mapping[str, float], side: int, rigid: Array, turning: Array) -> Array:
    """Vertical specific force (FRD) of a tip through its own low-pass, before stamps, scale and noise."""
    force = rigid - motion.up_mps2[side] + (TIP_M if side else -TIP_M) * turning
    lag_s = effects.get("sensor-filter", 0.0)
    if lag_s > 0.0:
        top, bottom = signal.butter(2, np.sqrt(2.0) / (2.0 * np.pi * lag_s), fs=STEP_HZ)
        force = force[0] + signal.lfilter(top, bottom, force - force[0])
    top, bottom = signal.butter(2, NODE_CORNER_HZ, fs=STEP_HZ)
    return np.asarray(force[0] + signal.lfilter(top, bottom, force - force[0]))


def _late(t_s: Array, side: int, hidden: Hidden, duration_s: float) -> Array:
    """Lead of a stamp on what it shows, (m,)."""
    effects, extra = hidden.effects, hidden.extra
    delay_s = effects.get("stream-delay", 0.0)
    late = np.full(len(t_s), max(delay_s if side else -delay_s, 0.0))
    skew = effects.get("clock-skew", 0.0) * (1.0 if side else -1.0) / 60.0
    if skew and side == int(extra.get("clock-skew.node", 1.0)):
        late += skew * (t_s - extra.get("clock-skew.set_at", 0.0) * duration_s)
    if side == 1:
        late += effects.get("clock-step", 0.0) * (t_s > 0.4 * duration_s)
    return late


def _read(force: Array, t_s: Array, side: int, hidden: Hidden, density: float, rng: np.random.Generator) -> Array:
    """Scale, bias, bends, noise, converter."""
    effects, here = hidden.effects, side == hidden.side
    up = -force - GRAVITY
    cubic, square = effects.get("accel-cubic", 0.0), effects.get("accel-square", 0.0)
    dead, drift = effects.get("dead-zone", 0.0), effects.get("gain-drift", 0.0)
    up = up + cubic * up**3 + square * up**2
    up = np.sign(up) * np.maximum(np.abs(up) - dead, 0.0) if dead else up
    up = up * (1.0 + drift * (t_s / t_s[-1] - 0.5) * (1.0 if side else -1.0))
    scale = 1.0 + SCALE_SIGMA * rng.standard_normal() + (effects.get("accel-scale", 0.0) if here else 0.0)
    bias = BIAS_SIGMA_MPS2 * rng.standard_normal() + (effects.get("accel-bias", 0.0) if here else 0.0)
    tone = (effects.get("tone", 0.0) if here else 0.0) * np.sin(
        2.0 * np.pi * hidden.extra.get("tone.frequency_hz", 17.0) * t_s + 0.7
    )
    noise = density * np.sqrt(0.5 * NODE_HZ) * rng.standard_normal(len(t_s))
    rattle = effects.get("rattling-node", 0.0) if here else 0.0
    noise *= 1.0 + rattle * (np.abs(t_s / t_s[-1] - 0.6) < 0.15)
    shown = -(GRAVITY + up) * scale + bias + tone + noise
    if here and "saturation" in effects:
        limit = GRAVITY + effects["saturation"]
        shown = np.clip(shown, -limit, limit)
    step = effects.get("quantisation", 0.0)
    return np.asarray(np.round(shown / step) * step if step > 0.0 else np.round(shown, 5))


def _stamped(t_s: Array, effects: Mapping[str, float], rng: np.random.Generator) -> tuple[Array, np.ndarray]:
    """Stamps and the rows that arrive."""
    lost = effects.get("dropout-jitter", 0.0)
    if not lost:
        return t_s + 1e-5 * rng.standard_normal(len(t_s)).clip(-2.0, 2.0), np.ones(len(t_s), dtype=np.bool_)
    rows = rng.uniform(size=len(t_s)) >= lost
    return np.sort(t_s[rows] + 4e-4 * rng.uniform(-1.0, 1.0, int(rows.sum()))), rows


def _root(motion: Motion, rigid: Array, duration_s: float, rng: np.random.Generator) -> dict[str, tuple[Array, Array]]:
    """The autopilot's sensor: z and y (m/s^2), p (rad/s), low-passed."""
    t_s = np.arange(round(duration_s * ROOT_HZ)) / ROOT_HZ
    top, bottom = signal.butter(2, ROOT_CORNER_HZ, fs=STEP_HZ)
    recorded = {"z": rigid - motion.recoil_mps2, "y": motion.side_mps2, "p": motion.roll_rate_radps}
    density = {"z": _ROOT_NOISE_MPS2_RTHZ, "y": _ROOT_NOISE_MPS2_RTHZ, "p": _GYRO_NOISE_RADPS_RTHZ}
    table = {}
    for name, values in recorded.items():
        passed = values[0] + signal.lfilter(top, bottom, values - values[0])
        noise = density[name] * np.sqrt(0.5 * ROOT_HZ) * rng.standard_normal(len(t_s))
        table[name] = (t_s, np.interp(t_s, motion.t_s, passed) + noise)
    return table


def _ranges(motion: Motion, hidden: Hidden, at_s: Array, reference_m: Array, rng: np.random.Generator) -> Array:
    """Ranges of two pinholes that look at one point between them, computed with the file's rigid geometry."""
    effects = hidden.effects
    turned = _mounted(motion.slope, hidden)
    jitter_s = np.sqrt(max(effects.get("exposure-jitter", 0.0), 0.0)) * 1e-6
    wander_s = np.sqrt(2.0) * jitter_s * rng.standard_normal((2, len(at_s)))
    exposed_s = at_s + effects.get("exposure-delay", 0.0) + wander_s
    slope = np.stack([CubicSpline(motion.t_s, turned[side])(exposed_s[side]) for side in range(2)])
    across = at_s / at_s[-1] - 0.5
    toe = effects.get("convergence-offset", 0.0) + TOE_SIGMA_RAD * rng.standard_normal()
    toe = (
        toe
        + effects.get("toe-drift", 0.0) * across
        + effects.get("lens-bend", 0.0) * (slope.sum(0) - slope.sum(0).mean()) ** 2
    )
    baseline_m = BASELINE_M + effects.get("baseline-error", 0.0)
    inward = np.arctan(0.5 * baseline_m / reference_m)
    focal_px = FOCAL_PX * (1.0 + FOCAL_SIGMA * rng.standard_normal() + effects.get("focal-error", 0.0))
    focal_px = focal_px * (1.0 + effects.get("focal-breathing", 0.0) * across)
    disparity = focal_px * np.sum(np.tan(inward + slope + 0.5 * toe), axis=0)
    disparity += effects.get("match-bias", 0.0) * (BASELINE_M * FOCAL_PX / 30.0) * (30.0 / reference_m) ** 3
    disparity += MATCH_PX * rng.standard_normal(len(at_s))
    wild = effects.get("wild-matches", 0.0)
    disparity += (rng.uniform(size=len(at_s)) < wild) * rng.normal(0.0, 8.0 * MATCH_PX, len(at_s))
    return np.asarray(FOCAL_PX * BASELINE_M / disparity)


def _mounted(slope: Array, hidden: Hidden) -> Array:
    """Slopes (2, m) of the cameras on their mounts."""
    effects = hidden.effects
    ratio = effects.get("camera-asymmetry", 0.0)
    both = ratio * hidden.extra.get("camera-asymmetry.both", 0.0)
    turned = slope * np.array([[1.0 + both - ratio], [1.0 + both + ratio]])
    rest = turned[:, :1]
    lag_s, softness = effects.get("mount-lag", 0.0), effects.get("mount-resonance", 0.0)
    if lag_s > 0.0:
        top, bottom = signal.bilinear([1.0], [lag_s, 1.0], STEP_HZ)
        turned = rest + signal.lfilter(top, bottom, turned - rest, axis=1)
    if softness > 0.0:
        top, bottom = signal.bilinear([1.0], [softness, 2.0 * 0.06 * np.sqrt(softness), 1.0], STEP_HZ)
        turned = rest + signal.lfilter(top, bottom, turned - rest, axis=1)
    readout2 = effects.get("rolling-shutter", 0.0)
    if readout2 > 0.0:
        width = 2 * round(0.5 * np.sqrt(readout2) * STEP_HZ) + 1
        turned = rest + signal.convolve(turned - rest, np.ones((1, width)) / width, mode="same")
    play = effects.get("mount-play", 0.0)
    if play:
        turned = np.stack([_through_play(row, play) for row in turned])
    return np.asarray(turned)


def _through_play(slope: Array, play_rad: float) -> Array:
    """A camera that rests until its mount has taken up the play."""
    thin = slope[::10].tolist()
    at, path = thin[0], []
    for value in thin:
        at = min(max(at, value - play_rad), value + play_rad)
        path.append(at)
    return np.interp(np.arange(len(slope)), np.arange(len(thin)) * 10.0, path)

"""A wing as a stranger would simulate it, written as the laboratory's CSV folder. Imports nothing of Spanwise.

Another hand's choices than ``tools.trial_truths.wing``: linear modes are stepped exactly (zero-order hold), forces of
state by Runge and Kutta, the cameras are pinholes that see one point between them, samples are means over their period,
and the noise is 20 dB below the tip acceleration in the band up to 40 Hz, whatever the airframe file says of sensors.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

Array = NDArray[np.float64]
Law = Callable[[float, float], float]
GRAVITY = 9.80665
_SUBSTEPS = 4
_WARM_UP_S = 3.0
_BAND_HZ = 40.0
_CAMERA_HZ = 10.0
_MATCH_PX = 0.3


@dataclass(frozen=True)
class Flight:
    """Flight and hidden effects; all that is not set is as believed, drawn from the airframe's priors."""

    seed: int
    duration_s: float = 30.0
    rate_hz: float = 1000.0
    corners_hz: tuple[float, ...] = (2.0, 20.0)
    snr_db: float = 20.0
    distance_m: float = 40.0
    decimals: int = 6
    """Of the stamps: 3 at 800 Hz is a logger that writes whole milliseconds."""
    law: Law | None = None
    """Acceleration of the first symmetric mode beyond the linear one, of deflection and speed about trim."""
    right_late_s: float = 0.0
    right_scale: float = 1.0
    jump: float = 0.0
    """By what share the first frequency jumps in the middle."""
    camera_gain: tuple[float, float] = (1.0, 1.0)
    """How far each camera turns per turn of its station, left and right."""
    exposure_jitter_s: float = 0.0
    """Each camera's exposure wanders by itself."""
    skew_s_per_min: tuple[float, float] = (0.0, 0.0)
    """What each node's clock gains a minute; both were right in the middle of the recording."""
    sensor_corner_hz: float = 0.0
    """Of a Butterworth filter of second order in both nodes."""
    mount_hz: float = 0.0
    mount_damping: float = 0.05
    """Of an oscillator between each station and its camera."""


@dataclass(frozen=True)
class _Mode:
    frequency_hz: float
    damping: float
    slope_radpm: float
    rms_m: float
    side: tuple[float, float]


def write(folder: Path, airframe: Path, flight: Flight) -> None:
    """Fly, and write ``accel.csv`` and ``range.csv``."""
    believed = tomllib.loads(airframe.read_text(encoding="utf-8"))
    rng = np.random.default_rng(flight.seed)
    dt = 1.0 / (flight.rate_hz * _SUBSTEPS)
    t: Array = np.arange(round((flight.duration_s + 2.0 * _WARM_UP_S) / dt), dtype=np.float64) * dt - _WARM_UP_S
    up, slope = np.zeros((2, len(t))), np.zeros((2, len(t)))
    for k, mode in enumerate(_modes(believed["wing"], rng)):
        load = _gust(rng, len(t), dt, flight.corners_hz)
        q, acceleration = _moved(mode, load, dt, flight if k == 0 else None)
        for side in range(2):
            up[side] += mode.side[side] * acceleration
            slope[side] += mode.side[side] * mode.slope_radpm * q
    slope += _drawn(rng, believed["wing"]["trim_bend_m"]) * _value(believed["wing"]["symmetric"]["slope_factor_radpm"])
    _write_accel(folder, believed, flight, rng, t, up)
    _write_range(folder, believed, flight, rng, t, slope)


def _value(entry: Any) -> float:
    return float(entry["value"] if isinstance(entry, dict) else entry)


def _drawn(rng: np.random.Generator, entry: Any) -> float:
    """One draw from a prior: log-normal, for all that is drawn here is positive by nature."""
    if not isinstance(entry, dict):
        return float(entry)
    return float(entry["value"] * math.exp(rng.normal() * entry["sigma"] / entry["value"]))


def _modes(wing: dict[str, Any], rng: np.random.Generator) -> list[_Mode]:
    rms = _value(wing["gust"]["deflection_rms_m"])
    shapes = {
        "symmetric": ((1.0, 1.0), 1.0),
        "antisymmetric": ((-1.0, 1.0), 0.7),
        "second_symmetric": ((1.0, 1.0), 0.01),
    }
    return [
        _Mode(
            _drawn(rng, wing[name]["frequency_hz"]),
            _drawn(rng, wing[name]["damping"]),
            _drawn(rng, wing[name]["slope_factor_radpm"]),
            fraction * rms,
            side,
        )
        for name, (side, fraction) in shapes.items()
        if name in wing
    ]


def _gust(rng: np.random.Generator, count: int, dt: float, corners_hz: tuple[float, ...]) -> Array:
    load = rng.standard_normal(count)
    for corner_hz in corners_hz:
        pole = math.exp(-2.0 * math.pi * corner_hz * dt)
        top, bottom = np.array([1.0 - pole]), np.array([1.0, -pole])
        load = np.asarray(signal.lfilter(top, bottom, load), dtype=np.float64)
    return load


def _moved(mode: _Mode, load: Array, dt: float, flight: Flight | None) -> tuple[Array, Array]:
    """Deflection and acceleration under a load that is scaled to the mode's rms."""
    omega = 2.0 * math.pi * mode.frequency_hz
    plant = (np.array([1.0]), np.array([1.0, 2.0 * mode.damping * omega, omega**2]))
    top, bottom, _ = signal.cont2discrete(plant, dt)
    q = signal.lfilter(top.ravel(), bottom, load)
    load, q = load * (mode.rms_m / q.std()), q * (mode.rms_m / q.std())
    if flight is not None and (flight.law is not None or flight.jump):
        return _stepped(mode, load, dt, flight)
    return q, load - 2.0 * mode.damping * omega * np.gradient(q, dt) - omega**2 * q


def _stepped(mode: _Mode, load: Array, dt: float, flight: Flight) -> tuple[Array, Array]:
    omega = 2.0 * math.pi * mode.frequency_hz
    damping, law = 2.0 * mode.damping * omega, flight.law or (lambda _q, _v: 0.0)
    stiff = np.full(len(load), omega**2)
    stiff[round((_WARM_UP_S + 0.5 * flight.duration_s) / dt) :] *= (1.0 + flight.jump) ** 2
    q = v = 0.0
    motion = np.empty((2, len(load)))
    half = 0.5 * dt
    for i, (f, k) in enumerate(zip(load.tolist(), stiff.tolist(), strict=True)):
        a1 = f - k * q - damping * v + law(q, v)
        motion[0, i], motion[1, i] = q, a1
        v2, q2 = v + half * a1, q + half * v
        a2 = f - k * q2 - damping * v2 + law(q2, v2)
        v3, q3 = v + half * a2, q + half * v2
        a3 = f - k * q3 - damping * v3 + law(q3, v3)
        v4, q4 = v + dt * a3, q + dt * v3
        a4 = f - k * q4 - damping * v4 + law(q4, v4)
        q += dt / 6.0 * (v + 2.0 * v2 + 2.0 * v3 + v4)
        v += dt / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return motion[0], motion[1]


def _write_accel(
    folder: Path, believed: dict[str, Any], flight: Flight, rng: np.random.Generator, t: Array, up: Array
) -> None:
    at_s = np.arange(round(flight.duration_s * flight.rate_hz)) / flight.rate_hz
    lower = signal.butter(4, _BAND_HZ, fs=flight.rate_hz * _SUBSTEPS, output="sos")
    window = np.array([0.5, *[1.0] * (_SUBSTEPS - 1), 0.5]) / _SUBSTEPS
    rows = [at_s]
    for side, name in enumerate(("left", "right")):
        density = np.var(signal.sosfilt(lower, up[side])) * 10.0 ** (-0.1 * flight.snr_db) / _BAND_HZ
        late_s = rng.normal() * believed[name]["time_offset_sigma_s"] + side * flight.right_late_s
        taken_s = at_s - late_s - flight.skew_s_per_min[side] / 60.0 * (at_s - 0.5 * flight.duration_s)
        mean = np.interp(taken_s, t, np.convolve(_filtered(up[side], flight), window, mode="same"))
        scale = (1.0 + rng.normal() * believed[name]["accel_scale_sigma"]) * (flight.right_scale if side else 1.0)
        noise = rng.standard_normal(len(at_s)) * math.sqrt(0.5 * density * flight.rate_hz)
        rows.append(scale * (-GRAVITY - mean) + noise)
    _save(folder / "accel.csv", "t_s,left_z_mps2,right_z_mps2", rows, (f"%.{flight.decimals}f", "%.5f", "%.5f"))


def _filtered(values: Array, flight: Flight) -> Array:
    if not flight.sensor_corner_hz:
        return values
    top, bottom = signal.butter(2, flight.sensor_corner_hz, fs=flight.rate_hz * _SUBSTEPS)
    return np.asarray(signal.lfilter(top, bottom, values), dtype=np.float64)


def _turned(slope: Array, flight: Flight, dt: float) -> Array:
    """Turn of the cameras, (2, n): gains, then each on its mount."""
    turned = slope * np.array(flight.camera_gain)[:, None]
    if not flight.mount_hz:
        return turned
    omega = 2.0 * math.pi * flight.mount_hz
    mount = (np.array([omega**2]), np.array([1.0, 2.0 * flight.mount_damping * omega, omega**2]))
    top, bottom, _ = signal.cont2discrete(mount, dt)
    rest = turned[:, :1]
    return np.asarray(rest + signal.lfilter(top.ravel(), bottom, turned - rest, axis=1), dtype=np.float64)


def _write_range(
    folder: Path, believed: dict[str, Any], flight: Flight, rng: np.random.Generator, t: Array, slope: Array
) -> None:
    """One point in the middle: seen by the left camera to the right, by the right one to the left; up-bend diverges."""
    left, right = believed["left_camera"], believed["right_camera"]
    baseline_m = right["position_m"][1] - left["position_m"][1]
    at_s = np.arange(0.5 / _CAMERA_HZ, flight.duration_s, 1.0 / _CAMERA_HZ)
    inward = math.atan2(0.5 * baseline_m, flight.distance_m)
    focal_px = _drawn(rng, left["focal_px"])
    seen_s = np.stack([at_s, at_s])
    if flight.exposure_jitter_s:
        seen_s = seen_s + flight.exposure_jitter_s * rng.standard_normal(seen_s.shape)
    turned = _turned(slope, flight, float(t[1] - t[0]))
    disparity_px = focal_px * sum(np.tan(inward + np.interp(seen_s[side], t, turned[side])) for side in range(2))
    disparity_px = disparity_px + _MATCH_PX * rng.standard_normal(len(at_s))
    range_m = _value(left["focal_px"]) * baseline_m / disparity_px
    _save(folder / "range.csv", "t_s,range_m", [at_s, range_m], ("%.6f", "%.5f"))


def _save(file: Path, header: str, columns: list[Array], formats: tuple[str, ...]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(file, np.column_stack(columns), fmt=list(formats), delimiter=",", header=header, comments="")

"""The true wing: every mode driven by its own gust, stepped exactly at 2 kHz, known at any instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.ndimage

from tools.reference.discretise import averages
from tools.reference.load import chain, intensity
from tools.reference.spec import GRAVITY_MPS2, ModeSpec, TruthSpec

Floats = npt.NDArray[np.float64]
STEP_S = 0.0005
SEGMENT_S = 0.02  # a drifting frequency is held for so long


@dataclass(frozen=True, slots=True)
class Errors:
    """Draws from the priors, per seed; stations in the order root, left, right."""

    slope_ratio: Floats  # (S, modes)
    trim_m: Floats  # (S,) added to the believed trim bend
    bend_per_g_m: Floats  # (S,)
    accel_scale: Floats  # (S, 3, 3)
    gyro_scale: Floats  # (S, 3, 3)
    misalignment_rad: Floats  # (S, 3, 3)
    time_offset_s: Floats  # (S, 3)


@dataclass(frozen=True, slots=True)
class TruthRun:
    """Deflections of ``S`` seeds at ``STEP_S``; ``q_m`` and ``v_mps`` are (S, modes, N + 1) about the true trim."""

    spec: TruthSpec
    seeds: tuple[int, ...]
    errors: Errors
    q_m: Floats
    v_mps: Floats

    @property
    def steps(self) -> int:
        """Number of steps."""
        return self.q_m.shape[2] - 1

    def q_at(self, t_s: Floats) -> Floats:
        """Deflection about trim (S, modes, len(t)), cubic Hermite between the steps."""
        index, fraction = _locate(t_s, self.steps)
        q0, q1 = self.q_m[..., index], self.q_m[..., index + 1]
        v0, v1 = self.v_mps[..., index] * STEP_S, self.v_mps[..., index + 1] * STEP_S
        rise = q1 - q0
        cubic = (v0 + v1 - 2 * rise) * fraction + (3 * rise - 2 * v0 - v1)
        return q0 + fraction * (v0 + fraction * cubic)

    def v_at(self, t_s: Floats) -> Floats:
        """Deflection rate (S, modes, len(t)), linear between the steps."""
        index, fraction = _locate(t_s, self.steps)
        return self.v_mps[..., index] * (1 - fraction) + self.v_mps[..., index + 1] * fraction

    def total_at(self, t_s: Floats) -> Floats:
        """Deflection with trim (S, modes, len(t))."""
        q = self.q_at(t_s)
        q[:, 0] += self.trim_m()[:, None]
        return q

    def slope_at(self, t_s: Floats) -> Floats:
        """True slope, trim included, at the left and the right tip, (S, 2, len(t)) rad."""
        factors = np.array([mode.slope_radpm for mode in self.spec.modes]) * (1 + self.errors.slope_ratio)
        parts = factors[:, :, None] * self.total_at(t_s)
        even = parts[:, 0] + parts[:, 2:].sum(axis=1)
        return np.stack([even - parts[:, 1], even + parts[:, 1]], axis=1)

    def trim_m(self) -> Floats:
        """True symmetric trim bend of every seed, (S,)."""
        return self.spec.trim_bend_m + self.errors.trim_m

    def peaks(self, seed_index: int, mode: int, start_s: float) -> list[tuple[float, float]]:
        """Times and deflections of peaks above one rms: the extremum of its surroundings of half a period."""
        q = self.q_m[seed_index, mode]
        width = round(0.5 / self.spec.modes[mode].frequency_hz / STEP_S) | 1
        extremes: list[tuple[float, float]] = []
        rms = self.spec.modes[mode].rms_m
        for sign in (1.0, -1.0):
            top = (scipy.ndimage.maximum_filter1d(sign * q, width) == sign * q) & (sign * q > rms)
            top[:width] = top[-width:] = False
            for k in np.flatnonzero(top):
                if k * STEP_S >= start_s:
                    extremes.append((self._refine(q, int(k)), float(q[k])))
        return sorted(extremes)

    @staticmethod
    def _refine(q: Floats, k: int) -> float:
        left, middle, right = q[k - 1], q[k], q[k + 1]
        bend = left - 2 * middle + right
        return float((k + (0.5 * (left - right) / bend if bend else 0.0)) * STEP_S)


def _locate(t_s: Floats, steps: int) -> tuple[npt.NDArray[np.int64], Floats]:
    at = np.clip(np.asarray(t_s) / STEP_S, 0, steps)
    index = np.minimum(at.astype(np.int64), steps - 1)
    return index, at - index


def simulate(spec: TruthSpec, seeds: tuple[int, ...]) -> TruthRun:
    """Simulate one aircraft in as many independent gusts as there are seeds."""
    steps = round(spec.duration_s / STEP_S)
    errors = _draw(spec, seeds)
    q, v = [], []
    for number, mode in enumerate(spec.modes):
        bend = spec.bend_per_g_m + errors.bend_per_g_m if number == 0 else np.zeros(len(seeds))
        states = _mode(spec, mode, number, seeds, bend, steps)
        q.append(states[:, 0].T)
        v.append(states[:, 1].T)
    return TruthRun(spec, seeds, errors, np.stack(q, axis=1), np.stack(v, axis=1))


def frequency_factor(spec: TruthSpec, number: int, t_s: float) -> float:
    """Factor of a drifting first mode's frequency in the segment that holds ``t_s``."""
    if number > 1 or not spec.drift_per_s:
        return 1.0
    middle = (np.floor(t_s / SEGMENT_S + 1e-6) + 0.5) * SEGMENT_S
    return float(np.exp(spec.drift_per_s * middle))


def _mode(spec: TruthSpec, mode: ModeSpec, number: int, seeds: tuple[int, ...], bend_m: Floats, steps: int) -> Floats:
    """Step one mode; returns (steps + 1, 2, S). The load factor's bend acts as a load omega^2 bend (n - 1)."""
    density = intensity(mode, spec.gust)
    force, _, _ = spec.motion.at((np.arange(steps) + 0.5) * STEP_S)
    excess = -force[:, 2] / GRAVITY_MPS2 - 1
    normal = np.stack([np.random.default_rng([seed, 11, number]).standard_normal((steps, 4)) for seed in seeds], axis=2)
    A, b, _ = chain(mode.frequency_hz, mode.damping, spec.gust)
    x = _stationary(A, b, density, seeds, number)
    out = np.empty((steps + 1, 2, len(seeds)))
    out[0] = x[:2]
    per_segment = round(SEGMENT_S / STEP_S) if spec.drift_per_s else steps
    for start in range(0, steps, per_segment):
        stop = min(start + per_segment, steps)
        frequency = mode.frequency_hz * frequency_factor(spec, number, start * STEP_S)
        F, root, push = _step(frequency, mode.damping, spec, density)
        shock = np.einsum("ij,kjs->kis", root, normal[start:stop, : len(F)])
        shock += push[None, :, None] * excess[start:stop, None, None] * bend_m[None, None, :]
        for k in range(stop - start):
            x = F @ x + shock[k]
            out[start + k + 1] = x[:2]
    return out


def _step(frequency_hz: float, damping: float, spec: TruthSpec, density: float) -> tuple[Floats, Floats, Floats]:
    A, b, _ = chain(frequency_hz, damping, spec.gust)
    n = len(A)
    step = averages(A, b[:, None], np.zeros((1, n)), np.zeros((1, 1)), np.array([[density]]), STEP_S)
    omega = 2 * np.pi * frequency_hz
    held = np.zeros((n + 1, n + 1))
    held[:n, :n], held[1, n] = A, omega**2
    push = scipy.linalg.expm(held * STEP_S)[:n, n]
    return step.F, _root(step.Q), push


def _root(covariance: Floats) -> Floats:
    """Square root by eigenvalues, for the covariance of a short step is numerically singular."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def _stationary(A: Floats, b: Floats, density: float, seeds: tuple[int, ...], number: int) -> Floats:
    root = _root(scipy.linalg.solve_continuous_lyapunov(A, -density * np.outer(b, b)))
    normal = [np.random.default_rng([seed, 12, number]).standard_normal(len(A)) for seed in seeds]
    return root @ np.stack(normal, axis=1)


def _draw(spec: TruthSpec, seeds: tuple[int, ...]) -> Errors:
    generators = [np.random.default_rng([seed, 13]) for seed in seeds]
    modes = len(spec.modes)

    def normal(*shape: int) -> Floats:
        return np.stack([generator.standard_normal(shape) for generator in generators])

    def per_station(field: str) -> Floats:
        return np.array([getattr(sensor, field) for sensor in spec.sensors])

    return Errors(
        slope_ratio=normal(modes) * spec.slope_sigma_ratio,
        trim_m=normal() * spec.trim_sigma_m,
        bend_per_g_m=normal() * spec.bend_per_g_sigma_m,
        accel_scale=normal(3, 3) * per_station("accel_scale_sigma")[:, None],
        gyro_scale=normal(3, 3) * per_station("gyro_scale_sigma")[:, None],
        misalignment_rad=normal(3, 3) * per_station("misalignment_sigma_rad")[:, None],
        time_offset_s=normal(3) * per_station("time_offset_sigma_s"),
    )

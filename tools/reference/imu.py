"""Samples of the three inertial sensors: the specific force and rate at a bending station, with every sensor error.

A sample is the average over its millisecond (an integrating IMU), stamped at the middle of it. A tip that is lifted and
moves in a turning body feels forces beyond the rigid one. The reference knows the motion, and is given samples without
them; and here a tip moves straight up, as the reference's linear equations have it, and not inboard.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from companion.records import Axis, ClockName, ImuBatch, Station
from tools.reference.spec import SAMPLE_S, SensorSpec
from tools.reference.truth import STEP_S, TruthRun

Floats = npt.NDArray[np.float64]
EPOCH_HOST_NS = 1_000_000_000_000
_LETTERS = "xyzpqr"
_SIDE = (0.0, -1.0, 1.0)


def samples(run: TruthRun, moving: bool = True) -> tuple[Floats, Floats, Floats]:
    """Give the samples of root, left and right, each (S, N, 6) at 1 kHz; axes that are not sent are zero.

    ``moving`` tips feel Coriolis', Euler's and centripetal force by their lift.
    """
    return tuple(_station(run, station, moving) for station in range(3))  # type: ignore[return-value]


def stamps_ns(count: int) -> npt.NDArray[np.int64]:
    """Host stamps of the samples."""
    sample_ns = round(SAMPLE_S * 1e9)
    return EPOCH_HOST_NS + np.arange(count, dtype=np.int64) * sample_ns + sample_ns // 2


def axes_of(spec: SensorSpec) -> Axis:
    """The axes that a sensor sends."""
    axes = Axis.NONE
    for letter in spec.sends:
        axes |= Axis(1 << _LETTERS.index(letter))
    return axes


def chunks(
    run: TruthRun, values: tuple[Floats, Floats, Floats], seed_index: int, ends_s: list[float]
) -> Iterator[tuple[float, list[ImuBatch]]]:
    """Give, for every chunk end, the batches that arrive by then, stations and parts of them in shuffled order."""
    generator = np.random.default_rng([run.seeds[seed_index], 14])
    stamps = stamps_ns(values[0].shape[1])
    first = 0
    for end_s in ends_s:
        last = round(end_s / SAMPLE_S)
        received = EPOCH_HOST_NS + round(end_s * 1e9)
        cuts = [(first, last)]
        if last - first > 6 and generator.random() < 0.2:
            middle = int(generator.integers(first + 2, last - 2))
            cuts = [(middle, last), (first, middle)]
        batches = [
            ImuBatch(
                Station(station),
                ClockName.HOST,
                stamps[a:b],
                values[station][seed_index, a:b],
                axes_of(run.spec.sensors[station]),
                received,
            )
            for a, b in cuts
            for station in generator.permutation(3)
            if b > a
        ]
        first = last
        yield end_s, batches


def _station(run: TruthRun, station: int, moving: bool) -> Floats:
    spec = run.spec.sensors[station]
    seeds, count = len(run.seeds), round(run.steps * STEP_S / SAMPLE_S)
    ideal = np.stack([_ideal(run, station, s, moving) for s in range(seeds)])
    ideal = ideal.reshape(seeds, count, 2, 6).mean(axis=2)
    out = _imperfect(run, station, ideal)
    for s, seed in enumerate(run.seeds):
        out[s] += _noise(spec, np.random.default_rng([seed, 15, station]), count)
    sent = np.array([letter in spec.sends for letter in _LETTERS])
    return out * sent


def _ideal(run: TruthRun, station: int, s: int, moving: bool) -> Floats:
    """Average specific force and rate of one seed over each step, in the axes of the bent station, (steps, 6)."""
    spec, side = run.spec, _SIDE[station]
    offset = float(run.errors.time_offset_s[s, station])
    edges = np.arange(run.steps + 1) * STEP_S + offset
    force, rate, derivative = spec.motion.at(edges[:-1] + STEP_S / 2)
    arm = np.array([0.0, spec.sensors[station].y_m, 0.0])
    force = force + np.cross(derivative, arm) + np.cross(rate, np.cross(rate, arm))
    if not side:
        return np.hstack([force, rate])
    q, v = (run.q_m[s], run.v_mps[s]) if not offset else (run.q_at(edges)[s], run.v_at(edges)[s])
    signs = np.array([1.0, side, 1.0])[: len(spec.modes)]
    factors = signs * np.array([m.slope_radpm for m in spec.modes]) * (1 + run.errors.slope_ratio[s])
    force = force.copy()
    force[:, 2] -= signs @ np.diff(v, axis=1) / STEP_S
    middle = (q[:, 1:] + q[:, :-1]) / 2 - STEP_S / 12 * np.diff(v, axis=1)
    bend = factors @ middle + factors[0] * run.trim_m()[s]
    if moving:
        lift_m, lift_rate_mps = signs @ middle + run.trim_m()[s], signs @ np.diff(q, axis=1) / STEP_S
        up = np.array([0.0, 0.0, -1.0])
        place_m, speed_mps = lift_m[:, None] * up, lift_rate_mps[:, None] * up
        force += np.cross(derivative, place_m) + np.cross(rate, np.cross(rate, place_m) + 2.0 * speed_mps)
    turn = -side * bend  # rotation about body x: left tip +slope, right tip -slope
    bent = np.hstack([_rotate_x(force, turn), _rotate_x(rate, turn)])
    bent[:, 3] -= side * (factors @ np.diff(q, axis=1)) / STEP_S
    return bent


def _rotate_x(vector: Floats, angle_rad: Floats) -> Floats:
    """Components of ``vector`` in axes turned by ``angle_rad`` about x."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    x, y, z = vector.T
    return np.stack([x, c * y + s * z, c * z - s * y], axis=1)


def _imperfect(run: TruthRun, station: int, ideal: Floats) -> Floats:
    """Misalign, then scale."""
    turn = run.errors.misalignment_rad[:, station]
    scale = np.concatenate([run.errors.accel_scale[:, station], run.errors.gyro_scale[:, station]], axis=1)
    out = np.empty_like(ideal)
    for s in range(len(ideal)):
        matrix = _sensor_from_body(turn[s])
        out[s, :, :3] = ideal[s, :, :3] @ matrix.T
        out[s, :, 3:] = ideal[s, :, 3:] @ matrix.T
    return out * (1 + scale[:, None, :])


def _sensor_from_body(turn_rad: Floats) -> Floats:
    """exp(-[turn x]) by its series: the turn is a few milliradians."""
    x, y, z = turn_rad
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) - cross + cross @ cross / 2 - cross @ cross @ cross / 6


def _noise(spec: SensorSpec, generator: np.random.Generator, count: int) -> Floats:
    """White noise and an Ornstein-Uhlenbeck bias that starts in its stationary state, (count, 6)."""
    density = np.repeat([spec.accel_noise_mps2_rthz, spec.gyro_noise_radps_rthz], 3)
    sigma = np.repeat([spec.accel_bias_sigma_mps2, spec.gyro_bias_sigma_radps], 3)
    white = generator.standard_normal((count, 6)) * density * np.sqrt(0.5 / SAMPLE_S)
    keep = np.exp(-SAMPLE_S / spec.bias_time_s)
    kicks = generator.standard_normal((count, 6)) * np.sqrt(1 - keep**2)
    kicks[0] = generator.standard_normal(6)
    decay = keep ** -np.arange(count)
    return white + sigma * np.cumsum(kicks * decay[:, None], axis=0) / decay[:, None]

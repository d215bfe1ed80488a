"""The samples of one step as linear measurements of the reference's state.

With the tip turned by ``e psi`` about body x (e = +1 left, -1 right), ``psi`` its bend, and ``F`` the rigid specific
force at the station, the sensor reads ``z = cos(psi) (F_z - a) - e sin(psi) F_y`` and ``y = F_y / cos(psi) +
e tan(psi) z``. The second form is linear in ``psi`` with the measured ``z`` as its gain, whatever the wing does: the
slope times the wing's own acceleration is as large as the slope times gravity and may not be left out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tools.reference.observer import MEAN, MOMENT, SAMPLES_PER_STEP, Layout
from tools.reference.spec import GRAVITY_MPS2, SAMPLE_S, TruthSpec

Floats = npt.NDArray[np.float64]
_E = (0.0, 1.0, -1.0)
_Z, _Y, _P = 2, 1, 3


@dataclass(frozen=True, slots=True)
class Views:
    """Measurements of ``S`` seeds over ``K`` steps.

    Attributes
    ----------
    values : (K, S, m)
    gains : (K, S, m, basis)
        On the basis of the dynamics.
    bias_gains : (K, S, m, states)
        Directly on the states.
    noise : (m, m)
        Covariance of the sensors' own noise.
    excess : (K, S)
        Measured load factor less 1.
    root_gain : (m,), root_variance : float
        How the root's vertical noise enters the rows directly, and its variance: it is in ``excess`` as well.
    rows : list of (kind, station)
    means : Reduced
    """

    values: Floats
    gains: Floats
    bias_gains: Floats
    noise: Floats
    excess: Floats
    root_gain: Floats
    root_variance: float
    rows: list[tuple[str, int]]
    means: Reduced


@dataclass(frozen=True, slots=True)
class Reduced:
    """Averages over each step, (K, S, 6); ``moment`` the first moment of z; per station."""

    mean: list[Floats]
    moment: list[Floats]
    tilt_s: list[Floats]


def reduce(samples: tuple[Floats, Floats, Floats]) -> Reduced:
    """Average samples (S, N, 6) over the steps."""
    mean, moment, tilt = [], [], []
    for block in samples:
        seeds, count, _ = block.shape
        steps = count // SAMPLES_PER_STEP
        grouped = block[:, : steps * SAMPLES_PER_STEP].reshape(seeds, steps, SAMPLES_PER_STEP, 6).swapaxes(0, 1)
        mean.append(np.einsum("ksja,j->ksa", grouped, MEAN))
        z_moment = grouped[..., _Z] @ MOMENT
        moment.append(z_moment)
        tilt.append(z_moment * SAMPLE_S)  # average of z (t - middle)
    return Reduced(mean, moment, tilt)


def push_ratio(spec: TruthSpec) -> float:
    """How much the tip is pushed up by the bend that the load factor demands, over the root's own acceleration."""
    return float((2 * np.pi * spec.symmetric.frequency_hz) ** 2 * spec.bend_per_g_m / GRAVITY_MPS2)


def views(spec: TruthSpec, layout: Layout, samples: tuple[Floats, Floats, Floats]) -> Views:
    """Turn samples into measurements: z mean and moment of both tips, p of the root, then y and p of both tips."""
    means = reduce(samples)
    builder = _Builder(spec, layout, means)
    for station in (1, 2):
        builder.vertical(station)
    builder.root_rate()
    for station in (1, 2):
        if "y" in spec.sensors[station].sends:
            builder.lateral(station)
        if "p" in spec.sensors[station].sends:
            builder.rate(station)
    return builder.finish()


class _Builder:
    def __init__(self, spec: TruthSpec, layout: Layout, means: Reduced) -> None:
        self.spec, self.layout, self.means = spec, layout, means
        self.shape = means.mean[0].shape[:2]
        self.values: list[Floats] = []
        self.gains: list[Floats] = []
        self.bias_gains: list[Floats] = []
        self.noise: list[dict[tuple[str, int], float]] = []
        self.rows: list[tuple[str, int]] = []
        self.push_ratio = push_ratio(spec)
        self.trim_rad = spec.trim_bend_m * spec.symmetric.slope_radpm

    def vertical(self, station: int) -> None:
        """Mean and first moment of the vertical axis, less the rigid part."""
        at, arm, e = self.layout, self.spec.sensors[station].y_m, _E[station]
        root, tip = self.means.mean[0], self.means.mean[station]
        c, s = np.cos(self.trim_rad), np.sin(self.trim_rad)
        rigid_z = root[..., _Z] + root[..., 4] * root[..., 5] * arm
        lateral = self._lateral_force(station)
        M, b = self._rows()
        lean = -(s * root[..., _Z] + e * c * lateral)
        for mode, sign, factor in self._signs(station):
            M[..., at.basis("a", mode)] = -c * sign
            M[..., at.basis("q", mode)] += lean * sign * factor
        M[..., at.basis("alpha")] = c * arm
        b[..., at.bias("z_left" if station == 1 else "z_right")] = 1.0
        b[..., at.bias("z_root")] = -c
        self._add(tip[..., _Z] - c * rigid_z + e * s * lateral, M, b, {("z", station): 1.0, ("z", 0): -c})
        M, b = self._rows()
        for mode, sign, _ in self._signs(station):
            M[..., at.basis("a1", mode)] = -c * sign
        M[..., at.basis("alpha1")] = c * arm
        # the load factor's own slope inside the step pushes the symmetric mode as well
        coupling = c * (1 + self.push_ratio)
        value = self.means.moment[station] - coupling * self.means.moment[0]
        self._add(value, M, b, {("z1", station): 1.0, ("z1", 0): -coupling})

    def lateral(self, station: int) -> None:
        """The lateral axis: the slope through the measured vertical specific force."""
        at, arm, e = self.layout, self.spec.sensors[station].y_m, _E[station]
        root, tip = self.means.mean[0], self.means.mean[station]
        c, tangent = np.cos(self.trim_rad), np.tan(self.trim_rad)
        M, b = self._rows()
        for mode, sign, factor in self._signs(station):
            M[..., at.basis("q", mode)] = e * factor * sign * tip[..., _Z] / c**2
            M[..., at.basis("v", mode)] = e * factor * sign * self.means.tilt_s[station] / c**2
        roll, yaw = root[..., 3], root[..., 5]
        M[..., at.basis("p")] = -2 * roll * arm / c
        b[..., at.bias("r_root")] = 2 * yaw * arm / c
        side = "left" if station == 1 else "right"
        b[..., at.bias(f"y_{side}")] = 1.0
        b[..., at.bias(f"z_{side}")] = -e * tangent
        expected = (root[..., _Y] - arm * (yaw**2 - roll**2)) / c + e * tangent * tip[..., _Z]
        noise = {("y", station): 1.0, ("y", 0): -1 / c, ("z", station): -e * tangent}
        self._add(tip[..., _Y] - expected, M, b, noise)

    def root_rate(self) -> None:
        """The root's roll rate."""
        M, b = self._rows()
        M[..., self.layout.basis("p")] = 1.0
        b[..., self.layout.bias("p_root")] = 1.0
        self._add(self.means.mean[0][..., _P], M, b, {("p", 0): 1.0})

    def rate(self, station: int) -> None:
        """A tip's roll rate: the rigid one and the rate of the slope."""
        M, b = self._rows()
        M[..., self.layout.basis("p")] = 1.0
        for mode, sign, factor in self._signs(station):
            M[..., self.layout.basis("v", mode)] = _E[station] * sign * factor
        b[..., self.layout.bias("p_left" if station == 1 else "p_right")] = 1.0
        self._add(self.means.mean[station][..., _P], M, b, {("p", station): 1.0})

    def finish(self) -> Views:
        """Stack the rows; white noise of an average of n samples over T has variance density^2 / (2 T)."""
        keys = sorted({key for row in self.noise for key in row})
        mix = np.array([[row.get(key, 0.0) for key in keys] for row in self.noise])
        variances = np.diag([self._variance(*key) for key in keys])
        excess = -self.means.mean[0][..., _Z] / GRAVITY_MPS2 - 1
        gains, bias_gains = np.stack(self.gains, axis=2), np.stack(self.bias_gains, axis=2)
        values = np.stack(self.values, axis=2)
        root_gain = mix[:, keys.index(("z", 0))]
        return Views(
            values,
            gains,
            bias_gains,
            mix @ variances @ mix.T,
            excess,
            root_gain,
            self._variance("z", 0),
            self.rows,
            self.means,
        )

    def _variance(self, kind: str, station: int) -> float:
        sensor = self.spec.sensors[station]
        density = sensor.gyro_noise_radps_rthz if kind == "p" else sensor.accel_noise_mps2_rthz
        weights = MOMENT if kind == "z1" else MEAN
        return float(density**2 / 2 / SAMPLE_S * (weights @ weights))

    def _lateral_force(self, station: int) -> Floats:
        root = self.means.mean[0]
        return np.asarray(root[..., _Y] - self.spec.sensors[station].y_m * (root[..., 3] ** 2 + root[..., 5] ** 2))

    def _signs(self, station: int) -> list[tuple[int, float, float]]:
        """(mode, sign of its displacement at this tip, slope factor)."""
        side = -1.0 if station == 1 else 1.0
        signs = (1.0, side, 1.0)
        return [(i, signs[i], mode.slope_radpm) for i, mode in enumerate(self.spec.modes)]

    def _rows(self) -> tuple[Floats, Floats]:
        return np.zeros((*self.shape, self.layout.basis_size)), np.zeros((*self.shape, self.layout.size))

    def _add(self, value: Floats, M: Floats, b: Floats, noise: dict[tuple[str, int], float]) -> None:
        self.values.append(value)
        self.gains.append(M)
        self.bias_gains.append(b)
        self.noise.append(noise)
        self.rows.append(next(iter(noise)))

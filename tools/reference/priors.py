"""Constant errors drawn from priors, as the reference sees them: what each does to every measurement of a step.

The state is linear in a constant ``theta`` once the wing's motion is known, so that the augmented Kalman filter splits
exactly into the nominal filter and one column of sensitivity per constant (Friedland, IEEE TAC 14, 1969). The columns
take the motion from the filter's own best estimate; what that neglects is the product of a prior sigma (1 %) and an
estimation error (1 %). So the reference is the Bayes-optimal estimator that knows the priors, and a test holds its
NEES near 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from tools.reference.observer import MOMENT, REFERENCE_STEP_S, Layout
from tools.reference.spec import GRAVITY_MPS2, SAMPLE_S, TruthSpec
from tools.reference.views import Reduced, push_ratio

Floats = npt.NDArray[np.float64]
_E = (0.0, 1.0, -1.0)
_PLACES = ("root", "left", "right")
_HALF_STEPS = 10


@dataclass(frozen=True, slots=True)
class Constants:
    """Names and prior sigmas of the constants; empty where everything is known."""

    names: tuple[str, ...]
    sigma: Floats

    @property
    def judged(self) -> Floats:
        """1 for constants that are estimated, 0 for the stamps' offsets, which are only allowed for (Schmidt 1966).

        The wing's motion tells next to nothing of an offset, for a shifted gust is as likely as the gust; a Taylor
        series in it would claim microseconds. It costs omega tau = 0.6 % of the deflection at 5 Hz.
        """
        return np.array([float(not name.endswith(".tau")) for name in self.names])

    def index(self, name: str) -> int | None:
        """Column of a constant, None where it is known."""
        return self.names.index(name) if name in self.names else None


def constants_of(spec: TruthSpec) -> Constants:
    """The constants whose prior has a width."""
    listed = [("trim", spec.trim_sigma_m), ("bend_per_g", spec.bend_per_g_sigma_m)]
    listed += [(f"slope{i}", spec.slope_sigma_ratio) for i in range(len(spec.modes))]
    for place, sensor in zip(_PLACES, spec.sensors, strict=True):
        listed += [(f"{place}.k{axis}", sensor.accel_scale_sigma) for axis in "zy"]
        listed += [(f"{place}.kp", sensor.gyro_scale_sigma)]
        listed += [(f"{place}.m{axis}", sensor.misalignment_sigma_rad) for axis in "xyz"]
        listed += [(f"{place}.tau", sensor.time_offset_sigma_s)]
    uncertain = [(name, sigma) for name, sigma in listed if sigma > 0]
    return Constants(tuple(name for name, _ in uncertain), np.array([sigma for _, sigma in uncertain]))


class Sensitivity:
    """Direct effect of the constants on the measurements, and on the load factor that drives the bend.

    The wing's part of a reading is taken as estimated, never as read: a reading holds its own noise. Rigid motion is
    the root's, smoothed: the filter's own roll rate follows a prior that is far wider than the roll.
    """

    def __init__(
        self, spec: TruthSpec, layout: Layout, constants: Constants, means: Reduced, rows: list[tuple[str, int]]
    ) -> None:
        self.spec, self.layout, self.constants, self.means, self.rows = spec, layout, constants, means, rows
        self._smooth_root = _without_noise(means.mean[0])
        slope = np.gradient(self._smooth_root[..., 2], REFERENCE_STEP_S, axis=0)
        self._heave_moment = slope * SAMPLE_S * float(MOMENT @ np.arange(len(MOMENT)))
        self._turn = np.gradient(self._smooth_root[..., 3], REFERENCE_STEP_S, axis=0)
        steps, seeds = means.mean[0].shape[:2]
        self.load = np.zeros((steps, seeds, len(constants.names)))
        for name, load in (
            ("root.kz", self._smooth_root[..., 2] / GRAVITY_MPS2),
            ("bend_per_g", (-self._smooth_root[..., 2] / GRAVITY_MPS2 - 1) / spec.bend_per_g_m),
        ):
            column = constants.index(name)
            if column is not None:
                self.load[:, :, column] = load

    def bias_bowed(self, basis: Floats, theta: Floats) -> Floats:
        """Give what the tips' vertical biases do to the rows beside their linear form, (S, m, states).

        The lateral axis sees the slope through the force as it is, ``y = F_y / cos A + e tan A (z - b)``. With ``z``
        as it was read, the bias would make an acceleration of a slope that is off, and show where the tip rests:
        0.02 m/s^2 look like 0.08 mrad at 3 Hz, which is all that is unknown of it.
        """
        gains = np.zeros((len(basis), len(self.rows), self.layout.size))
        for at, (kind, station) in enumerate(self.rows):
            if kind == "y":
                A = self._trim_rad() + self._bend(station, "q", basis) + self._turn_by(station, basis, theta)
                column = self.layout.bias("z_left" if station == 1 else "z_right")
                gains[:, at, column] = -_E[station] * (np.tan(A) - np.tan(self._trim_rad()))
        return gains

    def bowed(self, k: int, basis: Floats, theta: Floats) -> tuple[Floats, Floats]:
        """Give what the rows of step ``k`` read beside their linear form, (S, m), and its gradient, (S, m, basis).

        The tip is turned by trim, bend and misalignment together, ``A``: ``z = cos A (F_z - a) - e sin A F_y`` and
        ``y = F_y / cos A + e tan A z``. The turn that the constants make is linear in :meth:`direct`.
        """
        out = np.zeros((len(basis), len(self.rows)))
        gradient = np.zeros((*out.shape, self.layout.basis_size))
        s0, c0 = np.sin(self._trim_rad()), np.cos(self._trim_rad())
        for at, (kind, station) in enumerate(self.rows):
            if kind not in "zy":
                continue
            e, bend, more = _E[station], self._bend(station, "q", basis), self._turn_by(station, basis, theta)
            A = self._trim_rad() + bend + more
            if kind == "z":
                force, lateral = self._rigid(station, k)
                swing = self._displacement(station, "a", basis)
                lean = -s0 * self.means.mean[0][k, :, 2] - e * c0 * lateral
                slant = -np.sin(A) * (force - swing) - e * np.cos(A) * lateral
                out[:, at] = (np.cos(A) - c0) * (force - swing) - e * (np.sin(A) - s0) * lateral
                out[:, at] -= lean * bend + slant * more
                for i, sign, _ in self._signs(station):
                    gradient[:, at, self.layout.basis("a", i)] = -(np.cos(A) - c0) * sign
            else:
                tip = e * self.means.mean[station][k, :, 2]
                lean, slant = tip / c0**2, tip / np.cos(A) ** 2
                out[:, at] = tip * (np.tan(A) - s0 / c0) - lean * bend - slant * more
            for i, sign, factor in self._signs(station):
                gradient[:, at, self.layout.basis("q", i)] = (slant - lean) * sign * factor
        return out, gradient

    def _turn_by(self, station: int, basis: Floats, theta: Floats) -> Floats:
        """The turn of a tip that the constants add to its bend."""
        turn = _E[station] * self._value(f"{_PLACES[station]}.mx", theta)
        turn = turn + self.spec.symmetric.slope_radpm * self._value("trim", theta)
        for i, sign, factor in self._signs(station):
            q = basis[:, self.layout.basis("q", i)] + (self.spec.trim_bend_m if i == 0 else 0.0)
            turn = turn + sign * factor * q * self._value(f"slope{i}", theta)
        return turn

    def _rigid(self, station: int, k: int) -> tuple[Floats, Floats]:
        """Vertical and lateral specific force of the rest wing at a tip."""
        arm, root = self.spec.sensors[station].y_m, self.means.mean[0][k]
        force = root[:, 2] + arm * (self._turn[k] + root[:, 4] * root[:, 5])
        return force, self._smooth_root[k, :, 1] - arm * (root[:, 3] ** 2 + root[:, 5] ** 2)

    def _value(self, name: str, theta: Floats) -> Floats:
        column = self.constants.index(name)
        return np.zeros(len(theta)) if column is None else theta[:, column]

    def direct(self, k: int, basis: Floats, slew: Floats, theta: Floats) -> Floats:
        """Effect on the rows of step ``k``, (S, m, c), of the wing's motion ``basis`` and its rate of change."""
        out = np.zeros((len(basis), len(self.rows), len(self.constants.names)))
        for at, (kind, station) in enumerate(self.rows):
            if kind == "p":
                self._rate(out, at, station, k, basis, slew)
            elif kind == "y":
                self._lateral(out, at, station, k, basis, theta)
            elif kind == "z":
                self._vertical(out, at, station, k, basis, slew, theta)
            else:
                self._moment(out, at, station, k, basis, slew)
        return out

    def _vertical(self, out: Floats, at: int, station: int, k: int, basis: Floats, slew: Floats, theta: Floats) -> None:
        place, e, c, root = _PLACES[station], _E[station], np.cos(self._trim_rad()), self._smooth_root[k]
        A = self._trim_rad() + self._bend(station, "q", basis) + self._turn_by(station, basis, theta)
        force, lateral = self._rigid(station, k)
        force = force - self._displacement(station, "a", basis)
        slant = -np.sin(A) * force - e * np.cos(A) * lateral
        self._put(out, at, f"{place}.kz", np.cos(A) * force - e * np.sin(A) * lateral)
        self._put(out, at, f"{place}.mx", e * slant)
        self._put(out, at, f"{place}.my", root[:, 0])
        self._put(out, at, f"{place}.tau", -c * self._displacement(station, "a", slew))
        self._put(out, at, "root.kz", -c * root[:, 2])
        self._put(out, at, "root.mx", c * root[:, 1])
        self._put(out, at, "root.my", -c * root[:, 0])
        self._put(out, at, "trim", slant * self.spec.symmetric.slope_radpm)
        for i, sign, factor in self._signs(station):
            q = basis[:, self.layout.basis("q", i)] + (self.spec.trim_bend_m if i == 0 else 0.0)
            self._put(out, at, f"slope{i}", slant * sign * factor * q)

    def _moment(self, out: Floats, at: int, station: int, k: int, basis: Floats, slew: Floats) -> None:
        place, c = _PLACES[station], np.cos(self._trim_rad())
        root = self._heave_moment[k]
        swing = self._displacement(station, "a1", basis)
        self._put(out, at, f"{place}.kz", c * (1 + push_ratio(self.spec)) * root - c * swing)
        self._put(out, at, f"{place}.tau", -c * self._displacement(station, "a1", slew))
        ratio = push_ratio(self.spec)
        self._put(out, at, "root.kz", -c * (1 + ratio) * root)
        self._put(out, at, "bend_per_g", -c * ratio / self.spec.bend_per_g_m * root)

    def _lateral(self, out: Floats, at: int, station: int, k: int, basis: Floats, theta: Floats) -> None:
        """The lateral row comes after the vertical one, whose reading it may use: its own noise is another."""
        place, c, e = _PLACES[station], np.cos(self._trim_rad()), _E[station]
        tip, root = self.means.mean[station][k], self._smooth_root[k]
        A = self._trim_rad() + self._bend(station, "q", basis) + self._turn_by(station, basis, theta)
        lateral = e * np.tan(A) * tip[:, 2]
        gain = e * tip[:, 2] / np.cos(A) ** 2
        self._put(out, at, "trim", gain * self.spec.symmetric.slope_radpm)
        self._put(out, at, f"{place}.ky", lateral + root[:, 1])
        self._put(out, at, f"{place}.kz", -lateral)  # the slope is y over z
        self._put(out, at, f"{place}.mx", e * gain)
        self._put(out, at, f"{place}.mz", -root[:, 0])
        self._put(out, at, f"{place}.tau", gain * self._bend(station, "v", basis))
        self._put(out, at, "root.ky", -root[:, 1] / c)
        self._put(out, at, "root.mx", -root[:, 2] / c)
        self._put(out, at, "root.mz", root[:, 0] / c)
        for i, sign, factor in self._signs(station):
            q = basis[:, self.layout.basis("q", i)] + (self.spec.trim_bend_m if i == 0 else 0.0)
            tilt = e / c**2 * self.means.tilt_s[station][k] * basis[:, self.layout.basis("v", i)]
            self._put(out, at, f"slope{i}", sign * factor * (gain * q + tilt))

    def _rate(self, out: Floats, at: int, station: int, k: int, basis: Floats, slew: Floats) -> None:
        place, e, root = _PLACES[station], _E[station], self._smooth_root[k]
        self._put(out, at, f"{place}.kp", root[:, 3] + e * self._bend(station, "v", basis))
        self._put(out, at, f"{place}.my", -root[:, 5])
        self._put(out, at, f"{place}.mz", root[:, 4])
        self._put(out, at, f"{place}.tau", self._turn[k] + e * self._bend(station, "v", slew))
        for i, sign, factor in self._signs(station) if station else ():
            self._put(out, at, f"slope{i}", e * sign * factor * basis[:, self.layout.basis("v", i)])

    def _trim_rad(self) -> float:
        return self.spec.trim_bend_m * self.spec.symmetric.slope_radpm

    def _signs(self, station: int) -> list[tuple[int, float, float]]:
        """(mode, sign of its displacement at this tip, slope factor)."""
        signs = (1.0, -1.0 if station == 1 else 1.0, 1.0)
        return [(i, signs[i], mode.slope_radpm) for i, mode in enumerate(self.spec.modes)]

    def _bend(self, station: int, kind: str, basis: Floats) -> Floats:
        """Slope (of ``q``) or its rate (of ``v``) at a tip; zero at the root."""
        total = np.zeros(len(basis))
        for i, sign, factor in self._signs(station) if station else ():
            total += sign * factor * basis[:, self.layout.basis(kind, i)]
        return total

    def _displacement(self, station: int, kind: str, basis: Floats) -> Floats:
        total = np.zeros(len(basis))
        for i, sign, _ in self._signs(station):
            total += sign * basis[:, self.layout.basis(kind, i)]
        return total

    def _put(self, out: Floats, at: int, name: str, value: Floats) -> None:
        column = self.constants.index(name)
        if column is not None:
            out[:, at, column] = value


def _without_noise(values: Floats) -> Floats:
    """Rigid motion from its neighbours in time: the parabola through 10 steps before and 10 after, without the step.

    The step's own reading is in the innovation that the result is weighed against.
    """
    at = np.arange(-_HALF_STEPS, _HALF_STEPS + 1.0)
    others = np.flatnonzero(at)
    weights = np.zeros(len(at))
    weights[others] = np.linalg.pinv(np.vander(at[others], 3))[2]
    return np.asarray(scipy.ndimage.correlate1d(values, weights, axis=0, mode="nearest"))

"""From raw streams to what each averaging cell says about the wing: rigid motion removed exactly.

A tip at ``r`` from the root feels ``f_root + omega' x r + omega x (omega x r) + (0, 0, -w'')``, turned by its own
bending slope. The roll acceleration stays in: with the lever of the wing it is as large as the bending, and it is a
state of the filter.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from companion.core.kernels.compiled import compiled
from companion.core.tracking.error_jacobians import Motion, columns_of, rate_of_change, sensitivities
from companion.core.tracking.resampling import VERTICAL
from companion.core.tracking.states import M_LEFT, P_LEFT, P_ROOT, ROWS, Y_LEFT, Z_LEFT, Layout, Noise
from companion.core.tracking.streams import CHANNELS, Averages, Samples, Stream, averages
from companion.records import Axis, Bools, Floats, Ints
from companion.units import GRAVITY_MPS2

_LEAST_FORCE_MPS2 = 1.0  # in free fall the lateral axis does not see the slope
_SHAKEN = 5.0  # sigmas of the root's own first moment
_STIRRED = 6.0  # sigmas of the root's cells: what smoothing takes away beyond these is no noise of its sensor
_STEEP = 0.05  # slope by which an error across lifts a vertical row
_LATERAL, _ROLL = 1, 3  # channels
_BESIDE = 2  # cells at either end that time derivatives and smoothing lean on


@dataclass(frozen=True, slots=True)
class Cells:
    """A run of consecutive averaging cells.

    Attributes
    ----------
    start_ns : (n,) int64
    rows : (n, 9) float64
        See :mod:`companion.core.tracking.states`.
    present : (n, 9) bool
        Rows that were measured; the others are zero.
    vertical, lateral : (n, 2) float64
        Vertical specific force as sensed and rigid lateral force, signed for the side: by the tip's own slope the
        vertical rows read ``-(vertical slope^2 / 2 + lateral slope)`` more.
    tilted : (n, 2) float64
        What the tip's slope rate adds to the slope rows, because slope and force change together inside a cell.
    lateral_gain : (n, 2) float64
        One over the vertical specific force, signed for the side: what a lateral error does to the slope row.
    load : (n,) float64
        Load factor less one.
    rate : (n, 3) float64
        Body rate at the end of the cell.
    sensitivity : (n, 9, c) float64
        Of each row to each constant, as far as data alone give it.
    cut : (n, 2) float64
        How much the tips' cells suffer from edges that cut samples.
    shaken : (n, 3) float64
        Variance of the rigid vertical and lateral force and of the roll rate because the root moved, or lied, faster
        than its filtered samples can tell; 0 in steady flight.
    """

    start_ns: Ints
    rows: Floats
    present: Bools
    vertical: Floats
    lateral: Floats
    tilted: Floats
    lateral_gain: Floats
    load: Floats
    rate: Floats
    sensitivity: Floats
    cut: Floats
    shaken: Floats

    def __len__(self) -> int:
        return len(self.start_ns)

    def span(self, first: int, last: int) -> Cells:
        """The cells ``first:last``."""
        if first == 0 and last == len(self):
            return self
        return Cells(*(getattr(self, name)[first:last] for name in _COLUMNS))

    def without(self, excess: Floats) -> Cells:
        """The same cells less what of their rows (n, 9) is no motion of the wing; their load factors are bridged."""
        shaken, load = excess[:, Z_LEFT:M_LEFT].any(axis=1), self.load
        if shaken.any() and not shaken.all():
            at = np.arange(len(self), dtype=np.float64)
            load = np.interp(at, at[~shaken], self.load[~shaken])
        return dataclasses.replace(self, rows=self.rows - excess, load=load)


_COLUMNS = (
    "start_ns",
    "rows",
    "present",
    "vertical",
    "lateral",
    "tilted",
    "lateral_gain",
    "load",
    "rate",
    "sensitivity",
    "cut",
    "shaken",
)


def join(runs: list[Cells]) -> Cells:
    """Put consecutive runs together."""
    return Cells(*(np.concatenate([getattr(run, name) for run in runs]) for name in _COLUMNS))


class FrontEnd:
    """Makes cells of the three streams: averages them, and removes the rigid motion."""

    def __init__(self, layout: Layout, noise: Noise, streams: tuple[Stream, Stream, Stream]) -> None:
        self._streams = streams
        root, left, right = (np.array(stream.sensor.position_m) for stream in streams)
        self._levers_m = np.stack([left - root, right - root])
        usual = _STIRRED * np.sqrt([noise.root_z, noise.root_y, noise.own[P_ROOT]])
        self._noise = _RootNoise(streams[0].sensor.accel_noise_mps2_rthz, usual)
        self._where, self._constants = columns_of(layout), len(layout.constants)
        self._axes: tuple[Axis, ...] = ()
        self._sends = np.zeros((3, CHANNELS), dtype=np.bool_)

    def cells(self, first_ns: int, step_ns: int, count: int) -> Cells:
        """Give ``count`` consecutive cells from ``first_ns`` on."""
        root, left, right = self._streams
        axes = (root.axes, left.axes, right.axes)
        if axes != self._axes:
            self._axes = axes
            self._sends = np.array([[_sends(stream, letter) for letter in "xyzpqr"] for stream in self._streams])
        fixed = (self._sends, self._levers_m, self._noise, self._where, self._constants)
        until_ns = first_ns + step_ns * (count + _BESIDE)
        at_root, at_left, at_right = (stream.plain(until_ns) for stream in (root, left, right))
        return Cells(*_cells_between(at_root, at_left, at_right, first_ns, step_ns, count, *fixed))


class _RootNoise(NamedTuple):
    """Density of the root's accelerometer, and what smoothing may take from its cells: force up, across; roll rate."""

    mps2_rthz: float
    usual: Floats


class _Averaged(NamedTuple):
    """Averages of all streams over a run of cells.

    ``sends`` (3, 6): axes of each station; ``resolved`` (2, n): cells whose moments tell something.
    """

    step_s: float
    root: Floats
    tip: Floats
    moment: Floats
    covered: Bools
    sends: Bools
    resolved: Bools
    filtered: bool
    levers_m: Floats


def _sends(stream: Stream, letter: str) -> bool:
    return bool(stream.axes & Axis[letter.upper()]) and letter in stream.sensor.sends


_Vector = Floats | tuple[float, float, float]
_CellColumns = tuple[Ints, Floats, Bools, Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats, Floats]


@compiled
def _cells_between(
    root: Samples,
    left: Samples,
    right: Samples,
    first_ns: int,
    step_ns: int,
    count: int,
    sends: Bools,
    levers_m: Floats,
    noise: _RootNoise,
    where: Ints,
    constants: int,
) -> _CellColumns:
    """Everything that :class:`Cells` holds, in its order."""
    edges_ns = first_ns + step_ns * np.arange(-_BESIDE, count + _BESIDE + 1)
    at_root, at_left, at_right = averages(root, edges_ns), averages(left, edges_ns), averages(right, edges_ns)
    steady = _steady(at_root, noise.mps2_rthz, step_ns * 1e-9)
    averaged = _Averaged(
        step_ns * 1e-9,
        at_root.mean,
        np.stack((at_left.mean, at_right.mean), axis=1),
        np.stack((at_left.moment, at_right.moment), axis=1),
        np.stack((at_root.covered, at_left.covered, at_right.covered)),
        sends,
        np.stack((steady & at_left.resolved, steady & at_right.resolved)),
        root.filtered,
        levers_m,
    )
    rows, there, vertical, lateral, tilted, gains, load, rate, known = _cells(averaged, where, constants)
    cut = np.stack((at_left.cut, at_right.cut), axis=1)
    shaken = _shaken(averaged, noise.usual)
    i, j = _BESIDE, _BESIDE + count
    starts_ns = edges_ns[i:j].copy()
    return (
        starts_ns,
        rows[i:j],
        there[i:j],
        vertical[i:j],
        lateral[i:j],
        tilted[i:j],
        gains[i:j],
        load[i:j],
        rate[i:j],
        known[i:j],
        cut[i:j],
        shaken[i:j],
    )


@compiled
def _cells(
    averaged: _Averaged, where: Ints, constants: int
) -> tuple[Floats, Bools, Floats, Floats, Floats, Floats, Floats, Floats, Floats]:
    """Everything that :class:`Cells` holds beside the stamps, in its order."""
    motion, there = _motion(averaged), _there(averaged)
    gains = _lateral_gain(motion, there)
    n = len(there)
    rows, vertical, lateral, tilted = np.zeros((n, ROWS)), np.zeros((n, 2)), np.zeros((n, 2)), np.zeros((n, 2))
    for k in range(n):
        for side in range(2):
            force = motion.tip[k, side, 2]
            rows[k, Z_LEFT + side] = force - motion.rigid[k, side, 2]
            rows[k, M_LEFT + side] = motion.moment[k, side] - motion.step_s / 12.0 * motion.d_rigid_z[k, side]
            rows[k, Y_LEFT + side] = np.arctan((motion.tip[k, side, 1] - motion.rigid[k, side, 1]) * gains[k, side])
            rows[k, P_LEFT + side] = motion.tip[k, side, 3]
            if there[k, Z_LEFT + side]:
                vertical[k, side] = force
                lateral[k, side] = motion.rigid[k, side, 1] * (1.0 - 2.0 * side)
            if there[k, Y_LEFT + side]:
                tilted[k, side] = -motion.moment[k, side] * motion.step_s * np.abs(gains[k, side]) * np.sign(force)
        rows[k, P_ROOT] = motion.omega[k, 0]
        for row in range(ROWS):
            if not there[k, row]:
                rows[k, row] = 0.0
    load = np.zeros(n)
    if averaged.sends[0, VERTICAL]:
        for k in range(n):
            if averaged.covered[0, k]:
                load[k] = -motion.f_root[k, 2] / GRAVITY_MPS2 - 1.0
    rate = motion.omega.copy()
    rate[:-1] = 0.5 * (motion.omega[:-1] + motion.omega[1:])
    known = sensitivities(motion, gains, there, where, constants)
    for k in range(n):
        for side in range(2):
            if not there[k, Y_LEFT + side]:
                gains[k, side] = 0.0
    return rows, there, vertical, lateral, tilted, gains, load, rate, known


@compiled
def _motion(averaged: _Averaged) -> Motion:
    root_there, step_s = averaged.covered[0], averaged.step_s
    calm = _smoothed(averaged.root, root_there) if averaged.filtered else averaged.root
    f_root, omega = calm[:, :3].copy(), calm[:, 3:].copy()
    turn = rate_of_change(omega, step_s, root_there)
    n = len(calm)
    rigid, d_rigid_z, d_tip = np.empty((n, 2, 3)), np.empty((n, 2)), np.empty((n, 2, 6))
    for side in range(2):
        arm = averaged.levers_m[side]
        for k in range(n):
            spun, swung = _cross(turn[k], arm), _cross(omega[k], _cross(omega[k], arm))
            for axis in range(3):
                rigid[k, side, axis] = f_root[k, axis] + spun[axis] + swung[axis]
            rigid[k, side, 2] -= turn[k, 0] * arm[1]  # the filter's business
        d_rigid_z[:, side] = rate_of_change(rigid[:, side, 2].copy(), step_s, root_there)
        d_tip[:, side] = rate_of_change(averaged.tip[:, side].copy(), step_s, averaged.covered[1 + side])
    d_root = rate_of_change(f_root, step_s, root_there)
    tip = averaged.tip.copy()  # an axis that is not sent leaks into the others all the same: as the rigid wing's
    for side in range(2):
        for axis in range(CHANNELS):
            if not averaged.sends[1 + side, axis]:
                tip[:, side, axis] = rigid[:, side, axis] if axis < _ROLL else omega[:, axis - _ROLL]
    return Motion(step_s, tip, averaged.moment, d_tip, rigid, d_rigid_z, f_root, d_root, omega, turn, averaged.levers_m)


@compiled
def _steady(root: Averages, noise_mps2_rthz: float, step_s: float) -> Bools:
    """Cells in which the root moves as its means say.

    A shaken support moves otherwise inside a cell, and so does the wing on it: a tip's first moment then says nothing.
    """
    slope = rate_of_change(root.mean[:, VERTICAL].copy(), step_s, root.covered)
    beyond = np.abs(root.moment - step_s / 12.0 * slope)
    steady: Bools = ~root.resolved | (beyond < _SHAKEN * noise_mps2_rthz / np.sqrt(24.0 * step_s))
    return steady


@compiled
def _there(averaged: _Averaged) -> Bools:
    """Which rows were measured."""
    root = averaged.covered[0]
    there = np.zeros((len(root), ROWS), np.bool_)
    there[:, P_ROOT] = root & averaged.sends[0, _ROLL]
    for side in range(2):
        own, sends = averaged.covered[1 + side], averaged.sends[1 + side]
        there[:, Y_LEFT + side] = own & root & sends[_LATERAL]
        there[:, Z_LEFT + side] = own & root & sends[VERTICAL]
        there[:, M_LEFT + side] = own & root & sends[VERTICAL] & averaged.resolved[side]
        there[:, P_LEFT + side] = own & sends[_ROLL]
    return there


@compiled
def _smoothed(values: Floats, there: Bools) -> Floats:
    """Weights 1/4, 1/2, 1/4 over neighbouring cells.

    A filtered root that sends at a few hundred hertz leaves noise in its cells that alternates from one to the next,
    several times its sensor's; rigid motion is too slow to notice (2 % at a twentieth of the cell rate).
    """
    out = values.copy()
    for k in range(1, len(values) - 1):
        if there[k - 1] and there[k] and there[k + 1]:
            out[k] = 0.25 * (values[k - 1] + values[k + 1]) + 0.5 * values[k]
    return out


@compiled
def _shaken(averaged: _Averaged, usual: Floats) -> Floats:
    """Variances (n, 3) as :class:`Cells` holds them, where smoothing takes away more than is ``usual`` (3,).

    What moves faster than the smoothing and the interpolation between filtered samples can tell is wrong by about as
    much as smoothing changes it: measured on blows of 20 ms as well as on noise in the samples.
    """
    n = len(averaged.root)
    out = np.zeros((n, 3))
    if not averaged.filtered:
        return out
    calm = _smoothed(averaged.root, averaged.covered[0])
    taken, lever = np.zeros((n, 3)), np.abs(averaged.levers_m).max()
    for k in range(n):
        change = np.abs(averaged.root[k] - calm[k])
        turned, turning = np.sqrt((change[_ROLL:] ** 2).sum()), np.sqrt((calm[k, _ROLL:] ** 2).sum())
        spun = lever * turned * (2.0 * turning + turned)  # of the centripetal force
        beyond = turned > usual[2]
        taken[k, 2] = change[_ROLL] if change[_ROLL] > usual[2] else 0.0
        taken[k, 1] = change[_LATERAL] + spun if beyond or change[_LATERAL] > usual[1] else 0.0
        taken[k, 0] = (change[VERTICAL] if change[VERTICAL] > usual[0] else 0.0) + _STEEP * taken[k, 1]
    for k in range(n):
        for column in range(3):
            out[k, column] = taken[max(k - 1, 0) : k + 2, column].max() ** 2
    return out


@compiled
def _cross(a: _Vector, b: _Vector) -> _Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def _lateral_gain(motion: Motion, there: Bools) -> Floats:
    """One over the vertical specific force, signed for the side; in free fall the slope rows are taken out."""
    gains = np.empty((len(there), 2))
    for k in range(len(there)):
        for side in range(2):
            # a tip without a vertical axis cannot say by what its lateral axis is to be divided: the rigid force does
            force = motion.tip[k, side, 2] if there[k, Z_LEFT + side] else motion.rigid[k, side, 2]
            if np.abs(force) < _LEAST_FORCE_MPS2:
                there[k, Y_LEFT + side] = False
                force = -GRAVITY_MPS2
            gains[k, side] = (1.0 - 2.0 * side) / force
    return gains

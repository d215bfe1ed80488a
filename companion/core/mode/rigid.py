"""From raw streams to what each averaging cell says about the wing: rigid motion removed exactly.

A tip at ``r`` from the root feels ``f_root + omega' x r + omega x (omega x r) + (0, 0, -w'')``, turned by its own
bending slope. The roll acceleration stays in: with the lever of the wing it is as large as the bending, and it is a
state of the filter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.mode.layout import M_LEFT, P_LEFT, P_ROOT, ROWS, Y_LEFT, Z_LEFT, Layout
from companion.core.mode.sensitivity import Motion, rate_of_change, sensitivities
from companion.core.mode.stream import Stream
from companion.records import Axis, Bools, Floats, Ints

GRAVITY_MPS2 = 9.80665
_LEAST_FORCE_MPS2 = 1.0  # in free fall the lateral axis does not see the slope
_SIDE = np.array([1.0, -1.0])
_BESIDE = 2  # cells at either end that time derivatives and smoothing lean on


@dataclass(frozen=True, slots=True)
class Cells:
    """A run of consecutive averaging cells.

    Attributes
    ----------
    start_ns : (n,) int64
    rows : (n, 9) float64
        See :mod:`companion.core.mode.layout`.
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

    def __len__(self) -> int:
        return len(self.start_ns)

    def span(self, first: int, last: int) -> Cells:
        """The cells ``first:last``."""
        return Cells(*(getattr(self, name)[first:last] for name in _COLUMNS))


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
)


def join(runs: list[Cells]) -> Cells:
    """Put consecutive runs together."""
    return Cells(*(np.concatenate([getattr(run, name) for run in runs]) for name in _COLUMNS))


def make_cells(layout: Layout, streams: tuple[Stream, Stream, Stream], edges_ns: Ints) -> Cells:
    """Average the streams over the cells between ``edges_ns`` (equally spaced) and remove the rigid motion."""
    step_ns = edges_ns[1] - edges_ns[0]
    beside = step_ns * np.arange(1, _BESIDE + 1)
    wide_ns = np.concatenate([edges_ns[0] - beside[::-1], edges_ns, edges_ns[-1] + beside])
    motion, there = _motion(streams, wide_ns, float(step_ns) * 1e-9)
    gains = _lateral_gain(motion, there)
    rows = np.empty((len(there), ROWS))
    rows[:, Z_LEFT:M_LEFT] = motion.tip[:, :, 2] - motion.rigid[:, :, 2]
    rows[:, M_LEFT:Y_LEFT] = motion.moment - motion.step_s / 12.0 * motion.d_rigid_z
    rows[:, Y_LEFT:P_LEFT] = np.arctan((motion.tip[:, :, 1] - motion.rigid[:, :, 1]) * gains)
    rows[:, P_LEFT:P_ROOT] = motion.tip[:, :, 3]
    rows[:, P_ROOT] = motion.omega[:, 0]
    rows[~there] = 0.0
    lateral, vertical = there[:, Y_LEFT:P_LEFT], there[:, Z_LEFT:M_LEFT]
    cells = Cells(
        wide_ns[:-1],
        rows,
        there,
        motion.tip[:, :, 2] * vertical,
        motion.rigid[:, :, 1] * _SIDE * vertical,
        np.where(lateral, -motion.moment * motion.step_s * np.abs(gains) * np.sign(motion.tip[:, :, 2]), 0.0),
        np.where(lateral, gains, 0.0),
        motion.load,
        0.5 * (motion.omega + np.concatenate([motion.omega[1:], motion.omega[-1:]])),
        sensitivities(layout, motion, gains, there),
    )
    return cells.span(_BESIDE, len(cells) - _BESIDE)


def _motion(streams: tuple[Stream, Stream, Stream], edges_ns: Ints, step_s: float) -> tuple[Motion, Bools]:
    root, n = streams[0], len(edges_ns) - 1
    averages = [stream.average(edges_ns) for stream in streams]
    root_there = averages[0].covered
    calm = _smoothed(averages[0].mean, root_there) if root.filtered else averages[0].mean
    f_root, omega = calm[:, :3], calm[:, 3:]
    turn = rate_of_change(omega, step_s, root_there)
    there = np.zeros((n, ROWS), dtype=bool)
    there[:, P_ROOT] = root_there & _sends(root, Axis.P, "p")
    rigid, levers = np.empty((n, 2, 3)), np.empty((2, 3))
    centre = np.array(root.sensor.position_m)
    for side in (0, 1):
        stream, own = streams[1 + side], averages[1 + side]
        levers[side] = arm = np.array(stream.sensor.position_m) - centre
        rigid[:, side] = f_root + _cross(turn, arm) + _cross(omega, _cross(omega, arm))
        rigid[:, side, 2] -= turn[:, 0] * arm[1]  # the filter's business
        both = own.covered & root_there
        there[:, Z_LEFT + side] = both & _sends(stream, Axis.Z, "z")
        there[:, Y_LEFT + side] = both & _sends(stream, Axis.Y, "y")
        there[:, P_LEFT + side] = own.covered & _sends(stream, Axis.P, "p")
        if own.resolved:
            there[:, M_LEFT + side] = there[:, Z_LEFT + side]
    load = np.where(root_there & _sends(root, Axis.Z, "z"), -f_root[:, 2] / GRAVITY_MPS2 - 1.0, 0.0)
    motion = Motion(
        step_s=step_s,
        tip=np.stack([averages[1].mean, averages[2].mean], axis=1),
        moment=np.stack([averages[1].moment, averages[2].moment], axis=1),
        d_tip=np.stack([rate_of_change(own.mean, step_s, own.covered) for own in averages[1:]], axis=1),
        rigid=rigid,
        d_rigid_z=rate_of_change(rigid[:, :, 2], step_s, root_there),
        f_root=f_root,
        d_root=rate_of_change(f_root, step_s, root_there),
        omega=omega,
        turn=turn,
        load=load,
        levers_m=levers,
    )
    return motion, there


def _smoothed(values: Floats, there: Bools) -> Floats:
    """Weights 1/4, 1/2, 1/4 over neighbouring cells.

    A filtered root that sends at a few hundred hertz leaves noise in its cells that alternates from one to the next,
    several times its sensor's; rigid motion is too slow to notice (2 % at a twentieth of the cell rate).
    """
    out = values.copy()
    inner = there[2:] & there[1:-1] & there[:-2]
    out[1:-1][inner] = (0.25 * (values[:-2] + values[2:]) + 0.5 * values[1:-1])[inner]
    return out


def _sends(stream: Stream, axis: Axis, letter: str) -> bool:
    return bool(stream.axes & axis) and letter in stream.sensor.sends


def _cross(a: Floats, b: Floats) -> Floats:
    """``a x b`` along the last axis (numpy's own is ten times slower on short runs)."""
    out = np.empty_like(a)
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    out[..., 0], out[..., 1], out[..., 2] = a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0
    return out


def _lateral_gain(motion: Motion, there: Bools) -> Floats:
    # a tip without a vertical axis cannot say by what its lateral axis is to be divided: the rigid force stands in
    force = np.where(there[:, Z_LEFT:M_LEFT], motion.tip[:, :, 2], motion.rigid[:, :, 2])
    falls = np.abs(force) < _LEAST_FORCE_MPS2
    there[:, Y_LEFT:P_LEFT] &= ~falls
    gains: Floats = _SIDE / np.where(falls, -GRAVITY_MPS2, force)
    return gains

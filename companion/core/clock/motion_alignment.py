"""Clock offset of a node that does not answer TIMESYNC, from the motion that it shares with the autopilot's IMU.

In manoeuvres and gusts the whole aircraft turns, and every station's gyro measures it. The lag between a node's body
rates and the autopilot's, both smoothed until the wing's own modes are gone, is the node's clock offset. The sigma
comes from the residuals (bending, noise, bias), block by block, so that it holds for coloured residuals.

A node without gyro measures the aircraft's heave, and the roll through its lever arm, in its vertical specific force.
The autopilot's IMU gives the force that a rigid wing would have there, and the lag is found against that. The wing's
own motion in the force grows with the square of the frequency. So force is smoothed more and takes twice as long: 24 s
with pull-ups and rolls give the lag to about a millisecond, rates give a third of that in 12 s.

Both results become exchanges, as if the node had answered. A sample was taken at most :data:`MOST_DELAY_NS` before its
arrival. An alignment says how old the quickest arrivals are, to within its sigmas. The clock estimator then treats such
a node like any other, with bound, skew and restart.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.params.airframe import Sensor
from companion.records import Axis, ClockName, ClockState, Floats, ImuBatch, Ints, TimesyncReply

MOST_DELAY_NS = 60_000_000
"""Longest time from a sample to its arrival; a slower link cannot be aligned (choice)."""
SIGMAS = 4.0  # half width of an exchange from a lag, in sigmas: wrong in 6 of 100,000 (choice)
LARGEST_SIGMA_S = 0.0025
"""A lag with a larger sigma is not used: at 5 Hz this is 4.5 degrees of the mode's phase (choice)."""
# time between alignments: a lag of 12 s of motion changes little in 2 s; and between exchanges by arrival (choice)
_EVERY_S, _COARSE_S = 2.0, 0.5
# motion compared, and Hann window that leaves a seventh at 1.9 Hz and a thirtieth from 2.5 Hz on (choice)
_WINDOW_S, _SMOOTH_S = 12.0, 0.8
# twice the two above: the wing's own motion grows with the square of the frequency (choice)
_HEAVE_WINDOW_S, _HEAVE_SMOOTH_S = 24.0, 1.6
_CELL_S = 0.02  # cells of the averages: 50 a second, far finer than the smoothing (choice)
_BLOCK = 75  # cells in 1.5 s (derived)
_SEARCH_S = 0.004  # step of the search: Gauss-Newton converges from half of it (choice)
# sigma of the stamps themselves: an autopilot's are of sending, 0.1 to 0.6 ms late (choice)
_STAMPS_SIGMA_S = 0.0003
_HEAVE_FLOOR_S = 0.0006  # sigma by bend in step with the manoeuvre, which looks like a lag (choice)
_LINK_SIGMA_S = 0.0001  # sigma of the least delay of two seconds against that of others (choice)
_NEAR_NS = 1_000_000_000  # arrivals within this time of an instant give the least delay (choice)
_GAUSS_NEWTON_STEPS = 4  # steps after the coarse search; more change nothing (choice)
_BUFFER_S = 32.0  # the longer window and the largest delay (derived)
_HELD_NS = 64_000_000_000  # twice that by arrival: a clock that stands still fills no window (choice)


@dataclass(frozen=True, slots=True)
class Lag:
    """Lag of a node's series behind the root's, s, with its sigma."""

    lag_s: float
    sigma_s: float


@dataclass(slots=True)
class _Series:
    """Samples (n, 6) of one sensor with their stamps, ns, in batches."""

    stamps: list[Ints] = field(default_factory=list)
    values: list[Floats] = field(default_factory=list)
    received_ns: list[int] = field(default_factory=list)

    def add(self, t_ns: Ints, values: Floats, received_ns: int) -> None:
        if self.stamps and t_ns[0] < self.stamps[-1][-1] - 1_000_000_000:
            self.stamps.clear()  # its clock restarted
            self.values.clear()
            self.received_ns.clear()
        self.stamps.append(t_ns)
        self.values.append(values)
        self.received_ns.append(received_ns)
        while (
            self.stamps[-1][-1] - self.stamps[0][-1] > _BUFFER_S * 1e9 or received_ns - self.received_ns[0] > _HELD_NS
        ):
            del self.stamps[0], self.values[0], self.received_ns[0]

    def joined(self) -> tuple[Ints, Floats]:
        t_ns = np.concatenate(self.stamps)
        order = np.argsort(t_ns, kind="stable")
        return t_ns[order], np.concatenate(self.values)[order]


class MotionAlignment:
    """Alignment of one node by the samples of node and root; ask for :meth:`exchanges` about every 20 ms."""

    def __init__(self, clock: ClockName) -> None:
        self.clock = clock
        self._turns: list[int] = []  # rates that the node measures
        self._delay_s = (0.0, 0.0)
        self._lever_m: Floats = np.zeros(3)
        self._node, self._root = _Series(), _Series()
        self._arrivals: list[tuple[int, int]] = []
        self._next_coarse_ns = self._next_fine_ns = 0

    @staticmethod
    def possible(axes: Axis) -> bool:
        """Whether a node with these axes can be aligned: it needs rates, or vertical specific force."""
        return bool(axes & (Axis.GYRO | Axis.Z))

    def sensors(self, node: Sensor, root: Sensor) -> None:
        """Set the lever arm, and the delays of the root's low-passes less the node's."""
        self._lever_m = np.subtract(node.position_m, root.position_m)
        force_s = lowpass_delay_s(root.lowpass_accel_hz) - lowpass_delay_s(node.lowpass_accel_hz)
        # the root's rates are compared with the node's rates, or, carried to the node, with its force
        node_s = lowpass_delay_s(node.lowpass_gyro_hz if self._turns else node.lowpass_accel_hz)
        self._delay_s = (force_s, lowpass_delay_s(root.lowpass_gyro_hz) - node_s)

    def add_node(self, batch: ImuBatch) -> None:
        """Add samples of the node, stamps on its own clock."""
        self._turns = [k for k, axis in enumerate((Axis.P, Axis.Q, Axis.R)) if axis & batch.axes]
        self._node.add(batch.t_ns, batch.values, batch.received_host_ns)
        newest = int(batch.t_ns[-1])
        if self._arrivals and newest < self._arrivals[-1][0] - 1_000_000_000:
            self._arrivals.clear()
        self._arrivals.append((newest, batch.received_host_ns))
        while (
            newest - self._arrivals[0][0] > _BUFFER_S * 1e9 or batch.received_host_ns - self._arrivals[0][1] > _HELD_NS
        ):
            del self._arrivals[0]

    def add_root(self, batch: ImuBatch) -> None:
        """Add samples of the autopilot's IMU, in host time."""
        self._root.add(batch.t_ns, batch.values, batch.received_host_ns)

    def exchanges(self, now_host_ns: int, state: ClockState) -> Iterator[TimesyncReply]:
        """Alignments due by now, as exchanges; ``state`` is what is known of the node's clock."""
        if now_host_ns >= self._next_coarse_ns and self._arrivals:
            self._next_coarse_ns = now_host_ns + round(_COARSE_S * 1e9)
            yield from self._arrived(state)
        if now_host_ns >= self._next_fine_ns and self._node.stamps and self._root.stamps:
            self._next_fine_ns = now_host_ns + round(_EVERY_S * 1e9)
            yield from self._aligned(1e-6 * state.skew_ppm)

    def _arrived(self, state: ClockState) -> Iterator[TimesyncReply]:
        """Exchange by the newest arrival; none on a slow link, where what is known of the clock contradicts it."""
        stamp_ns, received_ns = self._arrivals[-1]
        slower_ns = received_ns - stamp_ns - self._base_ns()
        most_ns = MOST_DELAY_NS + slower_ns
        age_ns = received_ns + state.offset_ns - stamp_ns
        if state.bound_ns < most_ns < abs(age_ns) + state.bound_ns:
            return
        # The sample is not newer than its arrival. The exchange is as wide to both sides all the same: a one-sided one
        # would pull the estimate away from the lag.
        yield TimesyncReply(self.clock, received_ns - 2 * most_ns, stamp_ns - most_ns, received_ns)

    def _base_ns(self) -> int:
        """Arrival minus stamp of the quickest arrival: its sample is older than it by the least delay there is."""
        return min(received - stamp for stamp, received in self._arrivals)

    def _aligned(self, skew: float) -> Iterator[TimesyncReply]:
        base_ns = self._base_ns()
        (node_ns, node), (root_ns, root) = self._node.joined(), self._root.joined()
        span_s = _WINDOW_S if self._turns else _HEAVE_WINDOW_S
        end_ns = min(int(node_ns[-1]) + base_ns - MOST_DELAY_NS, int(root_ns[-1]))
        start_ns = end_ns - round(span_s * 1e9)
        if start_ns < max(int(node_ns[0]) + base_ns, int(root_ns[0])):
            return
        node_s = np.asarray((node_ns + base_ns - start_ns) * 1e-9, np.float64)
        root_s = np.asarray((root_ns - start_ns) * 1e-9, np.float64)
        measured = self._measured(node_s, node, root_s, root, span_s)
        if measured is None:
            return
        lag = Lag(measured.lag_s, math.hypot(measured.sigma_s, _STAMPS_SIGMA_S))
        if lag.sigma_s > LARGEST_SIGMA_S:
            return
        middle_ns = start_ns + round(span_s * 0.5e9)
        # age of the quickest arrivals at the middle of the window, and by how much more those of now may be older: what
        # is not the clock's skew may be a link that has become slower (positive) or quicker
        then_ns, _, then_received_ns = self._quickest(middle_ns)
        age_ns = then_ns - base_ns + round(lag.lag_s * 1e9)
        least_ns, stamp_ns, received_ns = self._quickest(self._arrivals[-1][1] - _NEAR_NS)
        older_ns = least_ns - then_ns + round(skew * (received_ns - then_received_ns))
        half_ns = round(SIGMAS * math.hypot(lag.sigma_s, _LINK_SIGMA_S) * 1e9)
        from_ns = received_ns - age_ns - max(older_ns, 0) - half_ns
        yield TimesyncReply(self.clock, from_ns, stamp_ns, received_ns - age_ns - min(older_ns, 0) + half_ns)

    def _quickest(self, host_ns: int) -> tuple[int, int, int]:
        """Arrival minus stamp, stamp and arrival, ns, of the quickest batch within a second of a host time."""
        near = [
            (received - stamp, stamp, received)
            for stamp, received in self._arrivals
            if abs(received - host_ns) <= _NEAR_NS
        ]
        return min(near, default=(self._arrivals[-1][1] - self._arrivals[-1][0], *self._arrivals[-1]))

    def _measured(self, node_s: Floats, node: Floats, root_s: Floats, root: Floats, span_s: float) -> Lag | None:
        most_s, (force_s, turn_s) = MOST_DELAY_NS * 1e-9, self._delay_s
        if self._turns:
            return lag_between(node_s, node[:, 3:], root_s - turn_s, root[:, 3:], span_s, most_s, self._turns)
        edges = _edges(span_s, most_s)
        force, rates = _means(root_s - force_s, root[:, :3], edges), _means(root_s - turn_s, root[:, 3:], edges)
        return heave_lag(node_s, node[:, 2:3], carried(force, rates, self._lever_m), span_s, most_s)


def lowpass_delay_s(cutoff_hz: float) -> float:
    """Delay of a 2nd-order Butterworth far below its cutoff, ``sqrt(2)/omega``, s; 0 without a filter."""
    return math.sqrt(2.0) / (2.0 * math.pi * cutoff_hz) if cutoff_hz > 0 else 0.0


def lag_between(
    node_s: Floats,
    node: Floats,
    root_s: Floats,
    root: Floats,
    span_s: float,
    most_s: float,
    axes: Sequence[int] = (0, 1, 2),
) -> Lag | None:
    """Lag of the node's stamps behind the root's, from body rates.

    Parameters
    ----------
    node_s, root_s : (n,), (m,) float64
        Stamps, s; the node's are late by 0 to ``most_s``.
    node, root : (n, 3), (m, 3) float64
        Body rates in rad/s.
    span_s : float
        Both series cover the time from 0 to this, s.
    most_s : float
        The largest lag, s.
    axes : sequence of int
        Axes that the node measures; its other columns are not used.

    Returns
    -------
    Lag or None
        None if nothing moves.
    """
    edges = _edges(span_s, most_s)
    reference, slope = _smoothed(_means(root_s, root, edges), _SMOOTH_S)
    others = np.hstack([reference, np.gradient(slope, _CELL_S, axis=0)])
    measured = list(axes)
    compared = _Reference(reference[:, measured], slope[:, measured], others, _SMOOTH_S)
    return _searched(node_s, node[:, measured], edges, compared, most_s)


def carried(force_mps2: Floats, rates_radps: Floats, lever_m: Floats) -> Floats:
    """Specific force (n, 3), m/s^2, at a lever arm on a rigid wing, from cell means of the root's force and rates.

    ``f + omega' x r + omega x (omega x r)``, all (n, 3) but the lever (3,), m, body axes.
    """
    turning = np.cross(np.gradient(rates_radps, _CELL_S, axis=0), lever_m)
    return np.asarray(force_mps2 + turning + np.cross(rates_radps, np.cross(rates_radps, lever_m)))


def heave_lag(node_s: Floats, node_mps2: Floats, rigid_mps2: Floats, span_s: float, most_s: float) -> Lag | None:
    """Lag of the node's stamps behind the root's, from its vertical specific force against a rigid wing's.

    Parameters
    ----------
    node_s : (n,) float64
        Stamps, s, late by 0 to ``most_s``.
    node_mps2 : (n, 1) float64
        Its specific force along z.
    rigid_mps2 : (c, 3) float64
        Specific force there on a rigid wing (see :func:`carried`), in the cells between 0.5 s and
        ``span_s - most_s - 0.5`` s.
    span_s, most_s : float
        See :func:`lag_between`.
    """
    rigid, slope = _smoothed(rigid_mps2, _HEAVE_SMOOTH_S)
    reference, slope = rigid[:, 2:], slope[:, 2:]
    others = np.hstack([rigid, np.gradient(slope, _CELL_S, axis=0)])
    lag = _searched(
        node_s, node_mps2, _edges(span_s, most_s), _Reference(reference, slope, others, _HEAVE_SMOOTH_S), most_s
    )
    return None if lag is None else Lag(lag.lag_s, math.hypot(lag.sigma_s, _HEAVE_FLOOR_S))


@dataclass(frozen=True, slots=True)
class _Reference:
    """Regressors of a node's smoothed series: its values without lag, their derivative, and leakage from other axes."""

    values: Floats
    slope: Floats
    others: Floats
    smooth_s: float


def _searched(node_s: Floats, node: Floats, edges: Floats, reference: _Reference, most_s: float) -> Lag | None:
    def late(lag_s: float) -> Floats:
        return _smoothed(_means(node_s, node, edges + lag_s), reference.smooth_s)[0] - reference.values

    trials = np.arange(0.0, most_s + _SEARCH_S, _SEARCH_S)
    lag_s = float(trials[int(np.argmin([np.sum(_level(late(lag)) ** 2) for lag in trials]))])
    sigma_s = np.inf
    for _ in range(_GAUSS_NEWTON_STEPS):
        step_s, sigma_s = _regressed(late(lag_s), reference.slope, reference.others)
        lag_s += step_s
    if not (np.isfinite(sigma_s) and -_SEARCH_S <= lag_s <= most_s):
        return None
    return Lag(lag_s, sigma_s)


def _edges(span_s: float, most_s: float) -> Floats:
    return np.arange(0.5, span_s - most_s - 0.5, _CELL_S)


def _means(t_s: Floats, values: Floats, edges: Floats) -> Floats:
    """Averages over the cells between edges, by the integral of the samples' linear interpolation."""
    area = np.zeros_like(values)
    np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t_s)[:, np.newaxis], axis=0, out=area[1:])
    at = np.stack([np.interp(edges, t_s, column) for column in area.T], axis=1)
    return np.asarray(np.diff(at, axis=0) / _CELL_S)


def _smoothed(values: Floats, window_s: float) -> tuple[Floats, Floats]:
    """Series smoothed by a Hann window and its derivative, without the half windows at both ends."""
    window = np.hanning(round(window_s / _CELL_S) + 2)
    window /= window.sum()
    slow = np.stack([np.convolve(column, window, mode="valid") for column in values.T], axis=1)
    return slow, np.gradient(slow, _CELL_S, axis=0)


def _level(values: Floats) -> Floats:
    return np.asarray(values - values.mean(axis=0))


def _regressed(difference: Floats, slope: Floats, others: Floats) -> tuple[float, float]:
    """Remaining lag and its sigma, s, of ``difference = -lag slope + others b + rest``; axes are weighted by their fit.

    ``others`` are the root's series and their second derivatives, all axes for each axis: a node tilted by the bend
    measures a little of the other axes, its scale differs from the root's, and the wing bends under acceleration. The
    sigma is the jackknife's over blocks of 1.5 s. It holds for coloured residuals, and includes the loss by fitting
    ``others``.
    """
    estimate = _solved(difference, slope, others)
    starts = range(0, len(slope) - _BLOCK // 2, _BLOCK)
    replicates = []
    for start in starts:
        retained = np.ones(len(slope), dtype=np.bool_)
        retained[start : start + _BLOCK] = False
        replicates.append(_solved(difference[retained], slope[retained], others[retained]))
    spread = np.array(replicates) - np.mean(replicates)
    return estimate, float(np.sqrt((len(replicates) - 1) / len(replicates) * np.sum(spread**2)))


def _solved(difference: Floats, slope: Floats, others: Floats) -> float:
    basis = np.linalg.qr(np.hstack([np.ones((len(others), 1)), others]))[0]
    difference, slope = (values - basis @ (basis.T @ values) for values in (difference, slope))
    information = np.einsum("ij,ij->j", slope, slope)
    with np.errstate(divide="ignore", invalid="ignore"):
        axis_lag_s = -np.einsum("ij,ij->j", slope, difference) / information
    if not np.isfinite(axis_lag_s).all():
        return math.nan
    weight = information / np.maximum(np.var(difference + axis_lag_s * slope, axis=0), 1e-12)
    return float(weight @ axis_lag_s / weight.sum())

"""The time of a node that does not answer TIMESYNC, from the motion that it shares with the autopilot's IMU.

In manoeuvres and gusts the whole aircraft turns, and every station's gyro sees it. The lag between a node's body rates
and the autopilot's, both smoothed until the wing's own modes are gone, is the node's clock offset. What differs and is
not lag (bending, noise, bias) is what the sigma is made from, block by block, so that it holds for coloured residuals.

Both kinds of knowledge are handed on as exchanges, as if the node had been asked: what arrived was taken at most
:data:`MOST_DELAY_NS` before, and an alignment says the node's reading at a host time to within its sigmas. The clock
estimator then treats such a node like any other, bound, skew, restart and all.

A node that has neither gyro nor TIMESYNC is left out: on its specific forces, in which the wing takes part and not the
aircraft alone, the same regression gave lags that were 3 to 6 ms off.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from companion.records import ClockName, Floats, ImuBatch, Ints, TimesyncReply

MOST_DELAY_NS = 60_000_000
"""From a sample to its arrival, at most; a slower link cannot be aligned."""
SIGMAS = 4.0
_WINDOW_S, _EVERY_S, _COARSE_S = 12.0, 2.0, 0.5
_CELL_S = 0.02
_SMOOTH_S = 0.8  # a Hann window so long passes a tenth at 1.9 Hz and a thirtieth from 2.5 Hz on
_BLOCK = 75  # cells in 1.5 s
_SEARCH_S = 0.004
_LARGEST_SIGMA_S = 0.0025
_STAMPS_SIGMA_S = 0.0003  # what the stamps themselves leave open: an autopilot's are of sending, 0.1 to 0.6 ms late
_ROUNDS = 4
_KEPT_S = 20.0


@dataclass(frozen=True, slots=True)
class Lag:
    """By how much a node's series is later than the root's, with its sigma."""

    lag_s: float
    sigma_s: float


@dataclass(slots=True)
class _Series:
    """Body rates of one sensor with their stamps; several batches, joined when they are needed."""

    stamps: list[Ints] = field(default_factory=list)
    rates: list[Floats] = field(default_factory=list)

    def add(self, t_ns: Ints, rates: Floats) -> None:
        if self.stamps and t_ns[0] < self.stamps[-1][-1] - 1_000_000_000:
            self.stamps.clear()  # its clock restarted
            self.rates.clear()
        self.stamps.append(t_ns)
        self.rates.append(rates)
        while self.stamps[-1][-1] - self.stamps[0][-1] > _KEPT_S * 1e9:
            del self.stamps[0], self.rates[0]

    def joined(self) -> tuple[Ints, Floats]:
        t_ns = np.concatenate(self.stamps)
        order = np.argsort(t_ns, kind="stable")
        return t_ns[order], np.concatenate(self.rates)[order]


class Alignment:
    """One node's. Feed it both streams, then ask for exchanges about every 20 ms.

    Attributes
    ----------
    filter_delay_s : float
        By how much the root's low-pass delays its slow rates more than the node's does its own (see
        :func:`lowpass_delay_s`); to be kept up to date by the owner.
    newest : Lag or None
        The last alignment.
    """

    def __init__(self, clock: ClockName) -> None:
        self.clock = clock
        self.filter_delay_s = 0.0
        self.newest: Lag | None = None
        self._node, self._root = _Series(), _Series()
        self._arrivals: list[tuple[int, int]] = []
        self._next_coarse_ns = self._next_fine_ns = 0

    def add_node(self, batch: ImuBatch) -> None:
        """Take samples of the node, stamps on its own clock."""
        self._node.add(batch.t_ns, batch.values[:, 3:])
        newest = int(batch.t_ns[-1])
        if self._arrivals and newest < self._arrivals[-1][0] - 1_000_000_000:
            self._arrivals.clear()
        self._arrivals.append((newest, batch.received_host_ns))
        while self._arrivals[-1][0] - self._arrivals[0][0] > _KEPT_S * 1e9:
            del self._arrivals[0]

    def add_root(self, t_host_ns: Ints, rates_radps: Floats) -> None:
        """Take samples of the autopilot's IMU, (n,) and (n, 3), in host time."""
        self._root.add(t_host_ns - round(self.filter_delay_s * 1e9), rates_radps)

    def exchanges(self, now_host_ns: int) -> Iterator[TimesyncReply]:
        """What can be said now, as exchanges."""
        if now_host_ns >= self._next_coarse_ns and self._arrivals:
            self._next_coarse_ns = now_host_ns + round(_COARSE_S * 1e9)
            stamp_ns, received_ns = self._arrivals[-1]
            yield TimesyncReply(self.clock, received_ns - MOST_DELAY_NS, stamp_ns, received_ns)
        if now_host_ns >= self._next_fine_ns and self._node.stamps and self._root.stamps:
            self._next_fine_ns = now_host_ns + round(_EVERY_S * 1e9)
            yield from self._aligned()

    def _aligned(self) -> Iterator[TimesyncReply]:
        # the quickest arrival: its sample is older than it by the least delay there is
        base_ns = min(received - stamp for stamp, received in self._arrivals)
        (node_ns, node), (root_ns, root) = self._node.joined(), self._root.joined()
        end_ns = min(int(node_ns[-1]) + base_ns - MOST_DELAY_NS, int(root_ns[-1]))
        start_ns = end_ns - round(_WINDOW_S * 1e9)
        if start_ns < max(int(node_ns[0]) + base_ns, int(root_ns[0])):
            return
        span_s = _WINDOW_S
        measured = lag_between(
            np.asarray((node_ns + base_ns - start_ns) * 1e-9, np.float64),
            node,
            np.asarray((root_ns - start_ns) * 1e-9, np.float64),
            root,
            span_s,
            MOST_DELAY_NS * 1e-9,
        )
        if measured is None or measured.sigma_s > _LARGEST_SIGMA_S:
            return
        self.newest = found = Lag(measured.lag_s, math.hypot(measured.sigma_s, _STAMPS_SIGMA_S))
        middle_ns, half_ns = start_ns + round(span_s * 0.5e9), round(SIGMAS * found.sigma_s * 1e9)
        stamp_ns = middle_ns - base_ns + round(found.lag_s * 1e9)
        yield TimesyncReply(self.clock, middle_ns - half_ns, stamp_ns, middle_ns + half_ns)


def lowpass_delay_s(cutoff_hz: float) -> float:
    """Delay of a 2nd-order Butterworth far below its cutoff, ``sqrt(2)/omega``; 0 where there is none."""
    return math.sqrt(2.0) / (2.0 * math.pi * cutoff_hz) if cutoff_hz > 0 else 0.0


def lag_between(node_s: Floats, node: Floats, root_s: Floats, root: Floats, span_s: float, most_s: float) -> Lag | None:
    """Find by how much the node's series is late against the root's.

    Parameters
    ----------
    node_s, root_s : (n,), (m,) float64
        Stamps; the node's are late by 0 to ``most_s``.
    node, root : (n, 3), (m, 3) float64
        Body rates in rad/s.
    span_s : float
        Both series cover 0 to this.
    most_s : float
        The largest lag.

    Returns
    -------
    Lag or None
        None where nothing moves.
    """
    edges = np.arange(0.5, span_s - most_s - 0.5, _CELL_S)
    wanted, slope = _smoothed(_means(root_s, root, edges))
    trials = np.arange(0.0, most_s + _SEARCH_S, _SEARCH_S)
    misfits = [np.sum((_level(_smoothed(_means(node_s, node, edges + lag))[0] - wanted)) ** 2) for lag in trials]
    lag_s = float(trials[int(np.argmin(misfits))])
    sigma_s = np.inf
    for _ in range(_ROUNDS):
        late = _smoothed(_means(node_s, node, edges + lag_s))[0]
        step_s, sigma_s = _regressed(late - wanted, slope, np.hstack([wanted, np.gradient(slope, _CELL_S, axis=0)]))
        lag_s += step_s
    if not (np.isfinite(sigma_s) and -_SEARCH_S <= lag_s <= most_s + _SEARCH_S):
        return None
    return Lag(lag_s, sigma_s)


def _means(t_s: Floats, values: Floats, edges: Floats) -> Floats:
    """Averages over the cells between edges, from the running integral of what lies between the samples."""
    area = np.zeros_like(values)
    np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(t_s)[:, np.newaxis], axis=0, out=area[1:])
    at = np.stack([np.interp(edges, t_s, column) for column in area.T], axis=1)
    return np.asarray(np.diff(at, axis=0) / _CELL_S)


def _smoothed(values: Floats) -> tuple[Floats, Floats]:
    """The slow part and its derivative, as far as the window reaches."""
    window = np.hanning(round(_SMOOTH_S / _CELL_S) + 2)
    window /= window.sum()
    slow = np.stack([np.convolve(column, window, mode="valid") for column in values.T], axis=1)
    return slow, np.gradient(slow, _CELL_S, axis=0)


def _level(values: Floats) -> Floats:
    return np.asarray(values - values.mean(axis=0))


def _regressed(difference: Floats, slope: Floats, others: Floats) -> tuple[float, float]:
    """``difference = -lag slope + others b + rest``: the lag left and its sigma, axes weighted by how well they fit.

    ``others`` are the rates and their second derivatives, each axis into each: a node that is tilted by the bend sees
    a little of the other rates, its scale is not the root's, and the wing gives way to angular acceleration. The sigma
    is the jackknife's over blocks of 1.5 s, so that it holds for coloured residuals and for what the fit of ``others``
    takes away.
    """
    whole = _solved(difference, slope, others)
    starts = range(0, len(slope) - _BLOCK // 2, _BLOCK)
    parts = []
    for start in starts:
        kept = np.ones(len(slope), dtype=np.bool_)
        kept[start : start + _BLOCK] = False
        parts.append(_solved(difference[kept], slope[kept], others[kept]))
    spread = np.array(parts) - np.mean(parts)
    return whole, float(np.sqrt((len(parts) - 1) / len(parts) * np.sum(spread**2)))


def _solved(difference: Floats, slope: Floats, others: Floats) -> float:
    basis = np.linalg.qr(np.hstack([np.ones((len(others), 1)), others]))[0]
    difference, slope = (values - basis @ (basis.T @ values) for values in (difference, slope))
    information = np.einsum("ij,ij->j", slope, slope)
    with np.errstate(divide="ignore", invalid="ignore"):
        own = -np.einsum("ij,ij->j", slope, difference) / information
    if not np.isfinite(own).all():
        return math.nan
    weight = information / np.maximum(np.var(difference + own * slope, axis=0), 1e-12)
    return float(weight @ own / weight.sum())

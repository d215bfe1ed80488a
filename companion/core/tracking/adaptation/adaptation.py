"""On-line adaptation: once a second the parameters that make the last seconds of vertical acceleration most likely.

A long stretch tells the gust's colour, and so the slow bend; where the wing drifts, it is fitted in the time in which
the vibration is steady (:mod:`companion.core.tracking.adaptation.frequency_drift`). In the first ten seconds the
parameters move by much; whoever filters should then start again from the beginning, or early errors stay in the biases.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any, TypeVar, cast

import numpy as np

from companion.core.tracking.adaptation.channels import COLUMNS, ROLL, STATIC, Channels
from companion.core.tracking.adaptation.frequency_drift import at_end, evened, growing, likeliest, when_evened
from companion.core.tracking.adaptation.noise_psd import Floor
from companion.core.tracking.adaptation.periodogram import Stretch, make_stretch, make_stretches
from companion.core.tracking.adaptation.whittle import Fit, Prior, fit, misfit, scan, seek_peak
from companion.core.tracking.model import Parameters
from companion.core.tracking.parameters import (
    CORNER_1,
    CORNER_2,
    FREQUENCY,
    FREQUENCY_2,
    LIMITS,
    LOAD,
    LOAD_2,
    PARAMETERS,
    ModeParameters,
)
from companion.core.tracking.rigid_body import Cells
from companion.core.tracking.states import P_ROOT, Layout, Noise
from companion.records import Bools, Floats

_LONG_S = 20.0
_PIECE_S = 4.0
_EARLY_S = 10.0
_FIRST_S = 1.5
_PERIOD_S = 1.0
_SCAN_UNTIL_S = 6.0
_PEAK_EVIDENCE = 8.0
_SECOND_EVIDENCE = 3.0
_IDLE = 1e-7  # of the first mode's load
_CORNERS_HZ = ((2.0, 8.0), (5.0, 20.0), (1.0, 500.0), (500.0, 1000.0))
_ROUNDS = 6
_CLEARLY = 1.0
_LOWEST_HZ = 0.25  # a stiff wing's slow bend, though the tip hardly feels it, is told by the gust's colour down there
_REACH = 4.0
_FARTHEST = np.log(2.0)  # a wing that is loaded or iced drifts far beyond what was believed of it at rest
_CUT_MEMORY_S = 5.0
_LEAST_PRESENT = 0.98
_HOLE_CELLS = 11

_Ring = TypeVar("_Ring", bound=Any)


class Adaptation:
    """Parameters of both families, kept up to date.

    Attributes
    ----------
    parameters : (symmetric, antisymmetric)
    ambiguous : bool
        The last fit had two answers that were about as good.
    refilter : bool
        The last fit happened early enough for the filter to start again.
    """

    def __init__(
        self, layout: Layout, noise: Noise, prior: Parameters, levers_m: tuple[float, float], step_s: float
    ) -> None:
        self._channels, self._step_s = Channels(layout, noise, levers_m, step_s), step_s
        self._prior = prior
        self.parameters: Parameters = prior
        self._constants, self._bend_per_g_m = np.zeros(len(layout.constants)), 0.0
        self.ambiguous = False
        self.refilter = False
        size, self._piece = round(_LONG_S / step_s), round(_PIECE_S / step_s)
        self._rows, self._seen = np.zeros((size, COLUMNS)), np.zeros((size, 2), dtype=bool)
        self._sensitivity = np.zeros((size, 2, len(layout.constants)))
        self._count = 0
        self._next = round(_FIRST_S / step_s)
        self.fits = 0
        self._cut = 0.0  # how much the edges of the last cells cut samples
        self._contradicted = False
        self._rates = [(0.0, 0.0), (0.0, 0.0)]  # of both families' frequencies, 1/s, and their sigmas
        self._only = 0  # the tip that is there, where one is missing

    @property
    def early(self) -> bool:
        """Whether the history is still to be kept."""
        return self._count < round(_EARLY_S / self._step_s)

    def split(self, cells: Cells) -> Iterator[Cells]:
        """Cut a run where the parameters may change, so that this does not depend on how calls are spaced."""
        at = 0
        while at < len(cells):
            end = min(len(cells), at + max(self._next - self._count, 1))
            yield cells.span(at, end)
            at = end

    def learn(self, constants: Floats, bend_per_g_m: float) -> None:
        """Take over the sensor errors and the bend per g as they are known by now; all that is kept is seen by them."""
        self._constants, self._bend_per_g_m = constants.copy(), bend_per_g_m

    def take(self, cells: Cells, contradicted: bool = False) -> bool:
        """Take cells; say whether there are new parameters.

        ``contradicted``: the filter cannot explain what it measures, or could not with the parameters found last. A
        second mode then needs no evidence from the vertical axes: a gyro, which the fit does not see, shows one a
        hundred times better.
        """
        self._contradicted = contradicted
        size = len(self._rows)
        first, last = self._count % size, self._count % size + len(cells)
        slots = slice(first, last) if last <= size else np.arange(first, last) % size
        self._rows[slots, :2], self._sensitivity[slots] = cells.rows[:, :2], cells.sensitivity[:, :2]
        self._rows[slots, ROLL], self._rows[slots, STATIC] = cells.rows[:, P_ROOT], cells.load
        self._seen[slots] = cells.present[:, :2]
        self._cut += min(1.0, len(cells) * self._step_s / _CUT_MEMORY_S) * (_mean(cells.cut) - self._cut)
        self.refilter = self.early
        self._count += len(cells)
        if self._count < self._next:
            return False
        elapsed = self._count * self._step_s
        self._next = round((np.floor(elapsed / _PERIOD_S + 1e-6) + 1.0) * _PERIOD_S / self._step_s)
        return self._fit_all(elapsed)

    def _fit_all(self, elapsed_s: float) -> bool:
        rows, seen = self._kept()
        since = self._last_hole(seen)
        if since and len(rows) - since < self._piece:
            return False
        rows, seen = rows[since:], seen[since:]
        tips = seen.mean(axis=0) >= _LEAST_PRESENT
        if not tips.any():
            return False
        self.fits += 1
        self._only = int(np.argmax(tips))
        self.ambiguous = False
        if tips.all():
            families = [self._fit_family(rows, (k,), elapsed_s)[0] for k in (0, 1)]
        else:
            families = self._fit_family(rows, (0, 1), elapsed_s)
        self.parameters = (families[0], families[1])
        return True

    def _last_hole(self, seen: Bools) -> int:
        """Where the newest stretch with both tips begins, if one of them was away for a while; 0 where it always was.

        What only one tip says of both families is not worth leaving what both have said.
        """
        both = seen[:, 0] & seen[:, 1]
        if both.mean() >= _LEAST_PRESENT or not both.any():
            return 0
        present = np.convolve(both, np.ones(_HOLE_CELLS), mode="same") > 0.5
        missing = np.flatnonzero(~present)
        return int(missing[-1]) + 1 + _HOLE_CELLS // 2 if len(missing) else 0

    def _kept(self) -> tuple[Floats, Bools]:
        """Everything that is kept, oldest first, seen by the constants as known now."""
        count = min(self._count, len(self._rows))
        first = (self._count - count) % len(self._rows)
        rows, seen = _in_order(self._rows, first, count).copy(), _in_order(self._seen, first, count)
        known = _in_order(self._sensitivity, first, count)
        rows[:, :2] -= (known.reshape(2 * count, -1) @ self._constants).reshape(count, 2)
        rows[:, STATIC] *= self._bend_per_g_m
        return rows, seen

    def _fit_family(self, rows: Floats, which: tuple[int, ...], elapsed_s: float) -> list[ModeParameters]:
        known = (self.parameters, self._cut, self._bend_per_g_m)
        samples, floor = self._channels.of(rows, which, self._only, *known)
        prior = _join([self._prior[k] for k in which])
        start = np.concatenate([self.parameters[k].logs() for k in which])
        band = self._band(which)
        length_s = len(samples) * self._step_s
        rate, rate_sigma = self._rates[which[0]]
        if elapsed_s > _EARLY_S:
            rate, rate_sigma = self._drifting(samples, band, floor, prior, start, rate)
        for k in which:
            self._rates[k] = rate, rate_sigma
        long, start = (
            make_stretch(evened(samples, rate, self._step_s), self._step_s, band, floor),
            when_evened(start, rate, length_s),
        )
        if elapsed_s <= _SCAN_UNTIL_S:
            best = self._search(long, prior, self._scanned(long, prior, start))
        else:
            best = self._improved(long, prior, start, which[0])
        best = _without_idle_seconds(long, prior, best, -np.inf if self._contradicted else _SECOND_EVIDENCE)
        by_rate = 0.5 * length_s * rate_sigma * growing(len(start))
        best = Fit(at_end(best.logs, rate, length_s), np.hypot(best.log_sigma, by_rate), best.cost)
        out, at = [], 0
        for k in which:
            piece = slice(at, at + PARAMETERS)
            out.append(self._prior[k].with_logs(best.logs[piece], best.log_sigma[piece]))
            at += PARAMETERS
        return out

    def _drifting(
        self, samples: Floats, band: tuple[float, float, float], floor: Floor, prior: Prior, start: Floats, rate: float
    ) -> tuple[float, float]:
        """Rate of the frequencies, one step on from the one that was believed, and its sigma."""
        count = len(samples) // self._piece
        newest = samples[len(samples) - count * self._piece :].reshape(count, self._piece)
        pieces = make_stretches(newest, self._step_s, band, floor)
        length_s = count * _PIECE_S
        return likeliest(pieces, _PIECE_S, prior, when_evened(start, rate, length_s), rate)

    def _improved(self, stretch: Stretch, prior: Prior, start: Floats, family: int) -> Fit:
        """Go on from where the last fit ended; in turns try another colour of the gust, or a peak that it has not.

        Such a try costs more than all the rest: the families have it by turns.
        """
        best = fit(stretch, prior, start, 3)
        if self.fits % 2 != family:
            return best
        turn = self.fits // 2 % (1 + len(_CORNERS_HZ))
        tried = _recoloured(best.logs, _CORNERS_HZ[turn - 1]) if turn else self._with_second(stretch, prior, best.logs)
        if np.array_equal(tried, best.logs):
            return best
        other = fit(stretch, prior, tried, 2 * _ROUNDS)
        return other if other.cost < best.cost - _CLEARLY else best

    def _search(self, stretch: Stretch, prior: Prior, start: Floats) -> Fit:
        """Fit from gusts of several colours: a wrong one holds on to its own local answer."""
        best: Fit | None = None
        for corners_hz in (None, *_CORNERS_HZ):
            tried = start if corners_hz is None else _recoloured(start, corners_hz)
            found = fit(stretch, prior, self._with_second(stretch, prior, tried), _ROUNDS)
            if best is None or found.cost < best.cost:
                best = found
        assert best is not None
        return fit(stretch, prior, best.logs, _ROUNDS)

    def _with_second(self, stretch: Stretch, prior: Prior, start: Floats) -> Floats:
        least = 0.0 if self._contradicted else _PEAK_EVIDENCE
        for at in range(FREQUENCY_2, len(start), PARAMETERS):
            moved, gain = seek_peak(stretch, prior, start, at)
            start = moved if gain > least else start
        return start

    def _band(self, which: tuple[int, ...]) -> tuple[float, float, float]:
        highest = 0.48 / self._step_s
        return _LOWEST_HZ, min(2.2 * max(self._prior[k].frequency_hz for k in which), 0.8 * highest), highest

    def _scanned(self, stretch: Stretch, prior: Prior, start: Floats) -> Floats:
        for at in range(0, len(start), PARAMETERS):
            reach = min(3.0 * prior.sigma[at], 0.7)
            costs, starts = scan(stretch, prior, start, at, np.linspace(-reach, reach, 21))
            best = int(np.argmin(costs))
            start = starts[best]
            self.ambiguous |= _two_answers(costs)
        return start


def _mean(values: Floats) -> float:
    """What ``mean`` says, at a third of its price for a few numbers."""
    return float(np.add.reduce(values, axis=None)) / values.size


def _in_order(ring: _Ring, first: int, count: int) -> _Ring:
    """The ``count`` entries from ``first`` on; as they lie there where that is possible."""
    return cast(_Ring, np.concatenate([ring[first:], ring[:first]]) if first else ring[:count])


def _join(families: list[ModeParameters]) -> Prior:
    logs = [family.logs() for family in families]
    mean, sigma = np.concatenate(logs), np.concatenate([family.log_sigma for family in families])
    low, high = (np.tile(np.log(limit), len(families)) for limit in LIMITS)
    lowest = np.maximum(low, mean - _REACH * sigma)
    highest = np.minimum(high, mean + _REACH * sigma)
    lowest[LOAD_2::PARAMETERS] = low[LOAD_2::PARAMETERS]
    own = slice(FREQUENCY, None, PARAMETERS)
    lowest[own] = np.minimum(lowest[own], mean[own] - _FARTHEST)
    highest[own] = np.maximum(highest[own], mean[own] + _FARTHEST)
    return Prior(mean, sigma, lowest, highest, np.array([family.reference_hz for family in families]))


def _recoloured(start: Floats, corners_hz: tuple[float, float]) -> Floats:
    moved = start.copy()
    moved[CORNER_1::PARAMETERS], moved[CORNER_2::PARAMETERS] = np.log(corners_hz)
    return moved


def _without_idle_seconds(stretch: Stretch, prior: Prior, found: Fit, least_evidence: float) -> Fit:
    """Silence a second mode without evidence: its share of a white load could not be told from the first mode's."""
    logs, value = found.logs.copy(), misfit(stretch, prior, found.logs)
    for at in range(0, len(logs), PARAMETERS):
        tried = logs.copy()
        tried[at + LOAD_2] = max(tried[at + LOAD] + np.log(_IDLE), prior.low[at + LOAD_2])
        without = misfit(stretch, prior, tried)
        if without - value < least_evidence:
            logs, value = tried, without
    return dataclasses.replace(found, logs=logs)


def _two_answers(costs: Floats) -> bool:
    inner = (costs[1:-1] < costs[:-2]) & (costs[1:-1] < costs[2:])
    lows = np.sort(costs[1:-1][inner])
    return len(lows) > 1 and bool(lows[1] - lows[0] < 2.0)

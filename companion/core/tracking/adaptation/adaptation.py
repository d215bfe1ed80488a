"""On-line adaptation: once a second the most probable parameters for the last seconds of vertical acceleration.

A long segment tells the gust's corners, and so the slow bend; where the wing drifts, it is fitted in the time in which
the vibration is stationary (:mod:`companion.core.tracking.adaptation.frequency_drift`). In the first ten seconds the
parameters move by much; the filter then starts again from the beginning, or early errors stay in the biases.

After them the stages of a fit are spread over turns of the service, and its result is due at a fixed epoch: a fit at
once would hold up one turn by several milliseconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from companion.core.kernels.arrays import Epochs
from companion.core.tracking.adaptation.channels import COLUMNS, ROLL, SLOPE_RATES, STATIC, Channels
from companion.core.tracking.adaptation.gap_filling import fill_gaps
from companion.core.tracking.adaptation.spectral_fit import EARLY_S, SEGMENT_S, FitInput, SpectralFit
from companion.core.tracking.model import WingParameters
from companion.core.tracking.spread_work import SPREAD_S, Stages
from companion.core.tracking.states import P_LEFT, P_RIGHT, P_ROOT, Z_LEFT, Z_RIGHT, SensorNoise, StateLayout
from companion.records import Bools, Floats

_BEGUN_S = 6.0  # chosen: a history that began anew must outweigh what the last parameters were fitted to
_LONG_S = 20.0  # chosen: five periods of the lowest frequency that is fitted
_FIRST_S = 1.5  # chosen: seven periods at 5 Hz for the first fit
_PERIOD_S = 1.0  # chosen: between fits
_ALIASING_MEMORY_S = 5.0  # chosen: of the mean aliasing noise
_NO_GAP = 0.98  # chosen: of the epochs of a history with both tips; what is missing is filled
_MIN_PRESENT = 0.9  # chosen: of the epochs of a segment; filled ones lack the load that nobody can tell
_GAP_EPOCHS = 51  # chosen, odd, a period at 5 Hz: absent over so many epochs is a gap, shorter ones are filled
_LOSS_EPOCHS = 11  # chosen, odd: the same where more is missing than may be filled
_MEASURED = ((Z_LEFT, 0), (Z_RIGHT, 1), (ROLL, 2), (STATIC, 2))  # by definition: columns, and by whom: tips, root


class FitProgress(NamedTuple):
    """Fit that begins or ends with the newest epochs.

    Attributes
    ----------
    stages : generator or None
        Stages of a fit that begins.
    due : bool
        The result of the fit that began last is due; its owner sets ``parameters``.
    """

    stages: Stages[WingParameters] | None = None
    due: bool = False


_Ring = TypeVar("_Ring", bound=Any)


class Adaptation:
    """Parameters of both families, kept up to date.

    Attributes
    ----------
    parameters : (symmetric, antisymmetric)
        In use.
    refilter : bool
        The last fit happened early enough for the filter to start again.
    """

    def __init__(
        self,
        layout: StateLayout,
        noise: SensorNoise,
        prior: WingParameters,
        levers_m: tuple[float, float],
        step_s: float,
    ) -> None:
        self._fit = SpectralFit(Channels(layout, noise, levers_m, step_s), prior, step_s)
        self._step_s = step_s
        self.parameters: WingParameters = prior
        self._bias_parameters, self._bend_per_g_m = np.zeros(len(layout.bias_parameters)), 0.0
        self.refilter = False
        size, self._segment_epochs = round(_LONG_S / step_s), round(SEGMENT_S / step_s)
        self._rows, self._present = np.zeros((size, COLUMNS)), np.zeros((size, 3), dtype=bool)
        self._sensitivity = np.zeros((size, 2, len(layout.bias_parameters)))
        self._count = 0
        self._next = round(_FIRST_S / step_s)  # epoch of the next fit
        self._due: int | None = None  # epoch at which the running fit is due
        self._history_from = 0  # epoch with which the history begins
        self._aliasing_noise = 0.0  # by edges of the last epochs that cut samples

    @property
    def fits(self) -> int:
        """Number of fits begun."""
        return self._fit.fits

    @property
    def ambiguous(self) -> bool:
        """Whether the last fit had two local optima of about the same posterior."""
        return self._fit.ambiguous

    @property
    def early(self) -> bool:
        """Whether the tracker began so lately that it starts again rather than mend what it has."""
        return self._count < round(EARLY_S / self._step_s)

    def split(self, epochs: Epochs, *, fits: bool = True) -> Iterator[Epochs]:
        """Cut a run where parameters may change, so that the spacing of calls changes nothing.

        Where ``fits`` is False nothing is fitted or stored: the run is whole, and time goes by.
        """
        if not fits:
            yield epochs
            self._count += epochs.length
            return
        at = 0
        while at < epochs.length:
            until = self._next if self._due is None else min(self._next, self._due)
            end = min(epochs.length, at + max(until - self._count, 1))
            yield epochs.span(at, end)
            at = end

    def set_bias_parameters(self, bias_parameters: Floats, bend_per_g_m: float) -> None:
        """Bias parameters (c,) and bend per g, m, as estimated; they correct the whole stored history."""
        self._bias_parameters, self._bend_per_g_m = bias_parameters.copy(), bend_per_g_m

    def _learn_aliasing(self, epochs: Epochs) -> None:
        """Follow the aliasing noise of the tips; an epoch that a tip did not cover has none of its own."""
        present, noise = epochs.present[:, :2], epochs.aliasing_noise
        if not present.all():
            noise = noise[present]
        if noise.size:
            gain = min(1.0, epochs.length * self._step_s / _ALIASING_MEMORY_S)
            self._aliasing_noise += gain * (_mean(noise) - self._aliasing_noise)

    def add_epochs(
        self, epochs: Epochs, contradicted: bool = False, hold: bool = False, clipped: bool = False
    ) -> FitProgress:
        """Take epochs; a fit begins or ends with them.

        ``contradicted``: the filter cannot explain its measurements, or could not with the last parameters. A further
        mode then needs no evidence from the vertical axes: a gyro, which the fit does not use, shows one a hundred
        times better. ``hold``: no fit begins (the history has a blow, or its ringing). ``clipped``: samples often are.
        """
        size = len(self._rows)
        first, last = self._count % size, self._count % size + epochs.length
        slots = slice(first, last) if last <= size else np.arange(first, last) % size
        self._rows[slots, :2], self._sensitivity[slots] = epochs.rows[:, :2], epochs.sensitivity[:, :2]
        self._rows[slots, ROLL], self._rows[slots, STATIC] = epochs.rows[:, P_ROOT], epochs.load_g
        self._rows[slots, SLOPE_RATES] = epoch_slope_rates(epochs)
        self._present[slots, :2], self._present[slots, 2] = epochs.present[:, :2], epochs.root_covered
        self._learn_aliasing(epochs)
        self.refilter = self.early
        self._count += epochs.length
        stages = self._begun(contradicted, hold, clipped) if self._count >= self._next else None
        due = self._due is not None and self._count >= self._due
        if due:
            self._due = None
        return FitProgress(stages, due)

    def begin_history(self) -> None:
        """Fit no more what was measured until now: a line or a blow was in it, whose power would pass for the gust's.

        A line of 3 m/s^2 that ends in the middle of 20 s leaks more than the sensors' noise over 30 Hz to either side.
        A fit takes that for noise where it can, and else for the gust, whose corners set the slow bend.
        """
        self._history_from = self._count

    def abandon(self) -> None:
        """Give up the running fit."""
        self._due = None

    def _begun(self, contradicted: bool, hold: bool, clipped: bool) -> Stages[WingParameters] | None:
        """Stages of a fit of the history; None while held, or where too little of it is present."""
        elapsed_s = self._count * self._step_s
        self._next = round((np.floor(elapsed_s / _PERIOD_S + 1e-6) + 1.0) * _PERIOD_S / self._step_s)
        if hold:
            return None
        rows, present = self._corrected_history()
        newest = self._count - self._history_from
        since = max(self._last_gap(present), len(rows) - newest)
        if since and len(rows) - since < self._segment_epochs:
            return None
        if self._history_from and newest * self._step_s < _BEGUN_S and not (contradicted or self.early):
            return None
        tips = present[since:, :2].mean(axis=0) >= _MIN_PRESENT
        if not tips.any():
            return None
        self._due = self._count if self.refilter else self._count + round(SPREAD_S / self._step_s)
        single_tip = None if tips.all() else int(np.argmax(tips))
        estimates = (self.parameters, self._aliasing_noise, self._bend_per_g_m)
        inputs = FitInput(rows[since:], single_tip, elapsed_s, *estimates, contradicted, clipped)
        return self._filled_fit(inputs, present[since:])

    def _filled_fit(self, inputs: FitInput, present: Bools) -> Stages[WingParameters]:
        """Fit of a history whose gaps are filled first; ``present`` (n, 3)."""
        for column, sensor in _MEASURED:
            if _MIN_PRESENT <= present[:, sensor].mean() < 1.0:
                inputs.rows[:, column] = fill_gaps(inputs.rows[:, column], present[:, sensor])
                yield
        return (yield from self._fit.stages(inputs))

    def _last_gap(self, present: Bools) -> int:
        """Beginning of the newest segment with both tips, if one of them was absent for a while; 0 where neither was.

        What one tip alone says of both families is worth less than what both have said before.
        """
        both = present[:, 0] & present[:, 1]
        if both.mean() >= _NO_GAP or not both.any():
            return 0
        gap = _GAP_EPOCHS if present.mean(axis=0).min() >= _MIN_PRESENT else _LOSS_EPOCHS
        near = np.convolve(both, np.ones(gap), mode="same") > 0.5
        missing = np.flatnonzero(~near)
        return int(missing[-1]) + 1 + gap // 2 if len(missing) else 0

    def _corrected_history(self) -> tuple[Floats, Bools]:
        """Stored rows (n, COLUMNS), oldest first, corrected for bias, and presence of tips and root (n, 3)."""
        count = min(self._count, len(self._rows))
        first = (self._count - count) % len(self._rows)
        rows, present = _in_order(self._rows, first, count).copy(), _in_order(self._present, first, count)
        by_bias = (self._sensitivity[:count].reshape(2 * count, -1) @ self._bias_parameters).reshape(count, 2)
        rows[:, :2] -= _in_order(by_bias, first, count)
        rows[:, STATIC] *= self._bend_per_g_m
        return rows, present


def epoch_slope_rates(epochs: Epochs) -> Floats:
    """Rate of slope of both families by the roll rates of tips and root, (n, 2) rad/s; NaN where one is absent."""
    left, right, root = (epochs.rows[:, row] for row in (P_LEFT, P_RIGHT, P_ROOT))
    rates = np.empty((epochs.length, 2))
    rates[:, 0], rates[:, 1] = 0.5 * (left - right), root - 0.5 * (left + right)
    present = epochs.present[:, P_LEFT : P_ROOT + 1]
    if np.count_nonzero(present) < present.size:
        rates[~present.all(axis=1)] = np.nan
    return rates


def _mean(values: Floats) -> float:
    """Mean, at a third of the price of numpy's for a few numbers."""
    return float(np.add.reduce(values, axis=None)) / values.size


def _in_order(ring: _Ring, first: int, count: int) -> _Ring:
    """The ``count`` entries of a ring from ``first`` on; as they lie where possible."""
    return cast(_Ring, np.concatenate([ring[first:], ring[:first]]) if first else ring[:count])

"""Validity of the estimate, and the activity of the modes."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from companion.core.tracking.adaptation.spectral_fit import EARLY_S
from companion.core.tracking.bias_drift import BiasDrift
from companion.core.tracking.file_check import FILE_CHECK_S, FileCheck
from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.model import DiscreteWingModel, stationary
from companion.core.tracking.parameters import FREQUENCY, ModeParameters
from companion.core.tracking.states import StateLayout
from companion.native.library import ARRAY, INTEGER, kernel
from companion.records import Floats, Ints, Reject, Validity

_BLOCK_S = 1.0  # chosen: several periods of the slowest wing
_BLOCKS = 5  # chosen: their median outlives a gust of two seconds
_RECENT_S = 0.3  # chosen: three half periods of 5 Hz
_SETTLE_S = 2.0  # chosen: the filter's transient, ten periods at 5 Hz
# chosen, mean square rate of a mode over its variance given the sensors, 1 where nothing moves: below the first no mode
# is seen to move, above the second one is
_HIDDEN_RATIO, _SHOWN_RATIO = 3.0, 9.0
_MAX_FREQUENCY_SIGMA = 0.2  # chosen, relative: with a larger sigma it may be another mode
_MOST_REFUSED = 20  # chosen, of fits in a row, once a second: none of their history is that of the last that was taken
DISTRUST = {
    Validity.STALE: Reject.STALE,
    Validity.SETTLING: Reject.NOT_SETTLED,
    Validity.INCONSISTENT: Reject.CONTRADICTED,
}
"""Reason why nothing that rests on an estimate may be published, where there is one."""


class ModalActivity:
    """Root mean square vibration of both families' first modes: the median over blocks of the last seconds.

    The vibration is the rate of the deflection over the mode's circular frequency, which is the deflection itself where
    a mode oscillates. A step of the static bend, as at take-off, moves the deflection far, but slowly: no vibration.

    Attributes
    ----------
    settled_s : float
        Time since the tracker began, or since it was last without sensors.
    learned : bool
        The parameters have been learned, once: fits were taken, or nobody adapts them.
    adapts : bool
        Spectral fits are made.
    fitted : bool
        One was taken.
    file_check : FileCheck
        Constants against the airframe's file.
    deflection_sigmas : float
        Mean deflection of a family's first mode from its static bend over the last second, over the deflection's sigma
        in the gusts as fitted; the larger one. A vibration, however strong, has no mean.
    still : bool
        Neither family's first mode moves by more than the sensors leave unknown. The filter then follows their noise.
    """

    def __init__(self, layout: StateLayout, *, adapts: bool) -> None:
        self._rate_states = np.array([family.v for family in layout.families])
        self._deflections = np.array([family.q for family in layout.families])
        self._deflection_sigma_m: Floats = np.ones(2)
        self._slow_m: Floats = np.zeros(2)
        self.deflection_sigmas = 0.0
        self._model: DiscreteWingModel | None = None
        self._stiffness: Floats = np.ones(2)  # of its modes: circular frequencies squared
        self._blocks: deque[Floats] = deque(maxlen=_BLOCKS)
        self._sum, self._count = np.zeros(2), 0
        self._rms: Floats = np.zeros(2)
        self._recent: Floats = np.zeros(2)  # mean square
        self.settled_s = 0.0
        self.learned = self.fitted = self.still = False
        self.adapts = adapts
        self._refused = 0  # fits in a row
        self._layout, self._drift = layout, BiasDrift(layout)
        self.file_check = FileCheck()

    def _possible_sigma_m(self, kalman: SeparatedBiasFilter) -> Floats:
        """Sigma of the deflection by gusts and by constants that are not known, symmetric and antisymmetric, m.

        Constants that are only considered (a misalignment beside a tip that vibrates) move it by several of the gusts'.
        """
        sensitivity = kalman.state_and_sensitivity[self._deflections, 1:].copy()
        sensitivity[0] -= kalman.state_and_sensitivity[-1, 1:]
        by_constants = np.einsum("ij,jk,ik->i", sensitivity, kalman.bias_parameter_covariance, sensitivity)
        return np.asarray(np.sqrt(self._deflection_sigma_m**2 + by_constants))

    def update(self, kalman: SeparatedBiasFilter, count: int, step_s: float) -> None:
        """Take the newest ``count`` steps."""
        taken = min(count, kalman.history_length)
        if kalman.model is not self._model:
            omega = 2.0 * np.pi * np.array([mode.frequency_hz for mode in kalman.model.parameters])
            self._model, self._stiffness = kalman.model, omega**2
            variance = np.diag(stationary(kalman.layout, kalman.noise, kalman.model))
            self._deflection_sigma_m = np.sqrt(variance[self._deflections])
        deflection_m = kalman.state[self._deflections] - np.array([kalman.static_m, 0.0])
        self._slow_m = self._slow_m + min(count * step_s / _BLOCK_S, 1.0) * (deflection_m - self._slow_m)
        self.deflection_sigmas = float(np.abs(self._slow_m / self._possible_sigma_m(kalman)).max())
        squares = rate_squares(
            kalman.history.state, kalman.steps - taken, taken, self._rate_states, kalman.one_and_bias
        )
        self._recent = self._recent + min(count * step_s / _RECENT_S, 1.0) * (
            squares / (self._stiffness * max(taken, 1)) - self._recent
        )
        self._sum = self._sum + squares / self._stiffness
        self._count += taken
        self.settled_s += count * step_s
        if self.settled_s >= EARLY_S:  # before, the noise that biases are judged by is still learned
            self._drift.update(kalman)
        if self.settled_s >= EARLY_S - FILE_CHECK_S:
            self.file_check.update(kalman)
        self.learned |= self.settled_s >= EARLY_S and (self.fitted or not self.adapts)
        if not self._blocks:
            self._rms = np.sqrt(self._sum / self._count)
        if self._count * step_s >= _BLOCK_S:
            self._blocks.append(self._sum / self._count)
            self._sum, self._count = np.zeros(2), 0
            self._rms = np.sqrt(np.median(self._blocks, axis=0))
            self.still = self._stands_still(np.diag(kalman.covariance)[self._rate_states])

    def _stands_still(self, rate_variance: Floats) -> bool:
        """Whether the modes' rates are hidden behind what is unknown of them, (2,) (m/s)^2."""
        limit = _SHOWN_RATIO if self.still else _HIDDEN_RATIO
        return bool((self._rms**2 * self._stiffness < limit * rate_variance).all())

    def note_fit(self, *, taken: bool) -> bool:
        """Count a spectral fit that was taken or refused; True for the first that was taken."""
        first = taken and not self.fitted
        if first:  # a filter starts then, whose biases have nothing to do with those before
            self._drift = BiasDrift(self._layout)
        self.fitted |= taken
        self._refused = 0 if taken else self._refused + 1
        return first

    @property
    def reject(self) -> Reject | None:
        """Reason why what was learned is not to be trusted: new, never fitted, contradicted, drifting, off the file."""
        overdue = not self.learned and self.settled_s >= EARLY_S
        refused = self._refused >= _MOST_REFUSED or (overdue and self._refused)
        if refused or self._drift.too_fast or self.file_check.sentence is not None:
            return Reject.CONTRADICTED
        if overdue:
            return Reject.NOT_FITTED
        return None if self.learned else Reject.NOT_SETTLED

    @property
    def settled(self) -> bool:
        """Whether the filter's transient is over."""
        return self.settled_s >= _SETTLE_S

    def rms_m(self) -> Floats:
        """Root mean square vibration, symmetric and antisymmetric, m at the tip, (2,)."""
        return self._rms

    def recent_rms_m(self) -> Floats:
        """As :meth:`rms_m`, (2,), with an exponential memory of 0.3 s."""
        return np.sqrt(self._recent)


_squares = kernel("estimate_squares", ARRAY, INTEGER, INTEGER, ARRAY, ARRAY, ARRAY)


def rate_squares(states: Floats, first: int, count: int, rate_states: Ints, one_and_bias: Floats) -> Floats:
    """Sum of squares of both families' rates over ``count`` steps of the history from ``first`` on, (2,)."""
    squares = np.empty(len(rate_states))
    _squares(states, first, count, rate_states, one_and_bias, squares)
    return squares


def classify_validity(
    *,
    stale: bool,
    saturated: bool,
    settled: bool,
    contradicted: bool,
    rms_m: Floats,
    calm_rms_m: float,
    parameters: tuple[ModeParameters, ModeParameters],
    ambiguous: bool,
) -> Validity:
    """Validity of the estimate; the gravest reason wins. ``rms_m`` (2,) is the vibration of both families."""
    if stale:
        return Validity.STALE
    if contradicted:
        return Validity.INCONSISTENT
    if not settled:
        return Validity.SETTLING
    if saturated:  # a few clipped samples cost no trust: they may not hide what does
        return Validity.SATURATED
    symmetric_m, antisymmetric_m = rms_m.tolist()
    if math.sqrt(symmetric_m * symmetric_m + antisymmetric_m * antisymmetric_m) < calm_rms_m:
        return Validity.CALM
    strongest = parameters[int(antisymmetric_m > symmetric_m)]
    if ambiguous or strongest.log_sigma[FREQUENCY] > _MAX_FREQUENCY_SIGMA:
        return Validity.AMBIGUOUS
    return Validity.TRACKING

"""What the estimate may be used for, and how strong the motion is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.core.mode.kalman import Kalman
from companion.core.mode.layout import Layout
from companion.core.mode.parameters import FREQUENCY, ModeParameters
from companion.records import Floats, Validity

_MEMORY_S = 4.0
_SETTLE_S = 2.0
_VAGUE = 0.2  # relative sigma of the frequency beyond which it is not known which mode is followed


@dataclass(slots=True)
class Level:
    """Mean square of both modal coordinates about the static bend, over the last seconds.

    Attributes
    ----------
    mean_square : (2,) float64
    settled_s : float
        Time since the tracker began, or since it was last without sensors.
    """

    layout: Layout
    mean_square: Floats
    settled_s: float = 0.0

    def update(self, kalman: Kalman, count: int, step_s: float) -> None:
        """Take the newest ``count`` steps."""
        h = kalman.history
        slots = np.arange(kalman.steps - min(count, h.size), kalman.steps) % h.size
        weights = np.concatenate([[1.0], kalman.constants])
        q = h.state[slots][:, [family.q for family in self.layout.families]] @ weights
        q[:, 0] -= h.static_m[slots] @ weights
        self.settled_s += count * step_s
        share = 1.0 - np.exp(-count * step_s / min(_MEMORY_S, self.settled_s))
        self.mean_square = self.mean_square + share * ((q**2).mean(axis=0) - self.mean_square)

    def rms_m(self) -> Floats:
        """Root mean square, symmetric and antisymmetric."""
        rms: Floats = np.sqrt(self.mean_square)
        return rms


def judge(
    *,
    stale: bool,
    saturated: bool,
    settled_s: float,
    rms_m: Floats,
    calm_rms_m: float,
    parameters: tuple[ModeParameters, ModeParameters],
    ambiguous: bool,
) -> Validity:
    """Say what the estimate may be used for; the gravest reason wins."""
    if stale:
        return Validity.STALE
    if saturated:
        return Validity.SATURATED
    if settled_s < _SETTLE_S:
        return Validity.SETTLING
    if float(np.sqrt(np.sum(rms_m**2))) < calm_rms_m:
        return Validity.CALM
    strongest = parameters[int(np.argmax(rms_m))]
    if ambiguous or strongest.log_sigma[FREQUENCY] > _VAGUE:
        return Validity.AMBIGUOUS
    return Validity.TRACKING

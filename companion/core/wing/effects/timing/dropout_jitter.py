"""Samples that are missing or whose stamps wander."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.records import Floats, Station


@dataclass(frozen=True, slots=True)
class DropoutJitter(Effect):
    """Stamps wander by ``jitter_s`` rms; a share of samples is lost, and what stands for them is the sample before.

    Seen in the stamps themselves. A simulated stream holds the last value where a sample is lost.
    """

    name: ClassVar[str] = "dropout-jitter"
    group: ClassVar[Group] = Group.SENSING
    advice: ClassVar[str] = "stamp samples where they are taken; send batches; look at the link's loss counters"

    jitter_s: float = parameter("s", 0.001, "root mean square of what stamps wander")
    lost: float = parameter("", 0.02, "share of samples lost")

    def sample_time(self, station: Station, t_s: Floats) -> Floats:
        """Instants that wander, the same in every run."""
        if station is Station.ROOT or not (self.jitter_s or self.lost):
            return t_s
        shown = t_s + self.jitter_s * np.sqrt(12.0) * (_chance(t_s, 12.9898) - 0.5)
        gone = _chance(t_s, 78.233) < self.lost
        last = np.maximum.accumulate(np.where(gone, 0, np.arange(len(t_s))))
        return np.asarray(shown[last])


def _chance(t_s: Floats, seed: float) -> Floats:
    """Numbers between 0 and 1 that depend on the time alone."""
    return np.asarray(np.mod(43758.5453 * np.sin(seed * (1000.0 * t_s + 1.0)), 1.0))

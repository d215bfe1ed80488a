"""Samples that are missing or whose stamps wander."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.core.wing.samples import CERTAIN, SampleDefect
from companion.params.airframe import Sensor
from companion.records import Floats, Station

_LOST = 0.005  # share of samples
_LONGEST_LOSS = 10.0  # samples
_WANDERING = 0.15  # of a period


@dataclass(frozen=True, slots=True)
class DropoutJitter(Effect):
    """Stamps wander by ``jitter_s`` rms; a share of samples is lost, and what stands for them is the sample before.

    Seen in the stamps themselves. A simulated stream holds the last value where a sample is lost.
    """

    name: ClassVar[str] = "dropout-jitter"
    group: ClassVar[Group] = Group.SENSING
    in_samples: ClassVar[bool] = True
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

    @classmethod
    def sample_defect(cls, t_s: Floats, force_z_mps2: Floats, sensor: Sensor) -> SampleDefect | None:
        """Stamps that are missing, or wander about a steady rate."""
        del force_z_mps2, sensor
        steps = np.diff(t_s)
        period = float(np.median(steps))
        periods = np.maximum(np.round(steps / period), 1.0)
        single = periods <= _LONGEST_LOSS  # longer ones are gaps, which are told elsewhere
        lost = float(np.sum(periods[single] - 1.0) / np.sum(periods[single]))
        index = np.concatenate([[0.0], np.cumsum(periods)])
        line = np.polynomial.Polynomial.fit(index, t_s, 1)
        wanders = float(np.std(np.where(periods > 1, 0.0, steps - period))) / math.sqrt(2.0)
        if lost < _LOST and wanders < _WANDERING * period:
            return None
        jitter = min(float(np.std(t_s - line(index))), wanders)
        text = f"{100 * lost:.1f} % of samples missing, stamps wander {1e3 * jitter:.2f} ms about {1e3 * period:.2f} ms"
        count = len(steps)
        sigmas = {"jitter_s": jitter / math.sqrt(2.0 * count), "lost": math.sqrt(max(lost, 1.0 / count) / count)}
        return SampleDefect(cls.name, {"jitter_s": jitter, "lost": lost}, sigmas, text, CERTAIN)


def _chance(t_s: Floats, seed: float) -> Floats:
    """Numbers between 0 and 1 that depend on the time alone."""
    return np.asarray(np.mod(43758.5453 * np.sin(seed * (1000.0 * t_s + 1.0)), 1.0))

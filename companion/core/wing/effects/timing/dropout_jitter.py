"""Samples that are missing or whose stamps wander."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, parameter
from companion.core.wing.samples import CERTAIN, SampleDefect, evenly_stamped, smoothed_stamps
from companion.params.airframe import Sensor
from companion.records import Floats, Station

_LOST = 0.005  # chosen: share of samples: fewer leave a wing's motion whole
_LONGEST_LOSS = 10.0  # chosen: samples; a longer loss is a gap, which is told elsewhere
_WANDERING = 0.15  # chosen: of a period: a smaller jitter blurs no mode
_FINE = 0.8  # of all values are distinct where none is rounded (choice)
_SHARED = 0.1  # chosen: of the stamps: so many shared ones are a coarse clock, not lost samples
_COARSE = 0.2  # chosen: of the mean step: finer rounding of stamps turns no step into two
_ROUNDED = 0.66  # of rounding's standard deviation, up to which stamps that wander may be rounded alone (choice)
_MEAN_OF = 65  # chosen: stamps of the running mean: many beside jitter, few beside a clock's drift


@dataclass(frozen=True, slots=True)
class DropoutJitter(Effect):
    """Stamps wander by ``jitter_s`` rms; a share of samples is lost, and what stands for them is the sample before.

    Seen in the samples themselves. A simulated stream holds the last value where a sample is lost.
    """

    name: ClassVar[str] = "dropout-jitter"
    group: ClassVar[Group] = Group.SENSING
    in_samples: ClassVar[bool] = True
    advice: ClassVar[str] = "stamp samples where they are taken; send batches; look at the link's loss counters"

    jitter_s: float = parameter("s", 0.001, "root mean square of what stamps wander", above=0.0)
    lost: float = parameter("", 0.02, "share of samples lost", above=0.0)

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
        """Stamps that are missing, go back or wander about a steady rate, or values that stand for lost ones."""
        del sensor
        held = _held(force_z_mps2)
        if np.any(np.diff(t_s) <= 0.0):
            by_stamp = np.unique(t_s)
            if not evenly_stamped(by_stamp) or len(by_stamp) < (1.0 - _SHARED) * len(t_s):
                period, wanders = _about_the_mean(t_s)
                return cls._defect(t_s, period, wanders, held) if _is_defect(held, wanders, period) else None
            t_s = by_stamp  # rows that arrived in another order, or twice
        steps = np.diff(t_s)
        resolution = _resolution(steps)
        if resolution > _COARSE * float(np.mean(steps)):
            period, wanders = _about_the_mean(t_s, resolution)
            if wanders < _ROUNDED * resolution / math.sqrt(12.0):
                return cls._defect(t_s, period, wanders, held) if _is_defect(held, wanders, period) else None
        period = float(np.median(steps))
        periods = np.maximum(np.round(steps / period), 1.0)
        single = periods <= _LONGEST_LOSS  # longer ones are gaps, which are told elsewhere
        lost = float(np.sum(periods[single] - 1.0) / np.sum(periods[single]))
        index = np.concatenate([[0.0], np.cumsum(periods)])
        line = np.polynomial.Polynomial.fit(index, t_s, 1)
        wanders = float(np.std(np.where(periods > 1, 0.0, steps - period))) / math.sqrt(2.0)
        lost += (1.0 - lost) * held
        if not _is_defect(lost, wanders, period):
            return None
        return cls._defect(t_s, period, min(float(np.std(t_s - line(index))), wanders), lost)

    @classmethod
    def _defect(cls, t_s: Floats, period_s: float, jitter_s: float, lost: float) -> SampleDefect:
        wander = f"stamps wander {1e3 * jitter_s:.2f} ms about {1e3 * period_s:.2f} ms"
        text = f"{100 * lost:.1f} % of samples missing, {wander}"
        count = len(t_s) - 1
        sigmas = {"jitter_s": jitter_s / math.sqrt(2.0 * count), "lost": math.sqrt(max(lost, 1.0 / count) / count)}
        return SampleDefect(cls.name, {"jitter_s": jitter_s, "lost": lost}, sigmas, text, CERTAIN)


def _is_defect(lost: float, wanders_s: float, period_s: float) -> bool:
    return lost >= _LOST or wanders_s >= _WANDERING * period_s


def _held(values: Floats) -> float:
    """Share of samples that repeat the one before to the last digit, of values so fine that none does by chance.

    At either end of the values a sample may repeat because it is clipped.
    """
    clear = (values > np.min(values)) & (values < np.max(values))
    fine = len(np.unique(values[clear])) > _FINE * np.count_nonzero(clear)
    return float(np.mean((np.diff(values) == 0.0)[clear[1:]])) if fine and clear[1:].any() else 0.0


def _resolution(steps_s: Floats) -> float:
    """How finely stamps are written, by the smallest difference of two of their steps; 0 where all are the same."""
    sizes = np.unique(np.round(steps_s, 9))
    return float(np.min(np.diff(sizes))) if len(sizes) > 1 else 0.0


def _about_the_mean(t_s: Floats, resolution_s: float = 0.0) -> tuple[float, float]:
    """Usual step, and how far stamps in the order of their rows lie about their running mean beyond their rounding."""
    period = float(np.median(t_s[_MEAN_OF:] - t_s[:-_MEAN_OF])) / _MEAN_OF if len(t_s) > _MEAN_OF else math.inf
    off = t_s - smoothed_stamps(t_s, _MEAN_OF)
    usual = np.abs(off) < _LONGEST_LOSS * period  # about a gap the mean lies elsewhere
    distinct = np.unique(t_s)
    coarse = len(distinct) < (1.0 - _SHARED) * len(t_s)
    rounding = float(np.median(np.diff(distinct))) ** 2 / 12.0 if coarse and len(distinct) > 1 else 0.0
    rounding = max(rounding, resolution_s**2 / 12.0)
    return period, math.sqrt(max(float(np.mean(off[usual] ** 2)) - rounding, 0.0)) if usual.any() else 0.0


def _chance(t_s: Floats, seed: float) -> Floats:
    """Numbers between 0 and 1 that depend on the time alone."""
    return np.asarray(np.mod(43758.5453 * np.sin(seed * (1000.0 * t_s + 1.0)), 1.0))

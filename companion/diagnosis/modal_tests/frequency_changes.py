"""Frequencies that changed from run to run, and which channels returned to a value with them.

A channel set once per run (a sensor's position, a temperature) is separable from run order only where a value was left
and came back: then runs of equal value must agree if it is the cause, whenever they were made. A channel none of whose
values came back, or all at one frequency, goes hand in hand with run order, whatever its numbers are.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from companion.diagnosis.modal_tests.vibration import ModeOverRuns
from companion.records import Bools, Floats

CHANGED_Z = 5.0
"""Standard deviations of one run's frequency from which a change is no chance (choice)."""
NOTABLE_CHANGE = 0.002
"""Relative change (convention) below which a mode is shown, but no cause is asked."""
ORDER = "run_order"
_SAME = 0.02  # of a channel's range, within which values count as equal (choice)
_LOG_SMALLEST = -600.0  # exponents below underflow (numerical)
_LEAST_Z = -38.0  # numerical: of a tail that differs from 1 by less than a double can


@dataclass(frozen=True, slots=True)
class Channel:
    """One thing set per run.

    Attributes
    ----------
    levels : tuple of int
        Number of the distinct value that each run has, (runs,).
    agree_z : float or None
        Distance of the frequencies of equal levels from agreement; None where no values came back that saw a change.
    """

    name: str
    levels: tuple[int, ...]
    agree_z: float | None

    @property
    def came_back(self) -> bool:
        """Whether values were left and returned to, and not all of them at one frequency."""
        return self.agree_z is not None


@dataclass(frozen=True, slots=True)
class ChangedMode:
    """A mode whose frequency changed.

    Attributes
    ----------
    mode : ModeOverRuns
    first, last : int
        The last run of the steady beginning, and the run that differs most from it.
    channels : tuple of Channel
    """

    mode: ModeOverRuns
    first: int
    last: int
    channels: tuple[Channel, ...]

    @property
    def change_hz(self) -> float:
        """Change from the steady beginning to the run that differs most."""
        f_hz = self.mode.frequency_hz
        return float(f_hz[self.last] - f_hz[self.first])

    def causes(self) -> list[Channel]:
        """Channels whose values came back, and the frequency with them."""
        return [entry for entry in self.channels if entry.agree_z is not None and entry.agree_z < CHANGED_Z]

    def confounded(self) -> list[str]:
        """Channels that go hand in hand with run order."""
        return [channel.name for channel in self.channels if not channel.came_back]


def changed_modes(modes: Sequence[ModeOverRuns], constants: Sequence[Mapping[str, float]]) -> list[ChangedMode]:
    """Modes whose frequency changed, the largest relative change first; ``constants`` are the channels of each run."""
    changed = [_changed(mode, constants) for mode in modes if has_changed(mode)]
    return sorted(changed, key=lambda entry: -abs(entry.change_hz) / entry.mode.near_hz)


def has_changed(mode: ModeOverRuns) -> bool:
    """Whether a frequency changed by more than chance, and by enough to matter."""
    z = disagreement(mode.frequency_hz, mode.sigma_hz)
    return z >= CHANGED_Z and float(np.ptp(mode.frequency_hz)) >= NOTABLE_CHANGE * mode.near_hz


def disagreement(values: Floats, sigmas: Floats) -> float:
    """Distance of values (n,) with these sigmas from one common value, as a standard normal (one-sided)."""
    if len(values) < 2:
        return 0.0
    weight = 1.0 / sigmas**2
    deviation = float(np.sum(weight * (values - np.sum(weight * values) / weight.sum()) ** 2))
    tail = float(chi2.logsf(deviation, len(values) - 1))
    if tail > _LOG_SMALLEST:
        return max(float(norm.isf(math.exp(tail))), _LEAST_Z)
    return math.sqrt(-2.0 * tail) if math.isfinite(tail) else math.sqrt(deviation)


def disagreement_within(mode: ModeOverRuns, levels: Sequence[int]) -> float:
    """Largest disagreement among runs of equal level."""
    groups = [np.flatnonzero(np.array(levels) == level) for level in sorted(set(levels))]
    return max(disagreement(mode.frequency_hz[group], mode.sigma_hz[group]) for group in groups)


def _changed(mode: ModeOverRuns, constants: Sequence[Mapping[str, float]]) -> ChangedMode:
    f_hz = mode.frequency_hz
    first = _end_of_steady(f_hz, mode.sigma_hz)
    last = int(np.argmax(np.abs(f_hz - f_hz[: first + 1].mean())))
    every = [name for name in constants[0] if name != ORDER and all(name in run for run in constants)]
    names = [name for name in every if len({run[name] for run in constants}) > 1]
    channels = tuple(_channel(name, [float(run[name]) for run in constants], mode) for name in names)
    return ChangedMode(mode, first, last, channels)


def _end_of_steady(f_hz: Floats, sigma: Floats) -> int:
    """The last run that agrees with all before it."""
    end = 0
    for k in range(1, len(f_hz)):
        if disagreement(f_hz[: k + 1], sigma[: k + 1]) > CHANGED_Z:
            break
        end = k
    return end


def _channel(name: str, values: Sequence[float], mode: ModeOverRuns) -> Channel:
    levels = _levels(values)
    again = np.flatnonzero(_came_back(levels))
    # values that came back within the unchanged part say nothing of the change
    distinguishable = disagreement(mode.frequency_hz[again], mode.sigma_hz[again]) >= CHANGED_Z
    return Channel(name, levels, disagreement_within(mode, levels) if distinguishable else None)


def _levels(values: Sequence[float]) -> tuple[int, ...]:
    """Number the distinct values of a channel, in rising order."""
    order = np.argsort(values)
    steps = np.diff(np.array(values)[order]) > _SAME * float(np.ptp(values))
    levels = np.empty(len(values), dtype=np.int64)
    levels[order] = np.concatenate([[0], np.cumsum(steps)])
    return tuple(levels.tolist())


def _came_back(levels: Sequence[int]) -> Bools:
    """Which runs have a value that was left and taken again, (runs,)."""
    segments = [level for level, _ in itertools.groupby(levels)]
    return np.array([segments.count(level) > 1 for level in levels])

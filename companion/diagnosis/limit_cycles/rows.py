"""Observations of a vibration as the laws are fitted to them: limit cycles, and windows on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.diagnosis.limit_cycles.tracks import VibrationTrack

LIMIT_CYCLE = "limit-cycle"
"""Name of a self-excited cycle; it is no effect of the catalogue, which has stable wings only."""
_TWO_PI = 2.0 * np.pi  # by definition: radians of a turn


@dataclass(frozen=True, slots=True)
class Row:
    """One observation: a limit cycle's mean, or a window on the way to or from it."""

    recording: int
    airspeed_mps: float
    amplitude: tuple[float, ...]
    frequency_hz: float
    damping: float
    cycle: bool
    t_s: float = 0.0


def rows_of(number: int, entry: VibrationTrack) -> list[Row]:
    """A limit cycle counts once, however long it lasted; windows on the way one by one."""
    speed = entry.airspeed_mps or 0.0
    levels = np.stack(list(entry.amplitude.values()), 1)
    damping = -entry.growth_radps / (_TWO_PI * entry.frequency_hz)
    rows = [
        Row(
            number,
            speed,
            tuple(levels[k].tolist()),
            float(entry.frequency_hz[k]),
            float(damping[k]),
            False,
            float(entry.t_s[k]),
        )
        for k in np.flatnonzero(~entry.steady)
    ]
    if entry.steady.any():
        mean = np.median(levels[entry.steady], axis=0)
        f_hz, zeta = (float(np.median(values[entry.steady])) for values in (entry.frequency_hz, damping))
        rows.append(Row(number, speed, tuple(mean.tolist()), f_hz, zeta, True))
    return rows

"""Rows of a forced oscillator on an even grid: few lost or wild samples are splined, long gaps marked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from companion.diagnosis.channel_defects import is_clipped, wild_samples
from companion.errors import RecordingError
from companion.records import Bools, Floats

_LOST = 1.6  # usual steps, from which a row is missing (choice)
_EVEN = 0.05  # chosen, usual steps, median: stamps that wander by more make a long step of no loss
_ONE_LOST, _TWO_LOST = 2.5, 3.5  # usual steps, from which a step is a gap (by definition)
_SLOW = 0.125  # chosen, periods of the band's top in a row: a spline follows slower motion across two lost rows
_MOST_LOST = 2.0  # rows of the even grid over those that came, at most (choice)
_STRUCK = 0.5  # of the force's square, from which single samples are blows of a hammer and not wild (choice)
_CROWDED = 0.2  # of the usual step: a spline through stamps so close together would swing (choice)


@dataclass(frozen=True, slots=True)
class EvenRecording:
    """``force``, ``response`` and ``lost`` (within a long gap), (n,), at one rate; ``notes`` are sentences."""

    rate_hz: float
    force: Floats
    response: Floats
    lost: Bools
    notes: tuple[str, ...]


def evenly(name: str, t_s: Floats, force: Floats, response: Floats, top_hz: float) -> EvenRecording:
    """Put rows (n,) of motion up to a frequency on an even grid with a sample for each that was lost.

    Raises
    ------
    RecordingError
        Most rows are lost.
    """
    step = np.diff(t_s)
    usual_s = float(np.median(step))
    ratio, gap = step / usual_s, _TWO_LOST if top_hz * usual_s < _SLOW else _ONE_LOST
    wander = float(np.median(np.abs(ratio - 1.0)))
    missing = ratio > (_TWO_LOST if wander > _EVEN else _LOST)
    count = len(t_s) + int(np.sum(np.rint(ratio[missing]) - 1.0))
    if count > _MOST_LOST * len(t_s):
        raise RecordingError(f"{name}: of {count} rows at the usual rate {len(t_s)} are there: record without losses")
    even_s = np.linspace(t_s[0], t_s[-1], count)
    gaps = np.flatnonzero(missing & (ratio > gap))
    lost = np.zeros(count, dtype=np.bool_)
    for k in gaps:
        lost |= (even_s > t_s[k]) & (even_s < t_s[k + 1])
    channels = {"force": force, "response": response}
    wild = {channel: wild_samples(values) for channel, values in channels.items()}
    if np.sum(force[wild["force"]] ** 2) > _STRUCK * np.sum(force**2):
        wild["force"] = np.zeros_like(wild["force"])
    gone, notes = int(np.count_nonzero(missing & (ratio <= gap))), []
    if wander > _EVEN:
        text = f"stamps wander by {100.0 * wander:.0f} % of a row, and are taken as they are"
        notes.append(f"{name}: {text}: if the samples are even, give them even stamps, or the law comes out wrong")
    if gone:
        notes.append(f"{name}: rows are lost at {gone} places, which splines bridge")
    counts = {channel: int(np.count_nonzero(each)) for channel, each in wild.items()}
    notes += [
        f"{name}: {count} wild samples of the {channel} are left out" for channel, count in counts.items() if count
    ]
    if gaps.size:
        longest_s = float(step[gaps].max())
        notes.append(f"{name}: {gaps.size} gaps, the longest {longest_s:.3g} s: segments with a gap are left out")
    if is_clipped(response):
        text = "the response piles up at its largest or smallest value: it is clipped, which looks like a law"
        notes.append(f"{name}: {text}")
    straight = lost | bool(ratio.min() < _CROWDED)
    even_force, even_response = (
        np.where(straight, np.interp(even_s, at_s, each), CubicSpline(at_s, each)(even_s))
        for at_s, each in ((t_s[~wild[channel]], values[~wild[channel]]) for channel, values in channels.items())
    )
    return EvenRecording((count - 1) / float(t_s[-1] - t_s[0]), even_force, even_response, lost, tuple(notes))

"""Rows of a forced oscillator on an even grid: few lost or wild samples are splined, long gaps marked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from companion.diagnosis.channel_defects import CLIPPED, is_clipped, wild_samples
from companion.errors import RecordingError
from companion.records import Bools, Floats, Ints

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
    steps = row_steps(t_s, top_hz)
    if steps.rows > _MOST_LOST * len(t_s):
        raise RecordingError(
            f"{name}: of {steps.rows} rows at the usual rate {len(t_s)} are there: record without losses"
        )
    even_s = np.linspace(t_s[0], t_s[-1], steps.rows)
    lost = np.zeros(steps.rows, dtype=np.bool_)
    for k in steps.gaps:
        lost |= (even_s > t_s[k]) & (even_s < t_s[k + 1])
    channels = {"force": force, "response": response}
    wild = {channel: wild_samples(values) for channel, values in channels.items()}
    if np.sum(force[wild["force"]] ** 2) > _STRUCK * np.sum(force**2):
        wild["force"] = np.zeros_like(wild["force"])
    even_force, even_response = (
        np.where(lost | steps.crowded, np.interp(even_s, at_s, each), CubicSpline(at_s, each)(even_s))
        for at_s, each in ((t_s[~wild[channel]], values[~wild[channel]]) for channel, values in channels.items())
    )
    notes = _notes(steps, {channel: int(np.count_nonzero(each)) for channel, each in wild.items()})
    if is_clipped(response):
        notes.append(f"the response {CLIPPED}, which looks like a law")
    rate_hz = (steps.rows - 1) / float(t_s[-1] - t_s[0])
    return EvenRecording(rate_hz, even_force, even_response, lost, tuple(f"{name}: {note}" for note in notes))


class RowSteps(NamedTuple):
    """Steps between stamps: rows of the even grid, places that a spline bridges, and steps that are gaps.

    ``longest_s`` is the longest gap, ``wander`` how far stamps wander, in usual steps. ``crowded`` says that some
    stamps are too close for a spline.
    """

    rows: int
    splined: int
    gaps: Ints
    longest_s: float
    wander: float
    crowded: bool


def row_steps(t_s: Floats, top_hz: float) -> RowSteps:
    """Judge the steps between stamps (n,) of motion up to a frequency."""
    step_s = np.diff(t_s)
    usual_s = float(np.median(step_s))
    ratio, gap = step_s / usual_s, _TWO_LOST if top_hz * usual_s < _SLOW else _ONE_LOST
    wander = float(np.median(np.abs(ratio - 1.0)))
    missing = ratio > (_TWO_LOST if wander > _EVEN else _LOST)
    rows = len(t_s) + int(np.sum(np.rint(ratio[missing]) - 1.0))
    gaps = np.flatnonzero(missing & (ratio > gap))
    splined = int(np.count_nonzero(missing & (ratio <= gap)))
    return RowSteps(rows, splined, gaps, float(step_s[gaps].max(initial=0.0)), wander, bool(ratio.min() < _CROWDED))


def _notes(steps: RowSteps, wild: Mapping[str, int]) -> list[str]:
    """Stamps that wander, rows that are lost, and how many samples of each channel are wild, in sentences."""
    notes = []
    if steps.wander > _EVEN:
        text = f"stamps wander by {100.0 * steps.wander:.0f} % of a row, and are taken as they are"
        notes.append(f"{text}: if the samples are even, give them even stamps, or the law comes out wrong")
    if steps.splined:
        notes.append(f"rows are lost at {steps.splined} places, which splines bridge")
    notes += [f"{count} wild samples of the {channel} are left out" for channel, count in wild.items() if count]
    if steps.gaps.size:
        longest = f"the longest {steps.longest_s:.3g} s"
        notes.append(f"{steps.gaps.size} gaps, {longest}: segments with a gap are left out")
    return notes

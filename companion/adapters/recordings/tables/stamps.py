"""Undoes the rounding of a table's time stamps: even samples whose stamps were written to whole milliseconds, say.

Such stamps step unevenly although nothing was lost and nothing jittered, which diagnosis would otherwise have to name.
"""

from __future__ import annotations

import numpy as np

from companion.records import Floats

_LATTICES_S = (0.1, 0.01, 0.001, 1e-4, 1e-5)  # convention: programs round times to whole decimals
_ON_LATTICE = 1e-3  # of the lattice: what decimal fractions and sums of them are off (choice)
_HARMLESS = 0.02  # of a period: finer rounding is left alone (choice)
_FIRST = 32  # samples that are put on a line first (choice)
_GROWTH = 4  # then a quarter more to each side: a line through a few rounded stamps reaches no further (choice)
_SLACK = 1.5  # of the lattice: rounding alone spans 1, a line through few stamps somewhat more (choice)
_HOLE = 2.5  # chosen: usual steps: one sample may be lost, two may not


def without_rounding(t_s: Floats) -> tuple[Floats, str]:
    """Put rounded stamps back onto the even grid that they were rounded from.

    Parameters
    ----------
    t_s : (n,)
        Stamps; those that do not increase are given back.

    Returns
    -------
    t_s : (n,)
        Evenly spaced between holes where the given stamps are nothing but rounded; else as given. Whether they were
        cut or rounded cannot be known: they are taken at their mean.
    note : str
        What was done, "" for nothing.
    """
    if len(t_s) < _FIRST or np.any(np.diff(t_s) <= 0.0):
        return t_s, ""
    lattice_s = _lattice(t_s)
    if lattice_s == 0.0:
        return t_s, ""
    usual_s = float(np.median(t_s[_FIRST - 1 :] - t_s[: len(t_s) - _FIRST + 1])) / (_FIRST - 1)
    holes = np.flatnonzero(np.diff(t_s) > max(_HOLE * usual_s, usual_s + 2.0 * lattice_s))
    if lattice_s < _HARMLESS * usual_s:
        return t_s, ""
    segments = [_even(segment, lattice_s) for segment in np.split(t_s, holes + 1)]
    if any(segment is None for segment in segments):
        return t_s, ""
    even = np.concatenate([segment for segment in segments if segment is not None])
    if np.allclose(even, t_s, rtol=0.0, atol=_HARMLESS * usual_s):  # a rate that the lattice holds exactly
        return t_s, ""
    steps = np.diff(even)
    text = f"stamps are rounded to {1e3 * lattice_s:g} ms; taken as even steps of {1e3 * np.median(steps):.4g} ms"
    return even, text


def _lattice(t_s: Floats) -> float:
    """The coarsest power of ten of which all stamps are multiples; 0 for none."""
    for lattice_s in _LATTICES_S:
        places = (t_s - np.floor(t_s[0])) / lattice_s
        if np.all(np.abs(places - np.round(places)) < _ON_LATTICE):
            return lattice_s
    return 0.0


def _even(t_s: Floats, lattice_s: float) -> Floats | None:
    """The line that stamps of one segment lie on to within their rounding, single samples may be missing; None if none.

    It begins where the stamps are densest, which is where none is missing, and grows to both sides: by each fit the
    next stamps are counted.
    """
    if len(t_s) < _FIRST:
        return t_s
    since_s = t_s - t_s[0]
    first = int(np.argmin(since_s[_FIRST - 1 :] - since_s[: len(t_s) - _FIRST + 1]))
    last = first + _FIRST
    index = np.arange(_FIRST, dtype=np.float64)
    while True:
        slope, start = np.polyfit(index, since_s[first:last], 1)
        complete = last - first == len(t_s)
        further = (last - first) // _GROWTH
        first, last = max(first - further, 0), min(last + further, len(t_s))
        index = np.rint((since_s[first:last] - start) / slope)
        if np.any(np.diff(index) < 1.0):
            return None
        if complete:
            break
    line = start + slope * index
    return np.asarray(t_s[0] + line) if np.ptp(since_s - line) < _SLACK * lattice_s else None

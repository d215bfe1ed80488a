"""Finds stamps of a log that damage has put far ahead: one that is followed takes the rest of the log with it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from companion.records import Bools, Ints

_AHEAD_US = 1_000_000  # chosen: as on a link (adapters/mavlink/vehicle/clock_reset_detector.py)
_FOLLOWING = 8  # messages that a stamp is held against: damage is rarely that of five in a row (choice)
_LONG_US = 10_000_000  # chosen: the end of a log of slow messages has gaps of some seconds
_LARGEST_US = 1 << 53  # 285 years; larger ones would overflow in nanoseconds (choice)


def as_stamps(t_us: NDArray[np.uint64]) -> Ints:
    """Unsigned stamps (n,) as signed ones; what is no time at all is far ahead."""
    stamps_us: Ints = np.minimum(t_us, _LARGEST_US).astype(np.int64)
    return stamps_us


def ahead_of_messages(sample_us: NDArray[np.uint64], message_us: NDArray[np.uint64]) -> Bools:
    """Which samples (n,) are said to be of more than 1 s after the messages that bring them."""
    return np.asarray(as_stamps(sample_us) > as_stamps(message_us) + _AHEAD_US)


def ahead_of_neighbours(t_us: Ints) -> Bools:
    """Which stamps (n,), in the order of the log, are more than 1 s ahead of most of the eight that follow.

    Behind a gap the stamps stay ahead, so none is, nor is the last of all: see :func:`ahead_of_end`.
    """
    ahead = np.zeros(t_us.size, dtype=np.bool_)
    for last in np.flatnonzero(t_us[:-1] - t_us[1:] > _AHEAD_US).tolist():
        first, usual_us = max(last + 1 - _FOLLOWING, 0), np.median(t_us[last + 1 : last + 1 + _FOLLOWING])
        ahead[first : last + 1] |= t_us[first : last + 1] > usual_us + _AHEAD_US
    return ahead


def ahead_of_end(t_us: Ints) -> Bools:
    """Which of a log's eight newest stamps (n,) lie behind a gap of more than 10 s: nothing follows that tells them."""
    if t_us.size <= _FOLLOWING:
        return np.zeros(t_us.size, dtype=np.bool_)
    newest_us = np.sort(t_us)[-1 - _FOLLOWING :]
    gaps = np.flatnonzero(np.diff(newest_us) > _LONG_US)
    return np.asarray(t_us > newest_us[gaps[0]]) if gaps.size else np.zeros(t_us.size, dtype=np.bool_)

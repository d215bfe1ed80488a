"""Whether a run may be judged: how well the machine let physics, autopilot and service keep the pace that was asked.

The physics waits for nobody's processor but its own and the autopilot's; where they or the service are held up, what
comes late is the machine's and not the code's. Such a run is skipped by name, with the figures and the load.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest

from companion.records import Floats, Ints
from sitl_tests.ardupilot.rail import RATE_HZ

_FRAME_LATE_MS = 10.0
"""A command that could not be given within 10 ms is not given (the planner's expiry)."""
_FRAMES_ASKED = 0.98
"""Share of frames on time: 95 % of the shots have to reach the servo in time, over several frames each."""
_TICK_LATE_NS = 20_000_000
"""The service's own limit (service/pace.py): of ticks asked every 10 ms."""
_TICKS_ASKED = 0.95
"""Share of the time in which the service's ticks come within that."""
_LONGEST_NS = 500_000_000
"""After half a second without a message the autopilot takes its rangefinder for dead."""


@dataclass(frozen=True, slots=True)
class Pace:
    """Pace that was achieved: shares on time, and the longest time without a frame or a tick."""

    frames: float
    ticks: float
    longest_ns: int
    load: float

    @property
    def can_be_judged(self) -> bool:
        """Whether what came late is the code's."""
        return self.frames >= _FRAMES_ASKED and self.ticks >= _TICKS_ASKED and self.longest_ns < _LONGEST_NS

    @property
    def sentence(self) -> str:
        """Why it cannot be judged."""
        return (
            f"this machine was too busy to judge a flight: {100 * self.frames:.0f} % of the physics' frames "
            f"within {_FRAME_LATE_MS:.0f} ms ({100 * _FRAMES_ASKED:.0f} asked), the service's ticks on time in "
            f"{100 * self.ticks:.0f} % of it ({100 * _TICKS_ASKED:.0f} asked), longest stall "
            f"{1e-6 * self.longest_ns:.0f} ms ({1e-6 * _LONGEST_NS:.0f} allowed), load {self.load:.1f}"
        )


def measured(sent_ns: Ints, tick_ns: Ints, from_ns: int, to_ns: int, load: float) -> Pace:
    """The pace between two host times.

    Parameters
    ----------
    sent_ns
        When each frame was sent, from the first of the run; frames are asked every 1/1200 s.
    tick_ns
        When the service ticked.
    load
        The machine's, over a minute.
    """
    due_ns = sent_ns[0] + np.arange(len(sent_ns)) * (1e9 / RATE_HZ)
    inside = (sent_ns >= from_ns) & (sent_ns <= to_ns)
    # the clock was pinned while the autopilot started: what counts is how far a frame lags behind the most punctual
    late_ms: Floats = (sent_ns[inside] - due_ns[inside]) * 1e-6
    late_ms = late_ms - np.min(late_ms, initial=np.inf)
    frames = float(np.mean(late_ms <= _FRAME_LATE_MS)) if len(late_ms) else 0.0
    gaps_ns = _gaps_ns(tick_ns, from_ns, to_ns)
    ticks = float(gaps_ns[gaps_ns <= _TICK_LATE_NS].sum() / (to_ns - from_ns))
    longest_ns = int(max(gaps_ns.max(), _gaps_ns(sent_ns, from_ns, to_ns).max()))
    return Pace(frames, ticks, longest_ns, load)


def _gaps_ns(at_ns: Ints, from_ns: int, to_ns: int) -> Ints:
    inside = at_ns[(at_ns >= from_ns) & (at_ns <= to_ns)]
    return np.diff(np.concatenate([[from_ns], inside, [to_ns]]))


def skip_if_busy(sent_ns: Sequence[int], tick_ns: Sequence[int], from_ns: int, to_ns: int) -> None:
    """Skip the test, by name, where the run between two host times cannot be judged."""
    stamps = (np.array(stamps, dtype=np.int64) for stamps in (sent_ns, tick_ns))
    pace = measured(*stamps, from_ns, to_ns, os.getloadavg()[0])
    if not pace.can_be_judged:
        pytest.skip(pace.sentence)

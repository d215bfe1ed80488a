"""Trigger latency from a recording: from the fired instant to the start of the exposure that it opened."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from companion.core.trigger.latency import to_middle_s
from companion.errors import RecordingError
from companion.params.airframe import Camera
from companion.records import ClockName, Floats, MatchSet, Record, Shot
from companion.units import MAD_TO_SIGMA

_LEAST_SHOTS = 10  # for a spread known to a quarter (choice)
_LONGEST_S = 0.2  # a longer one was not that shot (choice)


@dataclass(frozen=True, slots=True)
class Latency:
    """Latency to the start of each camera's exposure: left, right.

    All (2,): ``sigma_s`` is robust (from the median deviation), ``p99_s`` the 99th percentile of the latency itself.
    """

    median_s: Floats
    sigma_s: Floats
    p99_s: Floats
    shots: int


def trigger_latency(records: Iterable[Record], cameras: tuple[Camera, Camera]) -> Latency:
    """Pair shots with exposures, by plan where the cameras know it, else by time.

    ``cameras`` are the left and the right one of the airframe that recorded: the stamps are of the middle of the middle
    row's exposure, and the latency is to the start of the first row's, as the flight's latency model has it.

    Raises
    ------
    RecordingError
        Fewer than ten shots have an exposure within 0.2 s on the host's clock.
    """
    to_middle_ns = np.array([round(to_middle_s(camera) * 1e9) for camera in cameras], dtype=np.int64)
    fired: dict[int, int] = {}
    late: list[tuple[float, float]] = []
    for record in records:
        if isinstance(record, Shot):
            fired[record.plan_id] = record.fired_host_ns
        elif isinstance(record, MatchSet) and record.clocks == (ClockName.HOST, ClockName.HOST):
            start_ns = record.mid_exposure_ns - to_middle_ns
            fired_ns = fired.get(record.plan_id, _before(fired, int(start_ns.min())))
            if fired_ns is not None and 0 <= int(start_ns.min()) - fired_ns <= _LONGEST_S * 1e9:
                late.append((1e-9 * (int(start_ns[0]) - fired_ns), 1e-9 * (int(start_ns[1]) - fired_ns)))
    if len(late) < _LEAST_SHOTS:
        raise RecordingError(f"only {len(late)} shots have an exposure on the host clock; {_LEAST_SHOTS} are needed")
    seconds = np.array(late)
    median = np.median(seconds, axis=0)
    sigma = MAD_TO_SIGMA * np.median(np.abs(seconds - median), axis=0)
    return Latency(median, sigma, np.percentile(seconds, 99, axis=0), len(late))


def _before(fired: dict[int, int], start_ns: int) -> int | None:
    """The latest shot before an exposure."""
    return max((at for at in fired.values() if at <= start_ns), default=None)

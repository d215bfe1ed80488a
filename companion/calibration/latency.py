"""Trigger latency from a recording: from the fired instant to the start of the exposure that it opened."""

from __future__ import annotations

import bisect
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from companion.core.trigger.latency import to_middle_s
from companion.errors import RecordingError
from companion.params.airframe import Camera
from companion.records import ClockName, Floats, Ints, MatchSet, Record, Shot
from companion.units import MAD_TO_SIGMA

_LEAST_SHOTS = 10  # for a spread known to a quarter (choice)
_LONGEST_S = 0.2  # a longer one was not that shot (choice)
_LEAST_SIGMA_S = 5e-5  # resolution of stamps, as in flight (choice)
_COARSEST_NS = 4_000_000  # chosen: step of stamps that count a kernel's ticks, at 250 Hz


@dataclass(frozen=True, slots=True)
class Latency:
    """Latency to the start of each camera's exposure: left, right.

    All (2,): ``sigma_s`` is robust (from the median deviation), and no less than what the step of the stamps leaves;
    ``p99_s`` is the 99th percentile of the latency itself. ``ambiguous_s`` is the shortest time between two shots,
    where exposures were paired by time and the latency may be longer by that; else None.
    """

    median_s: Floats
    sigma_s: Floats
    p99_s: Floats
    shots: int
    ambiguous_s: float | None = None


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
    in_order: list[int] = []
    by_time = False
    stamps: list[Ints] = []
    late: list[tuple[float, float]] = []
    for record in records:
        if isinstance(record, Shot):
            fired[record.plan_id] = record.fired_host_ns
            bisect.insort(in_order, record.fired_host_ns)
        elif isinstance(record, MatchSet) and record.clocks == (ClockName.HOST, ClockName.HOST):
            start_ns = record.mid_exposure_ns - to_middle_ns
            fired_ns = fired.get(record.plan_id)
            if fired_ns is None:
                fired_ns = _before(in_order, int(start_ns.min()))
            if fired_ns is not None and 0 <= int(start_ns.min()) - fired_ns <= _LONGEST_S * 1e9:
                by_time |= record.plan_id not in fired
                stamps.append(record.mid_exposure_ns)
                late.append((1e-9 * (int(start_ns[0]) - fired_ns), 1e-9 * (int(start_ns[1]) - fired_ns)))
    if len(late) < _LEAST_SHOTS:
        raise RecordingError(f"only {len(late)} shots have an exposure on the host clock; {_LEAST_SHOTS} are needed")
    seconds = np.array(late)
    median = np.median(seconds, axis=0)
    sigma = MAD_TO_SIGMA * np.median(np.abs(seconds - median), axis=0)
    sigma = np.maximum(np.maximum(sigma, _step_s(np.array(stamps)) / np.sqrt(12.0)), _LEAST_SIGMA_S)
    period_s = 1e-9 * float(np.diff(np.sort([*fired.values()])).min(initial=2**62))
    ambiguous_s = period_s if by_time and period_s < _LONGEST_S else None
    return Latency(median, sigma, np.percentile(seconds, 99, axis=0), len(late), ambiguous_s)


def _step_s(stamps_ns: Ints) -> Floats:
    """Step (2,) of which all stamps (n, 2) are multiples: what is cut off at it hides the scatter."""
    return np.asarray(1e-9 * np.minimum(np.gcd.reduce(stamps_ns, axis=0), _COARSEST_NS))


def _before(in_order: list[int], start_ns: int) -> int | None:
    """The latest shot before an exposure."""
    place = bisect.bisect_right(in_order, start_ns)
    return in_order[place - 1] if place else None

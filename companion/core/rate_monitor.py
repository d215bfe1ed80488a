"""Delivered sample rates of the streams, and which depart so far from the airframe's that the tracker restarts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from companion.params.airframe import Airframe
from companion.records import ImuBatch, Ints, Station

_WINDOW_NS = 2_000_000_000  # long enough for 10 samples of the slowest stream (choice)
_LONGEST_NS = 10_000_000_000  # chosen, by arrival: stamps that have not gone on by a window until then tell no rate
_ALIKE = 0.15  # two windows of a settled rate differ by less (choice)
# chosen: of the airframe's rate; ArduPilot, which cuts intervals to ms, still gives 0.83 of 400 Hz
_LEAST, _MOST = 0.7, 1.4
_MOST_LATE = 0.5  # of a station's samples; a few late ones are the link's habit (choice)
_SLOWEST_HZ = 5.0  # below it no mode is seen (choice)


@dataclass(slots=True)
class _Window:
    stamps: list[Ints] = field(default_factory=list)
    begun_host_ns: int = 0
    spacing_hz: float = 0.0


@dataclass(slots=True)
class StreamRateMonitor:
    """Watches the stamps. An autopilot grants what it can, falls back, and sends more after a change.

    The tracker takes the believed rate for how long a gap may be and how much noise a cell has. What is lost on the
    way changes neither: it is the typical spacing that tells, and two windows of 2 s must agree on it. Stamps in bursts
    or steps have another spacing at the airframe's own rate: where the mean rate is right, nothing has changed.
    """

    _windows: dict[Station, _Window] = field(default_factory=dict)
    _late: dict[Station, list[int]] = field(default_factory=dict)  # samples since the last look: all, too late

    def note(self, batch: ImuBatch) -> None:
        """Take note of samples."""
        window = self._windows.setdefault(batch.station, _Window())
        stamps, received_ns = window.stamps, batch.received_host_ns
        if stamps and (batch.t_ns[0] < stamps[-1][-1] - _WINDOW_NS or received_ns - window.begun_host_ns > _LONGEST_NS):
            stamps.clear()  # its clock restarted, or stands still
        if not stamps:
            window.begun_host_ns = received_ns
        stamps.append(batch.t_ns)

    def note_late(self, station: Station, count: int, late: int) -> None:
        """Take note of how many samples came, and of how many that were refused because they came too late."""
        counts = self._late.setdefault(station, [0, 0])
        counts[0] += count
        counts[1] += late

    def complaints(self) -> list[str]:
        """Sentences for the operator on stations of which more than half the samples since the last look came late."""
        late = [
            station.name.lower() for station, (count, refused) in self._late.items() if refused > _MOST_LATE * count
        ]
        self._late.clear()
        return [f"{name} samples come later than TRK_WINDOW: not used" for name in late]

    def changed(self, airframe: Airframe) -> Iterator[tuple[Station, float]]:
        """Give stations whose rate has settled far from the airframe's, with that rate in Hz."""
        for station, window in self._windows.items():
            if not window.stamps or window.stamps[-1][-1] - window.stamps[0][0] < _WINDOW_NS:
                continue
            t_ns, before_hz = np.sort(np.concatenate(window.stamps)), window.spacing_hz
            window.stamps.clear()
            steps_ns = t_ns[1:] - t_ns[:-1]
            middle = len(steps_ns) // 2  # of an even number the upper one: between two alike there is nothing
            window.spacing_hz = hz = 1e9 / max(float(np.partition(steps_ns, middle)[middle]), 1.0)
            settled = abs(hz - before_hz) < _ALIKE * hz
            mean_hz = (len(t_ns) - 1) * 1e9 / float(t_ns[-1] - t_ns[0])
            if settled and hz > _SLOWEST_HZ and all(_departs(rate, airframe, station) for rate in (hz, mean_hz)):
                yield station, mean_hz


def _departs(rate_hz: float, airframe: Airframe, station: Station) -> bool:
    """Whether a rate is far from the airframe's."""
    return not _LEAST <= rate_hz / airframe.sensor(station).rate_hz <= _MOST

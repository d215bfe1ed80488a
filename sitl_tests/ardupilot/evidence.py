"""Evidence that a run leaves, read for the tests: the service's recording, the autopilot's log, its boot clock."""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pymavlink import mavutil

from companion.adapters.recordings.mcap.reader import McapRecording
from companion.records import ClockName, ClockState, Floats, ImuBatch, Ints, Station, Tick
from sitl_tests.ardupilot.rail import RATE_HZ

T = TypeVar("T")
RANGE_GOOD, RANGE_TOO_FAR = 4, 3
"""RangeFinder::Status in the autopilot's log: what it uses, and what lies beyond the sensor's reach."""


class Tape:
    """The service's recording, in memory."""

    def __init__(self, path: Path) -> None:
        self.records: list[Any] = list(McapRecording(path).records())

    def of(self, kind: type[T]) -> list[T]:
        """Records of one kind, in order."""
        return [record for record in self.records if isinstance(record, kind)]

    def made(self, kind: type[T]) -> list[tuple[int, T]]:
        """Records of one kind with the host time of the tick that made them."""
        stamped_records, at_ns = [], 0
        for record in self.records:
            if isinstance(record, Tick):
                at_ns = record.now_host_ns
            elif isinstance(record, kind):
                stamped_records.append((at_ns, record))
        return stamped_records

    def rate_hz(self, station: Station, from_ns: int, to_ns: int) -> float:
        """Samples a second of one sensor between two host times."""
        arrived = [b for b in self.of(ImuBatch) if b.station == station and from_ns <= b.received_host_ns < to_ns]
        return sum(len(batch.t_ns) for batch in arrived) * 1e9 / (to_ns - from_ns)

    def ticks_ns(self) -> list[int]:
        """Host time of every tick of the service."""
        return [tick.now_host_ns for tick in self.of(Tick)]

    def last_ns(self) -> int:
        """Host time of the last inertial batch."""
        return max(batch.received_host_ns for batch in self.of(ImuBatch))


def frames_ns(report: Mapping[str, Any]) -> list[int]:
    """Host time at which the physics sent each frame."""
    return array("q", report["sent_ns"]).tolist()


class BootClock:
    """The autopilot's boot clock on the host's: it stands between frames, so at any instant it is known to one frame.

    Parameters
    ----------
    report
        What the physics process reported: when each frame was sent. Frame n carries the stamp (n + 1)/1200 s.
    """

    def __init__(self, report: Mapping[str, Any]) -> None:
        self._sent_ns: Ints = np.array(array("q", report["sent_ns"]), dtype=np.int64)

    def between(self, host_ns: int) -> tuple[int, int]:
        """Earliest and latest boot time that it can show at a host instant."""
        sent = int(np.searchsorted(self._sent_ns, host_ns))
        return (sent - 1) * 1_000_000_000 // RATE_HZ, sent * 1_000_000_000 // RATE_HZ

    def runs(self, host_ns: int) -> bool:
        """Whether it runs at a host instant: the last frame before was sent less than two frames ago, and on time."""
        sent = int(np.searchsorted(self._sent_ns, host_ns))
        if not 0 < sent <= len(self._sent_ns):
            return False
        late_ms = self.lateness_ms()[sent - 1] - np.median(self.lateness_ms())
        return host_ns - int(self._sent_ns[sent - 1]) < 2e9 / RATE_HZ and bool(late_ms < 1e3 / RATE_HZ)

    def lateness_ms(self) -> Floats:
        """How late each frame went out."""
        due = np.arange(len(self._sent_ns)) * (1e9 / RATE_HZ)
        return np.asarray((self._sent_ns - self._sent_ns[0] - due) * 1e-6)


def boot_clock(report: Mapping[str, Any], tape: Tape) -> tuple[int, list[tuple[float, float, float]], int]:
    """Judge the boot clock's states where that clock ran: how many, those outside their bound, the median bound [ns].

    Those outside as ms from the earliest and from the latest true time, and their bound.
    """
    clock = BootClock(report)
    states = [s for s in tape.of(ClockState) if s.clock == ClockName.BOOT and s.synced and clock.runs(s.at_host_ns)]
    outside = []
    for state in states:
        earliest, latest = clock.between(state.at_host_ns)
        stated_boot_ns = state.at_host_ns + state.offset_ns
        if not earliest - state.bound_ns <= stated_boot_ns <= latest + state.bound_ns:
            outside.append(
                ((stated_boot_ns - earliest) * 1e-6, (stated_boot_ns - latest) * 1e-6, state.bound_ns * 1e-6)
            )
    bounds = sorted(state.bound_ns for state in states)
    return len(states), outside, bounds[len(bounds) // 2] if bounds else 0


def rangefinder_log(folder: Path) -> list[tuple[float, float, int]]:
    """Boot time in s, distance in m and status of every RFND entry of the autopilot's own logs."""
    entries = []
    for path in sorted((folder / "logs").glob("*.BIN")):
        log = mavutil.mavlink_connection(str(path))
        while (entry := log.recv_match(type=["RFND"])) is not None:
            entries.append((entry.TimeUS * 1e-6, float(entry.Dist), int(entry.Stat)))
        log.close()
    return entries

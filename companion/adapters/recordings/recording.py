"""Protocol of every reader: records in arrival order, the clock they are in, and sentences about what is wrong."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from companion.adapters.recordings.mcap.channels import Recordable
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import Axis, ClockName, Floats, ImuBatch, Ints, Notice, Station
from companion.units import Severity

_Kind = TypeVar("_Kind")
BATCH_NS = 20_000_000  # chosen: as a live read: two ticks of the service at 100 Hz
_GAP_RATIO = 2.5  # of the median step: more is a gap (choice)
_FINEST_STEP_NS, _COARSEST_STEP_NS = 2e4, 2e8  # the rates that an airframe may have (derived)
_JITTER_RATIO = 0.15  # of the median step: a wider spread of the steps is told (choice)


class Recording(Protocol):
    """A recording of any format, opened.

    ``hub`` is the clock that stands for the host's, which a replay declares as identity: HOST in our own recordings and
    CSV folders, BOOT in an autopilot's log. ``airframe`` is the airframe as it fits this recording: what the reader
    knows better (no low-pass in raw samples, axes and rates that are really there) is put in. ``settings`` are those in
    force when the recording began, the defaults where it does not tell. ``notices`` are complete once ``records`` is
    exhausted.
    """

    path: Path
    hub: ClockName
    airframe: Airframe
    settings: Settings

    @property
    def replayable(self) -> bool:
        """Whether a replay reproduces what the service published."""
        ...

    @property
    def notices(self) -> list[Notice]:
        """Sentences about what is wrong with the recording or worth knowing."""
        ...

    def records(self) -> Iterator[Recordable]:
        """Every record, in arrival order; may be called again, and gives the same."""
        ...


@dataclass(frozen=True, slots=True)
class InertialStream:
    """All samples of one sensor of a log that is read as a whole.

    ``t_ns`` (n,) are stamps on ``clock``, ``values`` (n, 6) are as in :class:`ImuBatch`.
    """

    station: Station
    clock: ClockName
    axes: Axis
    t_ns: Ints
    values: Floats

    def batches(self) -> Iterator[ImuBatch]:
        """Cut into batches as a link would have delivered them: received at the newest stamp so far."""
        if self.t_ns.size == 0:
            return
        newest = np.maximum.accumulate(self.t_ns)
        cuts = np.flatnonzero(np.diff(newest // BATCH_NS)) + 1
        edges = [0, *cuts.tolist(), self.t_ns.size]
        for start, stop in itertools.pairwise(edges):
            yield ImuBatch(
                station=self.station,
                clock=self.clock,
                t_ns=self.t_ns[start:stop],
                values=self.values[start:stop],
                axes=self.axes,
                received_host_ns=int(newest[stop - 1]),
            )


def join(axis_groups: Sequence[InertialStream]) -> InertialStream:
    """Join the axes of one sensor that were logged apart into one stream, on the stamps of the longest part.

    The other parts are interpolated linearly; where one of them has a gap, or has not begun or has ended, the sample is
    left out.
    """
    base = max(axis_groups, key=lambda axis_group: axis_group.t_ns.size)
    values, axes = base.values.copy(), base.axes
    covered = np.ones(base.t_ns.size, dtype=np.bool_)
    for axis_group in [axis_group for axis_group in axis_groups if axis_group is not base]:
        after = np.searchsorted(axis_group.t_ns, base.t_ns)
        exact = np.isin(base.t_ns, axis_group.t_ns)
        inside = (after > 0) & (after < axis_group.t_ns.size)
        steps = np.diff(axis_group.t_ns)
        if steps.size:
            around = steps[np.clip(after - 1, 0, steps.size - 1)]
            inside &= around <= _GAP_RATIO * float(np.median(steps))
        covered &= exact | inside
        for i in axis_group.axes.columns:
            values[:, i] = np.interp(base.t_ns, axis_group.t_ns, axis_group.values[:, i])
        axes |= axis_group.axes
    return InertialStream(base.station, base.clock, axes, base.t_ns[covered], values[covered])


def rate_of(t_ns: Ints, otherwise_hz: float) -> float:
    """Mean rate of stamps (n,), gaps left out; ``otherwise_hz`` where they are too few or no rate of a sensor."""
    steps_ns = np.diff(t_ns)
    steps_ns = steps_ns[steps_ns > 0]
    if not steps_ns.size:
        return otherwise_hz
    mean_ns = float(np.mean(steps_ns[steps_ns <= _GAP_RATIO * np.median(steps_ns)]))
    return 1e9 / mean_ns if _FINEST_STEP_NS <= mean_ns <= _COARSEST_STEP_NS else otherwise_hz


@dataclass(slots=True)
class Notes:
    """Collects notices for one recording, each text once."""

    notices: list[Notice] = field(default_factory=list)

    def add(self, text: str, at_host_ns: int = 0, severity: int = Severity.WARNING) -> None:
        """Append a notice unless it is there already."""
        if all(notice.text != text for notice in self.notices):
            self.notices.append(Notice(severity, text, at_host_ns))

    def gaps(self, name: str, t_ns: Ints) -> None:
        """Say where a stream's stamps (n,) have gaps (over 2.5 usual steps), uneven steps, or do not increase."""
        if t_ns.size < 3:
            return
        steps = np.diff(t_ns)
        usual = float(np.median(steps))
        for problem, count in (("repeat the one before", int((steps == 0).sum())), ("go back", int((steps < 0).sum()))):
            if count:
                self.add(f"{name}: {count} of {t_ns.size} stamps {problem}", int(t_ns[0]))
        if usual <= 0.0:  # most stamps repeat or go back, which is said above: there is no usual step
            return
        wide = np.flatnonzero(steps > _GAP_RATIO * usual)
        low, high = np.percentile(np.delete(steps, wide), (1, 99))
        if high - low > _JITTER_RATIO * usual:
            text = f"{name}: uneven steps, {low / 1e6:.2f} to {high / 1e6:.2f} ms (usual {usual / 1e6:.2f} ms)"
            self.add(text, int(t_ns[0]), Severity.INFO)
        if wide.size:
            longest = int(wide[np.argmax(steps[wide])])
            self.add(
                f"{name}: {wide.size} gap{'s' if wide.size > 1 else ''} longer than {_GAP_RATIO * usual / 1e6:.1f} ms "
                f"(usual step {usual / 1e6:.2f} ms); the longest, {steps[longest] / 1e6:.1f} ms, "
                f"at {(t_ns[longest] - t_ns[0]) / 1e9:.3f} s",
                int(t_ns[longest]),
            )


def merge(*sources: Iterable[tuple[int, _Kind]]) -> Iterator[_Kind]:
    """Merge time-ordered sources into one; at equal times the earlier source comes first."""
    for _, record in heapq.merge(*sources, key=lambda entry: entry[0]):
        yield record


def timed(stream: InertialStream) -> Iterator[tuple[int, ImuBatch]]:
    """A stream's batches with their arrival, for :func:`merge`."""
    for batch in stream.batches():
        yield batch.received_host_ns, batch


class LoggedRecording:
    """Base of the readers of foreign logs; the attributes are those of :class:`Recording`."""

    def __init__(self, path: Path, airframe: Airframe, hub: ClockName) -> None:
        self.path = path
        self.hub = hub
        self.airframe = airframe
        self.settings = Settings()
        self.replayable = False
        self.notes = Notes()

    @property
    def notices(self) -> list[Notice]:
        """Sentences about what is wrong or worth knowing; complete once ``records`` is exhausted."""
        return self.notes.notices

    def say(self, text: str, at_host_ns: int = 0, severity: int = Severity.WARNING) -> None:
        """Append a notice that begins with the file's name."""
        self.notes.add(f"{self.path.name}: {text}", at_host_ns, severity)

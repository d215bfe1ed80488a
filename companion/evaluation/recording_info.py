"""Contents of a recording in one screen: sensor streams with true rates and gaps, record counts, refusals, losses."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from companion.adapters.recordings.mcap.channels import Recordable
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.recording import Recording
from companion.evaluation.service_health import ServiceHealth
from companion.records import Axis, CorrectedRange, Floats, ImuBatch, Ints, Reject, Rejected, Station

_GAP_STEPS = 2.5  # usual steps; the readers' own limit for a gap (convention)
_USUAL_STEPS = 1000  # steps that the usual one is the median of (choice)
AT_THE_END = "after the last sample (the recording's end)"


@dataclass(slots=True)
class StreamInfo:
    """One inertial sensor's samples, gathered batch by batch.

    ``earliest_ns`` and ``latest_ns``, and ``last_ns`` of the last sample, are stamps on the sensor's own clock;
    ``axes`` were measured.
    """

    samples: int = 0
    earliest_ns: int = 0
    latest_ns: int = 0
    last_ns: int = 0
    axes: Axis = Axis.NONE
    _steps_ns: list[Ints] = field(default_factory=list)

    def add(self, batch: ImuBatch) -> None:
        """Take the next batch; an empty one says nothing."""
        if not batch.t_ns.size:
            return
        stamps = batch.t_ns if not self.samples else np.concatenate(([self.last_ns], batch.t_ns))
        self._steps_ns.append(np.diff(stamps))
        earliest_ns, latest_ns = int(batch.t_ns.min()), int(batch.t_ns.max())
        self.earliest_ns = min(self.earliest_ns, earliest_ns) if self.samples else earliest_ns
        self.latest_ns = max(self.latest_ns, latest_ns) if self.samples else latest_ns
        self.last_ns = int(batch.t_ns[-1])
        self.samples += int(batch.t_ns.size)
        self.axes |= batch.axes

    @property
    def steps_s(self) -> Floats:
        """Steps between consecutive samples, (n - 1,)."""
        steps_s: Floats = 1e-9 * np.concatenate([np.zeros(0), *self._steps_ns])
        return steps_s

    @property
    def rate_hz(self) -> float | None:
        """One over the mean step, gaps and repeated stamps left out; None for fewer than two samples."""
        steps_s, usual_s = self.steps_s, self._usual_s()
        regular = steps_s[(steps_s > 0.0) & (steps_s <= _GAP_STEPS * usual_s)]
        return float(1.0 / regular.mean()) if regular.size else None

    def gaps(self) -> tuple[int, float]:
        """Number of gaps longer than 2.5 usual steps, and the time that all of them lasted, s."""
        steps_s, usual_s = self.steps_s, self._usual_s()
        wide = steps_s[steps_s > _GAP_STEPS * usual_s] if usual_s else steps_s[:0]
        return int(wide.size), float(wide.sum())

    def _usual_s(self) -> float:
        positive = self.steps_s[self.steps_s > 0.0][:_USUAL_STEPS]
        return float(np.median(positive)) if positive.size else 0.0


@dataclass(slots=True)
class RecordingInfo:
    """Everything that :func:`summarise` gathers from a recording's records."""

    streams: dict[Station, StreamInfo] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)
    rejected: Counter[str] = field(default_factory=Counter)
    published: int = 0
    service: ServiceHealth = field(default_factory=ServiceHealth)
    _stopped: list[Rejected] = field(default_factory=list)

    def add(self, record: Recordable) -> None:
        """Count one record."""
        self.counts[type(record).__name__] += 1
        self.service.take(record)
        if isinstance(record, ImuBatch):
            self.streams.setdefault(record.station, StreamInfo()).add(record)
        elif isinstance(record, Rejected):
            self.rejected[str(record.reason)] += record.count
            self._stopped += [record] if record.reason is Reject.STALE else []
        elif isinstance(record, CorrectedRange):
            self.published += record.trusted

    def refused(self) -> Counter[str]:
        """Refusals by reason; those of the flight's end, when no sample came any more, have a reason of their own."""
        ended = sum(refusal.count for refusal in self._stopped if self.service.is_end(refusal.at_host_ns))
        return self.rejected - Counter({str(Reject.STALE): ended}) + Counter({AT_THE_END: ended})

    @property
    def duration_s(self) -> float:
        """Time from the earliest to the latest inertial sample, on the sensors' own clocks."""
        spans = [stream.latest_ns - stream.earliest_ns for stream in self.streams.values()]
        return max(spans, default=0) * 1e-9


def summarise(recording: Recording) -> RecordingInfo:
    """Read a recording once and count what is in it."""
    info = RecordingInfo()
    for record in recording.records():
        info.add(record)
    return info


def lines(recording: Recording, info: RecordingInfo) -> list[str]:
    """The screen, line by line."""
    text = [f"{recording.path}: {_kind(recording)}, {info.duration_s:.1f} s, airframe {recording.airframe.name}"]
    text += [f"  {stream_line(station, stream)}" for station, stream in sorted(info.streams.items())]
    absent = [station.name.lower() for station in Station if station not in info.streams]
    if absent:
        text.append(f"  no samples of: {', '.join(absent)}")
    text += [f"  records: {_counted(info.counts)}"] if info.counts else ["  no records"]
    if info.counts["CorrectedRange"]:
        text.append(f"  ranges: {info.counts['CorrectedRange']} corrected, {info.published} published")
    text += [f"  refused: {_counted(info.refused())}"] if info.rejected else []
    text += [f"  service: {info.service.summary()}"] if info.service.statuses else []
    changed = ", ".join(f"{name} {value:g}" for name, value in recording.settings.changed().items())
    text += [f"  changed settings: {changed}"] if changed else []
    text += [f"  note: {notice.text}" for notice in recording.notices]
    return [*text, f"  {_uses(recording, info)}"]


def _kind(recording: Recording) -> str:
    if isinstance(recording, McapRecording):
        return f"recording of Spanwise (software {recording.software})"
    kinds = {".bin": "ArduPilot log", ".tlog": "telemetry log", ".ulg": "PX4 log"}
    return kinds.get(recording.path.suffix.lower(), "laboratory tables")


def stream_line(station: Station, stream: StreamInfo) -> str:
    """One stream in words: samples, axes, rate, gaps."""
    rate = f"{stream.rate_hz:.1f} Hz" if stream.rate_hz is not None else "no rate"
    count, lost_s = stream.gaps()
    gaps = f"{count} gap{'s' * (count != 1)}, {lost_s:.2f} s together" if count else "no gaps"
    return f"{station.name.lower():5s} {stream.samples} samples of {stream.axes.letters} at {rate}, {gaps}"


def _counted(counts: Counter[str]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counts.most_common())


def _uses(recording: Recording, info: RecordingInfo) -> str:
    """Commands that can use the recording, and what each would give; none of them has been run."""
    if not info.streams:
        return "nothing to replay or to diagnose: no inertial samples"
    replay = "as published" if recording.replayable else "anew, not as published"
    text = f"can be used for: spanwise replay (estimates {replay})"
    stations = set(info.streams)
    if not stations - {Station.ROOT}:
        return f"{text}; not for spanwise diagnose, which needs samples of a wing tip"
    root = "and root" if Station.ROOT in stations else "alone: without a root the aircraft's own motion stays in them"
    return f"{text}, spanwise diagnose (has wing sensors {root})"

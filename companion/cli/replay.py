"""``spanwise replay``: the same estimation from a recording of ours, or from an ArduPilot, PX4 or laboratory log."""

from __future__ import annotations

import argparse
import dataclasses
import hashlib
import itertools
import json
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeGuard

from companion.adapters.recordings.mcap.channels import Recordable
from companion.adapters.recordings.mcap.codec import plain_values
from companion.adapters.recordings.mcap.machine import machine
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.mcap.writer import About, McapWriter, software_version
from companion.adapters.recordings.recording import Recording
from companion.adapters.recordings.tables.csv import CsvRecording
from companion.cli.steps.live_view import add_live, live_session, read_live
from companion.cli.steps.options import (
    add_recording,
    add_settings,
    check_ending,
    check_new,
    check_output,
    open_given,
    read_settings,
)
from companion.cli.steps.paced_view import PacedView
from companion.cli.terminal.progress import Progress, progress_of, say
from companion.errors import NOTHING_TO_ESTIMATE, RecordingError
from companion.evaluation.replay import drive, foreign_inputs, own_inputs
from companion.evaluation.replay_comparison import ROUNDING_RATIO, ReplayComparison
from companion.evaluation.station_tones import StationAnalysis
from companion.live.about import ViewKind
from companion.live.session import Subject
from companion.params.settings import Settings
from companion.records import (
    ClockName,
    CorrectedRange,
    Deflection,
    ImuBatch,
    ModeState,
    NoRange,
    ObstacleSectors,
    Record,
    Rejected,
    ServiceStatus,
    TriggerPlan,
    Validity,
)
from companion.units import Severity

_OUTPUTS = (ModeState, TriggerPlan, Deflection, CorrectedRange, NoRange, ObstacleSectors, ServiceStatus)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_recording(parser)
    parser.add_argument("--json", action="store_true", help="the result as JSON on standard output")
    parser.add_argument("--out", type=Path, metavar="FILE.mcap", help="write the outputs as a recording")
    parser.add_argument("--plain", action="store_true", help="progress as a line every few seconds (standard error)")
    add_live(parser)
    add_settings(parser)


@dataclass(slots=True)
class OutputCounters:
    """Counts and digest of the outputs.

    ``last_tracking`` is the newest state with the wing tracked, ``last_sampled`` that before the newest sample: once
    the sensors have stopped, a state is a forecast whose sigma grows.
    """

    counts: Counter[str] = field(default_factory=Counter)
    validity: Counter[str] = field(default_factory=Counter)
    rejected: Counter[str] = field(default_factory=Counter)
    last_tracking: ModeState | None = None
    last_sampled: ModeState | None = None
    trusted: list[CorrectedRange] = field(default_factory=list)
    digest: Any = field(default_factory=hashlib.sha256)

    def sampled(self) -> None:
        """Note that a sample came after the outputs so far."""
        self.last_sampled = self.last_tracking

    def take(self, record: Record) -> None:
        """Count one output and add its bytes to the digest."""
        self.counts[type(record).__name__] += 1
        self.digest.update(encoded(record))
        if isinstance(record, ModeState):
            self.validity[str(record.validity)] += 1
            if record.validity is Validity.TRACKING:
                self.last_tracking = record
        elif isinstance(record, CorrectedRange) and record.trusted:
            self.trusted.append(record)
        elif isinstance(record, Rejected):
            self.rejected[str(record.reason)] += record.count


def execute(options: argparse.Namespace) -> int:
    """Replay, and tell what came of it."""
    check_output(options.out, "--out", [options.recording])
    check_ending(options.out, "--out", ".mcap")
    check_new(options.out, "--out")
    recording = open_given(options)
    if isinstance(recording, McapRecording) and recording.empty:
        raise RecordingError(f"{recording.path}: cut off before its first second; there is nothing to replay")
    settings = read_settings(options, recording.settings)
    counters, comparison = OutputCounters(), ReplayComparison(0.0 if _made_here(recording) else ROUNDING_RATIO)
    stations = StationAnalysis(recording.airframe)
    writer: McapWriter | None = None
    same_beliefs = not options.airframe and settings == recording.settings
    recorded = _published(recording) if same_beliefs else None
    progress = progress_of(recording, "replaying", plain=options.plain)
    live = read_live(options, recording.path)
    with live_session(live, _subject(recording, settings)) as watched:
        show = None if watched is None else PacedView(watched)
        for output in _replayed(recording, settings, counters, stations, progress, show):
            counters.take(output)
            if show is not None:
                show.publish(output)
            if options.out is not None:  # not before the replay has begun: one that cannot leaves no file
                writer = writer or McapWriter(options.out, About.of(recording.airframe, settings, recording.hub))
                writer.write(output)
            if recorded is not None and isinstance(output, _OUTPUTS):
                comparison.compare(next(recorded, None), output, lossy=_lossy(recording))
        progress.close()
        if writer is not None:
            writer.close()
        _left_over(comparison, recorded)
        result = _result(recording, counters, stations, comparison if recorded is not None else None)
        print(json.dumps(result, indent=2) if options.json else _text(result), flush=True)
        if show is not None and sys.stdin.isatty() and sys.stdout.isatty():
            say("the recording has ended; its page stays up with the last values until Ctrl-C")
            show.stay()
    if comparison.difference:
        print(f"spanwise replay: not reproduced: {comparison.difference}", file=sys.stderr)
        return 1
    return 0 if counters.trusted or counters.last_tracking or stations.has_tone else NOTHING_TO_ESTIMATE


def _subject(recording: Recording, settings: Settings) -> Subject:
    """Subject of the live view; logs that are not ours have no images."""
    has_images = isinstance(recording, McapRecording) and recording.has_images
    return Subject(
        recording.airframe, settings, recording.path.name, is_recording=True, kind=ViewKind.REPLAY,
        has_images=has_images,
    )  # fmt: skip


def encoded(record: Record) -> bytes:
    """The record's bytes as they would be recorded."""
    return json.dumps([type(record).__name__, plain_values(record)], sort_keys=True).encode()


def _replayed(
    recording: Recording,
    settings: Settings,
    counters: OutputCounters,
    stations: StationAnalysis,
    progress: Progress,
    show: PacedView | None,
) -> Iterator[Record]:
    records = _from_zero(recording) if show is None else show.with_images(_from_zero(recording))
    inputs = own_inputs(records, recording.airframe, settings) if _is_ours(recording) else foreign_inputs(records)
    first = next(inputs, None)
    if first is None and isinstance(recording, McapRecording):
        raise RecordingError(
            f"{recording.path}: holds no inputs (what came over the links), as what `replay --out` wrote; "
            "replay the recording that it was made from"
        )
    hub = None if recording.hub is ClockName.HOST else recording.hub

    def watched() -> Iterator[Record]:
        for record in itertools.chain(() if first is None else (first,), inputs):
            if isinstance(record, ImuBatch):
                stations.add(record)
                counters.sampled()
                progress.at(record.received_host_ns)
            if show is not None:
                show.keep_pace(record)
                show.publish(record)
            yield record

    return drive(watched(), recording.airframe, settings, hub)


def _from_zero(recording: Recording) -> Iterator[Recordable]:
    """Records of a recording; of tables whose time begins before 0, where the pipeline's does, later by as much."""
    streams = recording.streams if isinstance(recording, CsvRecording) else ()
    later_ns = -min((int(stream.t_ns.min(initial=0)) for stream in streams), default=0)
    if not later_ns or not isinstance(recording, CsvRecording):
        return recording.records()
    recording.say(f"t_s begins at {-1e-9 * later_ns:g} s; replayed as from 0", severity=Severity.INFO)
    return (
        dataclasses.replace(batch, t_ns=batch.t_ns + later_ns, received_host_ns=batch.received_host_ns + later_ns)
        for batch in recording.records()
    )


def _is_ours(recording: Recording) -> TypeGuard[McapRecording]:
    return recording.hub is ClockName.HOST and isinstance(recording, McapRecording)


def _published(recording: Recording) -> Iterator[Record] | None:
    """Records that the service published, up to the first that is missing; None where a replay does not give them.

    That is of a log of somebody else, and of a file in which the service's estimation goes on from the one before.
    """
    if not _is_ours(recording) or recording.part_number != 1:
        return None
    return (record for record in recording.records_before_loss() if isinstance(record, _OUTPUTS))


def _lossy(recording: Recording) -> bool:
    """Whether records are missing: behind a cut, in a damaged chunk, or because the disk was too slow for them."""
    return isinstance(recording, McapRecording) and (recording.cut or not recording.complete)


def _loss(recording: Recording) -> dict[str, Any] | None:
    """Loss of a recording: where, and how long it lasted as far as the file tells."""
    if not isinstance(recording, McapRecording) or not _lossy(recording):
        return None
    damaged = not recording.complete and not recording.dropped
    where = "damage" if damaged else "first dropped record" if recording.dropped else "cut"
    return {"where": where, "missing_s": recording.missing_s, "dropped": recording.dropped}


def _made_here(recording: Recording) -> bool:
    """Whether the same version on an equal machine made it: every bit agrees then."""
    if not isinstance(recording, McapRecording):
        return False
    return (recording.machine, recording.software) == (machine(), software_version())


def _left_over(comparison: ReplayComparison, recorded: Iterator[Record] | None) -> None:
    """The live service may have been stopped between an input and its outputs, but never made more than the replay."""
    if recorded is not None and not comparison.behind_loss:
        for extra in itertools.islice(recorded, 1):
            comparison.compare(extra, None)


def _result(
    recording: Recording, counters: OutputCounters, stations: StationAnalysis, comparison: ReplayComparison | None
) -> dict[str, Any]:
    return {
        "recording": str(recording.path),
        "airframe": recording.airframe.name,
        "clock": str(recording.hub),
        "notices": [notice.text for notice in recording.notices],
        "stations": stations.result(),
        "wing": _wing(counters),
        "ranges": {
            "corrected": counters.counts["CorrectedRange"],
            "trusted": len(counters.trusted),
            "last_m": counters.trusted[-1].range_m if counters.trusted else None,
        },
        "outputs": dict(sorted(counters.counts.items())),
        "rejected": dict(sorted(counters.rejected.items())),
        "outputs_sha256": counters.digest.hexdigest(),
        "reproduced": comparison.identical if comparison else None,
        "reproduced_to_rounding": comparison.difference is None if comparison else None,
        "verdict": _verdict(recording, comparison) if comparison else None,
        "loss": _loss(recording),
        "compared": comparison.compared if comparison else 0,
    }


def _wing(counters: OutputCounters) -> dict[str, Any]:
    total = sum(counters.validity.values())
    shares = {name: round(count / total, 4) for name, count in sorted(counters.validity.items())}
    mode = counters.last_sampled
    if mode is None:
        return {"validity": shares, "symmetric": None, "antisymmetric": None}
    members = {"symmetric": mode.symmetric, "antisymmetric": mode.antisymmetric}
    keys = ("frequency_hz", "frequency_sigma_hz", "damping", "damping_sigma", "rms_m", "amplitude_sigma_m", "swings")
    return {"validity": shares} | {name: {k: getattr(m, k) for k in keys} for name, m in members.items()}


def _text(result: dict[str, Any]) -> str:
    lines = [f"{result['recording']}  (airframe {result['airframe']}, clock {result['clock']})"]
    lines += [f"  note: {sentence}" for sentence in result["notices"]]
    foreign = result["clock"] != str(ClockName.HOST)  # a wing of ours has no steady tone, and one would be odd
    tones = {name: entry for name, entry in result["stations"].items() if foreign or entry["tone"] is not None}
    lines += [f"  {name:5s}  {entry['text']}" for name, entry in tones.items()]
    lines.append("  wing   " + _wing_text(result["wing"]))
    ranges = result["ranges"]
    if ranges["corrected"]:
        lines.append(f"  ranges {ranges['corrected']} corrected, {ranges['trusted']} trusted")
    if result["rejected"]:
        lines.append("  refused " + ", ".join(f"{count} x {reason}" for reason, count in result["rejected"].items()))
    if result["verdict"] is not None:
        lines.append(f"  replay of {result['compared']} outputs: {result['verdict']}")
    lines.append(f"  outputs sha256 {result['outputs_sha256']}")
    return "\n".join(lines)


def _verdict(recording: Recording, comparison: ReplayComparison) -> str:
    """How the replay compares, as far as the recording goes, and on which machine it was made where that may matter."""
    sentence, loss = comparison.sentence(), _loss(recording)
    if not comparison.identical and isinstance(recording, McapRecording):
        sentence += f"; {_machines(recording)}"
    if loss is None or comparison.difference is not None:
        return sentence
    missing_s = loss["missing_s"]
    missing = "how much is missing the file does not tell" if missing_s is None else f"{missing_s:.1f} s missing"
    if loss["dropped"]:
        missing = f"{loss['dropped']} records missing"
    agrees = "as published" if comparison.identical else sentence
    return f"{agrees} up to the {loss['where']}, {missing}"


def _machines(recording: McapRecording) -> str:
    if _made_here(recording):
        return f"recorded with an equal machine ({machine()}), where every bit agrees unless the program was changed"
    return f"recorded with {recording.machine or 'an unknown machine'}, replayed with {machine()}"


def _wing_text(wing: dict[str, Any]) -> str:
    shares = ", ".join(f"{name} {100 * fraction:.0f} %" for name, fraction in wing["validity"].items()) or "never seen"
    if wing["symmetric"] is None:
        return f"no mode tracked ({shares})"
    parts = [f"{name} {_mode_text(mode)}" for name, mode in wing.items() if name != "validity"]
    return "; ".join(parts) + f" ({shares})"


def _mode_text(mode: dict[str, Any]) -> str:
    """A frequency only where there is a swing that has one."""
    rms_mm, sigma_mm = 1e3 * mode["rms_m"], 1e3 * mode["amplitude_sigma_m"]
    if not mode["swings"]:
        return f"no swing told ({rms_mm:.2f} ±{sigma_mm:.2f} mm)"
    return f"{mode['frequency_hz']:.3f} ±{mode['frequency_sigma_hz']:.3f} Hz, rms {rms_mm:.2f} ±{sigma_mm:.2f} mm"

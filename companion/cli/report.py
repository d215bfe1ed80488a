"""``spanwise report``: one flight as a self-contained page, its verdict first."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from companion.adapters.recordings.mcap.channels import Recordable
from companion.adapters.recordings.recording import Recording
from companion.cli.steps.options import add_recording, check_ending, check_output, open_given
from companion.cli.terminal.progress import progress_of
from companion.errors import NOTHING_TO_ESTIMATE
from companion.evaluation.flight_log import gather
from companion.evaluation.pages.flight_report import render, verdict
from companion.records import ImuBatch
from companion.reporting.plotting import require_report


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_recording(parser, "a recording of Spanwise; of other logs, what can be said")
    parser.add_argument("--out", type=Path, metavar="FILE.html", help="default: beside the recording")
    parser.add_argument("--plain", action="store_true", help="progress as a line every few seconds (standard error)")


def execute(options: argparse.Namespace) -> int:
    """Write the page and print its verdict; 3 where nothing was tracked or measured."""
    require_report()
    out = options.out or _beside(options.recording.resolve())
    check_output(out, "--out", [options.recording])
    check_ending(options.out, "--out", ".html")
    recording = open_given(options)
    log = gather(_watched(recording, plain=options.plain))
    out.write_text(render(recording, log), encoding="utf-8")
    judged = verdict(recording, log)
    said = [*(f"  {reason}" for reason in judged.reasons), *(f"  note: {note.text}" for note in recording.notices)]
    print("\n".join([judged.headline, *said, f"wrote {out}"]))
    return 0 if log.ranges or log.modes else NOTHING_TO_ESTIMATE


def _beside(recording: Path) -> Path:
    """Page of a recording; a folder's name has no ending, and what follows a dot tells it from its neighbours."""
    return recording.parent / f"{recording.name if recording.is_dir() else recording.stem}.html"


def _watched(recording: Recording, *, plain: bool) -> Iterator[Recordable]:
    progress = progress_of(recording, "read", plain=plain)
    for record in recording.records():
        if isinstance(record, ImuBatch):
            progress.at(record.received_host_ns)
        yield record
    progress.close()

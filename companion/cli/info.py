"""``spanwise info``: contents of a recording of any known format, in one screen."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.adapters.recordings.recording_factory import open_recording
from companion.errors import NOTHING_TO_ESTIMATE
from companion.evaluation.recording_info import lines, summarise
from companion.params.files import load_airframe


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("recording", type=Path, help=".mcap, .tlog, .BIN, .ulg, or a folder with accel.csv")
    parser.add_argument("--airframe", metavar="NAME", help="needed for logs that are not our own; see config/airframes")


def execute(options: argparse.Namespace) -> int:
    """Read the recording once and print its contents; 3 where it holds no inertial samples."""
    airframe = load_airframe(options.airframe) if options.airframe else None
    recording = open_recording(options.recording, airframe)
    info = summarise(recording)
    print("\n".join(lines(recording, info)))
    return 0 if info.streams else NOTHING_TO_ESTIMATE

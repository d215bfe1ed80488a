"""``spanwise info``: contents of a recording of any known format, in one screen."""

from __future__ import annotations

import argparse

from companion.cli.steps.options import add_recording, open_given
from companion.errors import NOTHING_TO_ESTIMATE
from companion.evaluation.recording_info import lines, summarise


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_recording(parser)


def execute(options: argparse.Namespace) -> int:
    """Read the recording once and print its contents; 3 where it holds no inertial samples."""
    recording = open_given(options)
    info = summarise(recording)
    print("\n".join(lines(recording, info)))
    return 0 if info.streams else NOTHING_TO_ESTIMATE

"""``spanwise info``: contents of a recording of any known format, in one screen."""

from __future__ import annotations

import argparse
import sys

from companion.adapters.recordings.recording import Recording
from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.steps.options import add_recording, open_given
from companion.errors import NOTHING_TO_ESTIMATE, AirframeNeeded
from companion.evaluation.recording_info import lines, summarise
from companion.params.files import load_airframe

_STAND_IN = "sitl-plane"  # the autopilot's own sensors, which every foreign log has (choice)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_recording(parser)


def execute(options: argparse.Namespace) -> int:
    """Read the recording once and print its contents; 3 where it holds no inertial samples."""
    recording = _opened(options)
    info = summarise(recording)
    print("\n".join(lines(recording, info)))
    return 0 if info.streams else NOTHING_TO_ESTIMATE


def _opened(options: argparse.Namespace) -> Recording:
    """The recording; a foreign log whose airframe is not given as another aircraft's, which is said."""
    try:
        return open_given(options)
    except AirframeNeeded:
        said = f"no --airframe: read as {_STAND_IN}, the autopilot's own IMUs 1, 2 and 3 as root, left and right"
        print(f"note: {said}", file=sys.stderr)
        return open_recording(options.recording, load_airframe(_STAND_IN))

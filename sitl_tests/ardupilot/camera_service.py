"""The service with the simulated cameras: what ``spanwise run --trigger mavlink`` does, and a camera pair beside it.

``python -m sitl_tests.ardupilot.camera_service OPTIONS-OF-RUN --frames SOCKET``
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
from pathlib import Path

from companion.cli import run
from companion.sim.vision.cameras import SimCameraPair


def main() -> None:
    """Run until SIGINT or SIGTERM."""
    parser = argparse.ArgumentParser(prog="camera_service")
    run.add_arguments(parser)
    parser.add_argument("--frames", type=Path, required=True)
    options = parser.parse_args()
    cameras = functools.partial(SimCameraPair, options.frames)
    run.serve(dataclasses.replace(run.service_config(options), cameras=cameras), options)


if __name__ == "__main__":
    main()

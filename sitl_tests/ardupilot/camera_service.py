"""The service with the simulated cameras: what ``spanwise run --trigger mavlink`` does, and a camera pair beside it.

``python -m sitl_tests.ardupilot.camera_service OPTIONS-OF-RUN --frames SOCKET``
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
from pathlib import Path

from companion.cli import flying, run
from companion.service.config import ServiceConfig
from companion.service.wiring import Service
from companion.sim.cameras import SimCameraPair


def main() -> int:
    """Run until SIGTERM."""
    parser = argparse.ArgumentParser(prog="camera_service")
    run.add_arguments(parser)
    parser.add_argument("--frames", type=Path, required=True)
    options = parser.parse_args()
    flying.Service = functools.partial(_with_cameras, options.frames)  # type: ignore[misc,assignment]
    return run.execute(options)


def _with_cameras(frames: Path, config: ServiceConfig) -> Service:
    return Service(dataclasses.replace(config, cameras=functools.partial(SimCameraPair, frames)))


if __name__ == "__main__":
    raise SystemExit(main())

"""Starting a process of simulated devices: wait until it has opened its door, or say that it did not."""

from __future__ import annotations

import time
from multiprocessing.process import BaseProcess
from pathlib import Path

from companion.errors import DeviceError

_POLL_S = 0.02  # chosen: a door that opens is seen at once


def opened(process: BaseProcess, frames_path: Path, wait_s: float) -> BaseProcess:
    """Start the process of simulated cameras and return it when ``frames_path`` is there.

    Raises
    ------
    DeviceError
        When it ends, or has not opened the path after ``wait_s``.
    """
    process.start()
    deadline = time.monotonic() + wait_s
    while not frames_path.exists():
        if not process.is_alive() or time.monotonic() > deadline:
            process.terminate()
            raise DeviceError(f"the simulated cameras did not open {frames_path}")
        time.sleep(_POLL_S)
    return process

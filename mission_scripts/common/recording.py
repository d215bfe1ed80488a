"""The recordings of a mission: a tap of its own link (tlog), and the service's recorder (MCAP) if it is asked for."""

from __future__ import annotations

import contextlib
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path

from companion.params.airframe import Airframe

_V1, _V2 = 0xFE, 0xFD  # first byte of a MAVLink 1 and 2 frame
_STOP_S = 20.0


class Tap:
    """Writes every MAVLink frame of a link to a tlog. The bytes come from MAVSDK's callback thread.

    A tlog is stamped in UTC: the file system tells when the recording began, the monotonic clock what passed since, so
    that a step of the wall clock steps nothing here. Where the disk takes no more, the file ends and the flight goes
    on; ``trouble`` says why.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.counts: Counter[tuple[int, int]] = Counter()
        self._file = path.open("wb")
        self._began_us = path.stat().st_mtime_ns // 1000
        self._began_ns = time.monotonic_ns()
        self._lock = threading.Lock()
        self.trouble: str | None = None

    def take(self, frame: bytes) -> None:
        """One whole frame."""
        stamp_us = self._began_us + (time.monotonic_ns() - self._began_ns) // 1000
        with self._lock:
            if self._file.closed:
                return
            try:
                self._file.write(stamp_us.to_bytes(8, "big") + frame)
            except OSError as error:
                self._give_up(error)
                return
            if len(frame) > 9 and frame[0] == _V2:
                self.counts[frame[6], int.from_bytes(frame[7:10], "little")] += 1
            elif len(frame) > 5 and frame[0] == _V1:
                self.counts[frame[4], frame[5]] += 1

    def close(self) -> None:
        """Finish the file; may be called again."""
        with self._lock:
            try:
                self._file.close()
            except OSError as error:
                self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        self.trouble = error.strerror
        with contextlib.suppress(OSError):  # closed all the same; what waited in memory is lost
            self._file.close()

    @property
    def frames(self) -> int:
        """How many frames were written."""
        return sum(self.counts.values())


class ServiceRecorder:
    """``spanwise run --record`` on a second link, in a process of its own, ended so that its file is whole."""

    def __init__(self, link: str, airframe: str, path: Path) -> None:
        self.path = path
        program = shutil.which("spanwise", path=str(Path(sys.executable).parent)) or shutil.which("spanwise")
        if program is None:
            raise FileNotFoundError("no `spanwise` beside this Python or on the path")
        arguments = ["run", "--connect", link, "--airframe", airframe, "--record", str(path), "--plain"]
        self._log = path.with_suffix(".service.log").open("wb")
        self._process = subprocess.Popen(
            [program, *arguments], stdout=self._log, stderr=subprocess.STDOUT, start_new_session=True
        )

    @property
    def alive(self) -> bool:
        """Whether the service still runs."""
        return self._process.poll() is None

    def close(self) -> None:
        """Ask it to finish its file; end it if it does not."""
        if self.alive:
            self._process.send_signal(signal.SIGINT)
            try:
                self._process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._log.close()


def tap_is_enough(airframe: Airframe) -> bool:
    """Whether a tlog of this airframe can be estimated from: all its sensors are on the autopilot's clock."""
    return all(sensor.source.clock == "boot" for sensor in (airframe.root, airframe.left, airframe.right))

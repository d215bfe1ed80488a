"""A real ArduPilot executable as a child process: parameters, links on loopback, a folder of its own."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from companion.errors import DeviceError
from sitl_tests.ardupilot.physics import CAMERA_CHANNELS

HOME = "47.0,8.0,400,0"
_CAMERA_TRIGGER = 10
_END_S = 5.0

COMMON: Mapping[str, float] = {
    "SCHED_LOOP_RATE": 400,
    "AHRS_EKF_TYPE": 3,
    "INS_ACCEL_FILTER": 20,
    "INS_GYRO_FILTER": 20,
    "INS_GYR_CAL": 0,
    "FLTMODE_CH": 0,
    # SITL's gyros, accelerometers and compass as "calibrated"
    "INS_ACCOFFS_X": 0.001, "INS_ACCOFFS_Y": 0.001, "INS_ACCOFFS_Z": 0.001,
    "INS_ACCSCAL_X": 1.001, "INS_ACCSCAL_Y": 1.001, "INS_ACCSCAL_Z": 1.001,
    # serial 1 carries Spanwise; SITL keeps 3 and 4 for its own GPS
    "SERIAL1_PROTOCOL": 2, "SERIAL1_BAUD": 921,
    "RNGFND1_TYPE": 10, "RNGFND1_MIN": 0.2, "RNGFND1_MAX": 250,
    "CAM1_TYPE": 1, "CAM1_DURATION": 0.1, "CAM2_TYPE": 1, "CAM2_DURATION": 0.1,
    "LOG_DISARMED": 1,
    # every arming check but the one that is tested: the rangefinder's (bit 15)
    "ARMING_SKIPCHK": 0x1FFFFE & ~(1 << 15),
}  # fmt: skip
CAMERAS: Mapping[str, float] = {f"SERVO{channel}_FUNCTION": _CAMERA_TRIGGER for channel in CAMERA_CHANNELS}


def keep_pace(process: int) -> None:
    """Allow a process to answer within its frame on a busy machine: real-time priority, where we may give it.

    Autopilot and physics take turns 1200 times a second and sleep in between.
    """
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(process, os.SCHED_RR, os.sched_param(1))


@dataclass(frozen=True, slots=True)
class Ports:
    """UDP ports of one run, all on loopback."""

    physics: int
    sensors: int
    remote_control: int
    station: int
    service: int
    nodes: int

    @classmethod
    def free(cls) -> Ports:
        """Ports that nobody uses now."""
        held = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(6)]
        try:
            for entry in held:
                entry.bind(("127.0.0.1", 0))
            return cls(*(entry.getsockname()[1] for entry in held))
        finally:
            for entry in held:
                entry.close()


class Vehicle:
    """The running executable. Its log is ``console.txt`` and its data-flash logs are in ``logs`` of ``folder``.

    In lock-step it flies as fast as frames come, and asks for no priority.
    """

    def __init__(
        self, executable: Path, folder: Path, ports: Ports, parameters: Mapping[str, float], *, lock_step: bool = False
    ) -> None:
        self.folder = folder
        values = {**COMMON, **CAMERAS, **parameters}
        defaults = folder / "defaults.parm"
        defaults.write_text("".join(f"{name} {value:g}\n" for name, value in values.items()))
        self.console = folder / "console.txt"
        command = [
            str(executable.resolve()), "--wipe", "--model", "JSON:127.0.0.1", "--home", HOME,
            "--speedup", "100" if lock_step else "1",
            "--defaults", str(defaults), "--sim-address", "127.0.0.1",
            "--sim-port-out", str(ports.physics), "--sim-port-in", str(ports.sensors),
            "--rc-in-port", str(ports.remote_control),
            "--serial0", f"udpclient:127.0.0.1:{ports.station}",
            "--serial1", f"udpclient:127.0.0.1:{ports.service}",
            "--serial2", "none:",
        ]  # fmt: skip
        with self.console.open("wb") as out:
            self._process = subprocess.Popen(
                command, cwd=folder, stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
                start_new_session=True,
            )  # fmt: skip
        if not lock_step:
            keep_pace(self._process.pid)

    def check(self) -> None:
        """Raise :class:`DeviceError`, with the end of its console, when it has ended."""
        if self._process.poll() is not None:
            tail = self.console.read_text(errors="replace")[-2000:]
            raise DeviceError(f"ArduPilot ended with {self._process.returncode}:\n{tail}")

    def end(self) -> None:
        """Stop it."""
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGTERM)
            try:
                self._process.wait(_END_S)
            except subprocess.TimeoutExpired:
                os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()

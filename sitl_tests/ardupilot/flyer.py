"""A real ArduPlane with its own simple flight model, faster than real; a stand-in for the service on its second link.

The missions' other stage: the same scripts as in ``sitl_tests/loop/test_missions.py``, the real modes and the real
mission state machine.
"""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from pymavlink import mavutil

from companion.params.files import dump_airframe
from companion.sim.vehicle.companion_stub import CompanionStub, RangeFaults
from sitl_tests.loop.rehearsals import Script, airframe
from sitl_tests.ports import free_port

SPEED = 3.0
_COMPANION = 191
_NEEDED = {30: 50_000, 33: 50_000}
# the model's own tuning (Tools/autotest/models/plane.parm of the ArduPilot tree), and what is needed to fly by script
TUNING = {
    "BATT_MONITOR": 4, "AIRSPEED_CRUISE": 22, "AIRSPEED_MIN": 10, "AIRSPEED_MAX": 30,
    "TRIM_THROTTLE": 50, "PTCH_LIM_MIN_DEG": -20, "PTCH_LIM_MAX_DEG": 25, "ROLL_LIMIT_DEG": 65, "ARSPD_USE": 1,
    "KFF_RDDRMIX": 0.5,
    "LAND_PITCH_DEG": 1, "LAND_FLARE_SEC": 3, "FLTMODE_CH": 0, "WP_LOITER_RAD": 80, "WP_RADIUS": 50, "NAVL1_PERIOD": 15,
    "RLL2SRV_TCONST": 0.25, "RLL_RATE_D": 0.01743, "RLL_RATE_FF": 0.237212, "RLL_RATE_I": 0.25, "RLL_RATE_P": 0.3,
    "PTCH2SRV_TCONST": 0.25, "PTCH_RATE_D": 0.007265, "PTCH_RATE_FF": 0.595723, "PTCH_RATE_I": 0.11,
    "PTCH_RATE_P": 0.15,
    "RLL2SRV_RMAX": 90, "PTCH2SRV_RMAX_DN": 90, "PTCH2SRV_RMAX_UP": 90, "PTCH2SRV_RLL": 1,
    "RC3_MIN": 1000, "RC3_MAX": 2000, "RC3_TRIM": 1000, "SERVO3_MIN": 1000, "SERVO3_MAX": 2000,
    "INS_ACCOFFS_X": 0.001, "INS_ACCOFFS_Y": 0.001, "INS_ACCOFFS_Z": 0.001,
    "INS_ACCSCAL_X": 1.001, "INS_ACCSCAL_Y": 1.001, "INS_ACCSCAL_Z": 1.001,
    "INS_ACC2OFFS_X": 0.001, "INS_ACC2OFFS_Y": 0.001, "INS_ACC2OFFS_Z": 0.001,
    "INS_ACC2SCAL_X": 1.001, "INS_ACC2SCAL_Y": 1.001, "INS_ACC2SCAL_Z": 1.001, "INS_GYR_CAL": 0,
    "SCHED_LOOP_RATE": 200, "RNGFND1_TYPE": 10, "RNGFND1_ORIENT": 25, "RNGFND1_MIN": 4, "RNGFND1_MAX": 200,
    "AHRS_EKF_TYPE": 3,
}  # fmt: skip


class Flyer:
    """One ArduPlane from start to end; ``heights_m`` and ``attitudes_rad`` (mode, roll, pitch) are all that it told."""

    def __init__(self, executable: Path, folder: Path) -> None:
        self._folder = folder
        self._port, self._second = free_port(), free_port()
        self.airframe_path = folder / "airframe.toml"
        self.airframe_path.write_text(dump_airframe(airframe()), encoding="utf-8")
        defaults = folder / "defaults.parm"
        defaults.write_text("".join(f"{name} {value:g}\n" for name, value in TUNING.items()))
        command = [
            str(executable.resolve()), "--wipe", "--model", "plane", "--speedup", f"{SPEED:g}",
            "--home", "47.0,8.0,440,0", "--defaults", str(defaults), "--rc-in-port", str(free_port()),
            "--serial0", f"udpclient:127.0.0.1:{self._port}", "--serial1", f"udpclient:127.0.0.1:{self._second}",
            "--serial2", "none:",
        ]  # fmt: skip
        with (folder / "console.txt").open("wb") as out:
            self._process = subprocess.Popen(
                command,
                cwd=folder,
                stdout=out,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )
        self.heights_m: list[float] = [0.0]
        self.attitudes_rad: list[tuple[int, float, float]] = []
        self.mode, self.armed, self._boot_ms = -1, False, 0
        self._when: list[tuple[Callable[[], bool], Callable[[], None]]] = []
        self._stub = CompanionStub(lambda: self.heights_m[-1], lambda: self._boot_ms * 1_000_000)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._companion)
        self._thread.start()

    def __enter__(self) -> Flyer:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        if self._process.poll() is None:
            os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()

    @property
    def ranges(self) -> RangeFaults:
        """Faults of the ranges, a sentence each."""
        return self._stub.faults

    def when(self, condition: Callable[[], bool], action: Callable[[], None]) -> None:
        """Once, as soon as the condition holds."""
        self._when.append((condition, action))

    def fly(self, script: Script, options: Sequence[str]) -> int:
        """Run a script from the ground to its exit code."""
        common = [
            f"--connect=udpin://127.0.0.1:{self._port}",
            f"--airframe={self.airframe_path}",
            f"--out={self._folder}",
        ]
        return script([*common, "--wait=60", "--link-loss=10", "--take-off=60", *options])

    def log(self) -> str:
        """Every line of the mission."""
        return (self._folder / "mission.log").read_text(encoding="utf-8")

    def _companion(self) -> None:
        link = mavutil.mavlink_connection(
            f"udpin:127.0.0.1:{self._second}", source_system=1, source_component=_COMPANION
        )
        asked_s = 0.0
        while not self._stop.is_set():
            message = link.recv_match(blocking=True, timeout=0.02)
            if message is not None and message.get_srcComponent() == 1:
                self._hear(message)
                link.write(self._stub.drain())
            if message is not None and time.monotonic() - asked_s > 5.0:
                asked_s = time.monotonic()
                for number, period_us in _NEEDED.items():
                    link.mav.command_long_send(1, 1, 511, 0, number, period_us, 0, 0, 0, 0, 0)
        link.close()

    def _hear(self, message: object) -> None:
        kind = message.get_type()  # type: ignore[attr-defined]
        if kind == "GLOBAL_POSITION_INT":
            self.heights_m.append(message.relative_alt * 1e-3)  # type: ignore[attr-defined]
            self._boot_ms = message.time_boot_ms  # type: ignore[attr-defined]
        elif kind == "ATTITUDE":
            self.attitudes_rad.append((self.mode, message.roll, message.pitch))  # type: ignore[attr-defined]
        elif kind == "HEARTBEAT":
            self.mode = message.custom_mode  # type: ignore[attr-defined]
            self.armed = bool(message.base_mode & 128)  # type: ignore[attr-defined]
        for entry in list(self._when):
            if entry[0]():
                self._when.remove(entry)
                entry[1]()

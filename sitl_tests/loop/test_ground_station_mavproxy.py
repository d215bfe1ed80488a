"""A real MAVProxy, in a process of its own over UDP: it lists, explains, sets and graphs what our component offers."""

from __future__ import annotations

import importlib.util
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.params.metadata import apm_pdef_xml
from companion.params.settings import tunables
from companion.records import ModeEstimate, ModeState, ParameterChange, Station, Validity
from sitl_tests.loop.ground_stations import COMPANION, STEP, SYSTEM, Air, S
from sitl_tests.loop.ground_stations import Station as GroundStation
from sitl_tests.loop.test_tour import ROOT
from sitl_tests.ports import free_port

pytestmark = [
    pytest.mark.realtime,
    pytest.mark.skipif(
        importlib.util.find_spec("MAVProxy") is None,
        reason="MAVProxy is not installed: pip install --no-deps --require-hashes -r requirements-mavproxy.lock",
    ),
]
_ANSWER_S = 60.0  # a crowded machine imports MAVProxy in twenty


class Radio(GroundStation):
    """Carries frames between our air and a UDP port on which MAVProxy listens."""

    def __init__(self, port: int) -> None:
        super().__init__()
        self.greets = False
        self._beats = 0
        self._mavproxy_address = ("127.0.0.1", port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def hear(self, message: Any, now_ns: int) -> None:
        self._socket.sendto(bytes(message.get_msgbuf()), self._mavproxy_address)

    def turn(self, now_ns: int) -> None:
        try:
            while True:
                self.outbox.append(self._socket.recv(4096))
        except (BlockingIOError, ConnectionRefusedError):
            return

    def close(self) -> None:
        self._socket.close()


class MavProxyProcess:
    """MAVProxy with our component as its target; commands go to its standard input."""

    def __init__(self, port: int, folder: Path) -> None:
        words = [f"--master=udpin:127.0.0.1:{port}", f"--target-system={SYSTEM}", f"--target-component={COMPANION}",
                 "--no-state", "--nowait", "--default-modules=param,graph"]  # fmt: skip
        self._process = subprocess.Popen(
            [sys.executable, "-u", "-m", "sitl_tests.loop.mavproxy_headless", *words], cwd=folder, text=True,
            env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "HOME": str(folder)}, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        self.said = ""
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.said += line

    def type(self, command: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{command}\n")
        self._process.stdin.flush()

    def ask(self, command: str, answer: str) -> re.Match[str]:
        """Type a command, again every few seconds, until something said after it matches."""
        start, ends_s = len(self.said), time.monotonic() + _ANSWER_S
        while time.monotonic() < ends_s:
            self.type(command)
            again_s = time.monotonic() + 5.0
            while time.monotonic() < again_s:
                match = re.search(answer, self.said[start:])
                if match:
                    return match
                time.sleep(0.1)
        raise AssertionError(f"'{command}' was not answered by {answer}: {self.said[-2000:]}")

    def close(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()  # MAVProxy ends with its input
        try:
            self._process.wait(10)
        except subprocess.TimeoutExpired:
            self._process.kill()
        self._reader.join(10)


class Companion:
    """Our component in real time, with a wing whose mode it graphs."""

    def __init__(self, port: int) -> None:
        self.radio = Radio(port)
        self.air = Air(self.radio)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        wing = ModeEstimate(5.25, 0.1, 0.03, 0.01, 0.005, 0.0002, 0.1, 0.1, 5.0, 0.1, 0.003)
        told_ns = 0
        while not self._stop.is_set():
            self.air.run(STEP / S)
            now_ns = self.air.clock.now
            if now_ns - told_ns > S // 4:
                told_ns = now_ns
                nothing = np.zeros(2)
                self.air.pilot.publish(
                    ModeState(now_ns, wing, wing, Validity.TRACKING, nothing, nothing, tuple(Station), ())
                )
            time.sleep(STEP / S)

    def changes(self) -> list[tuple[str, float]]:
        return [(each.name, each.value) for each in self.air.records if isinstance(each, ParameterChange)]

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.radio.close()


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Companion, MavProxyProcess]]:
    port = free_port()
    station = MavProxyProcess(port, tmp_path_factory.mktemp("mavproxy"))
    companion = Companion(port)
    try:
        yield companion, station
    finally:
        companion.close()
        station.close()


def test_mavproxy_lists_all_parameters_with_their_values(flown: tuple[Companion, MavProxyProcess]) -> None:
    _, station = flown
    rows = list(tunables())
    station.ask("param fetch", rf"Received {len(rows)} parameters")
    station.ask("param show *", rf"{rows[-1].name} +\S+")
    for row in rows:
        (shown,) = set(re.findall(rf"\b{row.name} +([-+.\de]+)", station.said))
        assert float(shown) == pytest.approx(row.default, rel=1e-4, abs=1e-6), row.name


def test_mavproxy_sets_a_parameter_and_hears_the_refusal_of_a_wrong_one(
    flown: tuple[Companion, MavProxyProcess],
) -> None:
    companion, station = flown
    station.ask("param fetch", r"Received \d+ parameters")
    station.type("param set TRG_RATE 12.5")
    station.ask("param show TRG_RATE", r"TRG_RATE +12\.5")
    assert companion.changes() == [("TRG_RATE", 12.5)]
    station.ask("param set TRG_RATE 500", r"Failed to set TRG_RATE to 500")
    station.ask("param show TRG_RATE", r"TRG_RATE +12\.5")
    assert companion.changes() == [("TRG_RATE", 12.5)]


def test_mavproxy_explains_a_parameter_from_the_file_that_we_serve(
    flown: tuple[Companion, MavProxyProcess], tmp_path: Path
) -> None:
    _, station = flown
    (tmp_path / "apm.pdef.xml").write_text(apm_pdef_xml(), encoding="utf-8")
    row = next(row for row in tunables() if row.name == "TRG_RATE")
    station.type(f"param set_xml_filepath {tmp_path / 'apm.pdef.xml'}")
    station.ask("param help TRG_RATE", re.escape(row.doc.split(";")[0][:40]))
    assert re.search(rf"Range *: *{row.minimum:g} {row.maximum:g}", station.said)


def test_mavproxy_graphs_the_wing_s_frequency(flown: tuple[Companion, MavProxyProcess]) -> None:
    _, station = flown
    graphed = station.ask("graph \"NAMED_VALUE_FLOAT['f_sym_hz'].value\"", r"graphed \{.*: (\d[\d.]*)\}")
    assert float(graphed[1]) == pytest.approx(5.25, rel=1e-6)

"""The tour without hardware of the set-up page: its commands as they stand there, one after the other, only shorter."""

from __future__ import annotations

import contextlib
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.cli.main import main
from sitl_tests.ports import free_port

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "config" / "SETUP.md"
_RANGES_S = 200.0


def tour() -> list[str]:
    """The commands of the section, without their remarks."""
    section = PAGE.read_text().partition("## A tour without hardware")[2].partition("\n## ")[0]
    block = section.split("```")[1]
    return [line.partition("#")[0].strip() for line in block.splitlines() if line.strip()]


def words(command: str) -> list[str]:
    program, *rest = shlex.split(command)
    assert program == "spanwise"
    return [sys.executable, "-m", "companion.cli", *rest]


@contextlib.contextmanager
def started(command: str, folder: Path) -> Iterator[subprocess.Popen[str]]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(folder / "state")}
    process = subprocess.Popen(
        words(command), cwd=folder, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    )
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30)


def run(command: str, folder: Path, timeout_s: float) -> tuple[int, str]:
    with started(command, folder) as process:
        said, _ = process.communicate(timeout=timeout_s)
        return process.returncode, said


def until(process: subprocess.Popen[str], pattern: str, timeout_s: float) -> str:
    """Output of a process up to this text; all of it, if the text never comes."""
    assert process.stdout is not None
    said, ends_s = "", time.monotonic() + timeout_s
    while not re.search(pattern, said) and time.monotonic() < ends_s:
        line = process.stdout.readline()
        if not line:
            break
        said += line
    return said


@pytest.mark.realtime
@pytest.mark.slow
def test_the_tour_goes_as_the_page_says(tmp_path: Path) -> None:
    vehicle, doctor, service, replay, diagnose = tour()
    port = str(free_port())
    doctor, service = doctor.replace("14550", port), service.replace("14550", port)
    with started(f"{vehicle} --connect udpout:127.0.0.1:{port}", tmp_path) as flying:
        assert "waiting for" in until(flying, "waiting for", 60.0)
        code, said = run(doctor, tmp_path, 60.0)
        assert re.search(r"^ok +rate +root HIGHRES_IMU at 3\d\d Hz", said, re.MULTILINE), said
        assert (code == 0) == ("nothing to fix" in said)
        with started(f"{service} --plain", tmp_path) as flown:
            said = until(flown, r"[1-9]\d* published", _RANGES_S)
            assert re.search(r"[1-9]\d* published", said), said
            flown.send_signal(signal.SIGINT)
            said, _ = flown.communicate(timeout=30)
            assert flown.returncode == 0, said
        flying.send_signal(signal.SIGINT)
        heard, _ = flying.communicate(timeout=30)
    assert flying.returncode == 0
    assert re.search(r"received .*\d+ DISTANCE_SENSOR", heard), heard
    code, said = run(replay, tmp_path, 240.0)
    assert code == 0, said
    assert "identical to what was published" in said
    code, said = run(diagnose, tmp_path, 300.0)
    assert code in (0, 3), said
    assert "verdict: " in said
    assert (tmp_path / "out" / "tour.html").read_text().startswith("<!")


def test_a_simulated_pair_that_nobody_serves_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    away = tmp_path / "nowhere"
    words = ["--connect=udpin:127.0.0.1:0", "--airframe=nadir-2m", f"--parameters={tmp_path / 'kept'}"]
    assert main(["run", *words, f"--cameras=sim:{away}"]) == 1
    assert f"start spanwise vehicle --cameras {away} first" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ("--duration=5000", "give 1 to 3600 s"),
        ("--airframe=sitl-plane", "no camera pair"),
        ("--connect=tcp:127.0.0.1:1", "udpin:host:port"),
    ],
)
def test_a_vehicle_that_cannot_be_flown_is_one_sentence(
    option: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["vehicle", "--duration=1", f"--cameras={tmp_path}", option]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("spanwise vehicle: ")
    assert says in error

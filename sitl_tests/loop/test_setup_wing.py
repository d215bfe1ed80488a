"""``spanwise setup wing`` on a simulated aircraft that a simulated hand taps, tilts and plucks: bytes to verdict."""

from __future__ import annotations

import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.cli.main import main
from companion.cli.steps import setup_wing
from companion.cli.steps.wing_guide import WingGuide
from companion.errors import TO_FIX, ConfigError
from companion.params.files import load_airframe
from companion.records import Station
from companion.sim.rehearsal.bench import Miswiring
from sitl_tests.ports import free_port

COMMAND = ("setup", "wing", "--connect", "sim", "--airframe", "nadir-2m")
HANDLED = ("--step", "nodes", "--step", "taps", "--step", "tilts")


def lines(text: str, word: str) -> list[str]:
    return [line.split(None, 1)[1] for line in text.splitlines() if line.strip().startswith(word)]


@pytest.mark.long
def test_a_wing_that_is_wired_right_passes_by_its_figures(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*COMMAND, *HANDLED]) == 0
    said = capsys.readouterr().out
    assert lines(said, "mend") == []
    taps = re.findall(r"tap +(left|right) ([\d.]+) m/s\^2, (?:left|right) ([\d.]+)", said)
    assert [side for side, _, _ in taps] == ["left", "right"]
    assert all(float(struck) > 5.0 * float(other) for _, struck, other in taps), "the hand struck one tip alone"
    angles = re.findall(r"([+-][\d.]+) deg by gravity, ([+-][\d.]+) deg by its gyro", said)
    assert len(angles) == 6, "three stations, two tilts"
    assert all(abs(float(value) - 25.0) < 1.0 for pair in angles for value in pair), "25 degrees were tilted"
    assert "all of nodes, taps, tilts pass" in said


@pytest.mark.slow
def test_exchanged_nodes_and_a_turned_axis_are_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    wrong, wired_right = Miswiring(exchanged=True, turned=((Station.LEFT, 1), (Station.RIGHT, 4))), setup_wing.rehearsal

    def miswired(airframe: Any, steps: list[str], listened_s: float) -> Any:
        return wired_right(airframe, steps, listened_s, wrong)

    monkeypatch.setattr(setup_wing, "rehearsal", miswired)
    assert main([*COMMAND, *HANDLED]) == 4
    said = capsys.readouterr().out
    assert said.count("the nodes are exchanged") == 2
    assert "y has the wrong sign: turn it in [left].source" in said
    assert "q has the wrong sign: turn it in [right].source" in said
    assert [line.split()[0] for line in lines(said, "mend")] == ["tap", "tap", "left", "right"]
    assert "4 to mend" in said


def test_a_modes_sigma_is_printed_with_the_digits_that_it_has() -> None:
    mode = SimpleNamespace(frequency_hz=5.0017, frequency_sigma_hz=0.0041)
    guide = SimpleNamespace(_airframe=load_airframe("nadir-2m"))
    step = WingGuide._mode(guide, "symmetric", mode)  # type: ignore[arg-type]
    assert step.figure == "symmetric 5.002 ±0.004 Hz, the airframe says 5.00 ±0.35"


@pytest.mark.long
def test_plucked_modes_are_those_of_the_wing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*COMMAND, "--step", "modes"]) == 0
    said = capsys.readouterr().out
    modes = re.findall(r"(symmetric|antisymmetric) ([\d.]+) ±0\.0\d*[1-9]", said)
    assert [name for name, _ in modes] == ["symmetric", "antisymmetric"]
    assert [float(value) for _, value in modes] == pytest.approx([5.0, 6.4], rel=0.01), "the airframe's, undamped"


@pytest.mark.slow
@pytest.mark.realtime
def test_a_range_that_does_not_come_is_left_to_mend(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nobody flies: the service runs, says what it waits for, and the step ends by its limit."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    devices = ("--cameras", f"sim:{tmp_path}", "--trigger", f"sim:{tmp_path}")
    link = ("--connect", "udpin:127.0.0.1:0", "--airframe", "nadir-2m")
    assert main(["setup", "wing", *link, "--step", "range", *devices, "--range-within", "3"]) == 4
    said = capsys.readouterr()
    assert re.search(r"mend +range +none in \d+ s", said.out)
    assert "waiting for" in said.err or "starting the processes" in said.err


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_the_first_range_of_the_simulated_aircraft_passes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Autopilot, nodes, trigger and cameras in real time, over a socket and by files, as a person would start them."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    port, cameras = free_port(), tmp_path / "cameras"
    vehicle = ("vehicle", "--airframe", "nadir-2m", "--connect", f"udpout:127.0.0.1:{port}", "--cameras", str(cameras))
    flying = subprocess.Popen([sys.executable, "-m", "companion.cli", *vehicle], stdout=subprocess.DEVNULL)
    try:
        until(cameras.is_dir, 60.0)
        devices = ("--cameras", f"sim:{cameras}", "--trigger", f"sim:{cameras}")
        link = ("--connect", f"udpin:127.0.0.1:{port}", "--airframe", "nadir-2m")
        code = main(["setup", "wing", *link, "--step", "range", *devices, "--range-within", "240"])
    finally:
        flying.terminate()
        flying.wait(30.0)
    said = capsys.readouterr().out
    assert code == 0, said
    passed = re.search(r"ok +range +([\d.]+) ±([\d.]+) m after (\d+) s", said)
    assert passed is not None, said
    range_m, sigma_m = float(passed[1]), float(passed[2])
    assert 2.0 < range_m < 150.0
    assert 0.0 < sigma_m < 0.2 * range_m
    assert "all of range pass" in said


@pytest.mark.parametrize("calibrates", [True, False])
def test_the_first_range_is_that_of_the_calibrated_airframe(
    calibrates: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown: list[str] = []
    squares: list[Any] = []

    def service_config(options: Any) -> Any:
        flown.extend([options.airframe, *options.changes, str(options.sign_key)])
        raise ConfigError("far enough")

    monkeypatch.setattr(setup_wing.calibrate, "execute", lambda options: squares.append(tuple(options.squares)))
    monkeypatch.setattr(setup_wing.run, "service_config", service_config)
    steps = ("--step", "range", *(("--step", "stereo") if calibrates else ()))
    eyes = ("--cameras", "oak:CAM_B,CAM_C", "--square-m", "0.03", "--squares", "7", "5", "--out", str(tmp_path))
    steps += ("--set", "RNG_MAX=60", "--set", "SW_SYSID=7", "--sign-key", "wing.key")
    assert main(["setup", "wing", "--connect", "udpin:127.0.0.1:0", "--airframe", "nadir-2m", *steps, *eyes]) == 1
    airframe = str(tmp_path / "stereo" / "airframe.toml") if calibrates else "nadir-2m"
    assert flown == [airframe, "RNG_MAX=60", "SW_SYSID=7", "wing.key"]
    assert squares == ([(7, 5)] if calibrates else [])


@pytest.mark.realtime
def test_signed_links_have_their_key_on_the_bench_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """An autopilot that signs with another key is named; without a key nothing is refused."""
    key, port = tmp_path / "wing.key", free_port(socket.SOCK_DGRAM)
    key.write_text("passphrase: ours")
    key.chmod(0o600)
    stranger = mavlink.MAVLink(None, 1, 1)
    beating, ends = threading.Event(), time.monotonic() + 30.0

    def beat() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            while not beating.wait(0.2) and time.monotonic() < ends:
                message = mavlink.MAVLink_heartbeat_message(1, 3, 0, 0, 4, 3)
                sender.sendto(bytes(message.pack(stranger)), ("127.0.0.1", port))

    thread = threading.Thread(target=beat)
    thread.start()
    try:
        words = ("--connect", f"udpin:127.0.0.1:{port}", "--airframe", "nadir-2m", "--step", "nodes", "--for", "2")
        assert main(["setup", "wing", *words, "--sign-key", str(key)]) != 0
    finally:
        beating.set()
        thread.join()
    said = capsys.readouterr()
    assert "all are refused: unsigned" in said.out + said.err


def until(true: Callable[[], bool], limit_s: float) -> None:
    """Wait until something is so."""
    ends_s = time.monotonic() + limit_s
    while not true():
        assert time.monotonic() < ends_s, f"not within {limit_s:g} s"
        time.sleep(0.1)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--step", "stereo"), "--step stereo: needs --cameras and --square-m"),
        (("--step", "range"), "--step range: needs --cameras"),
        (("--step", "range", "--cameras", "sim"), "--step range: needs --cameras"),
    ],
)
def test_a_step_that_cannot_be_is_one_sentence(
    options: tuple[str, ...], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*COMMAND, *options]) == 1
    assert says in capsys.readouterr().err


def test_a_link_on_which_nothing_comes_ends_with_the_nodes(capsys: pytest.CaptureFixture[str]) -> None:
    link = ("--connect", f"udpin:127.0.0.1:{free_port()}", "--airframe", "nadir-2m", "--for", "0.3")
    assert main(["setup", "wing", *link]) == TO_FIX
    said = capsys.readouterr().out
    assert lines(said, "mend")[-1] == "samples    none from root, left, right"
    assert "tap" not in said, "no further step was begun"


def test_a_step_says_whose_samples_it_waits_for(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("companion.cli.steps.wing_guide.LIMIT_S", 0.3)
    link = ("--connect", f"udpin:127.0.0.1:{free_port()}", "--airframe", "nadir-2m", "--step", "taps")
    assert main(["setup", "wing", *link]) == 1
    assert "no samples come from root, left, right" in capsys.readouterr().err

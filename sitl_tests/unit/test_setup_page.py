"""Every command that config/SETUP.md shows to be typed is executed by a test, or says what it needs.

Those of the tour are executed in their order by ``sitl_tests/loop/test_tour.py``.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from companion.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
PAGE = re.sub(
    r"^## A tour without hardware$.*?(?=^## )",
    "",
    (ROOT / "config" / "SETUP.md").read_text(encoding="utf-8"),
    flags=re.MULTILINE | re.DOTALL,
)
NEEDS = ("hardware", "the network", "root", "a minute")
ELSEWHERE = {
    "spanwise setup wing --connect sim --airframe nadir-2m": "sitl_tests/loop/test_setup_wing.py",
    "spanwise replay flight.tlog --airframe sitl-plane": "sitl_tests/replay/test_replay_recorded_flight.py",
}
"""Commands that another test executes, in full or with a recording that does not travel with the repository."""
_PROGRAMS = ("spanwise", "sudo", "make", "python", "docker", "uv", "pipx")


def commands() -> list[tuple[str, str]]:
    """Command and remark of each line to be typed."""
    blocks = re.findall(r"^```.*?$(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    lines = [line.removeprefix("$ ").strip() for block in blocks for line in block.splitlines()]
    typed = [line for line in lines if line.split(" ")[0] in _PROGRAMS]
    return [(command.strip(), remark.strip()) for command, _, remark in (line.partition("#") for line in typed)]


COMMANDS = commands()
ALONE = [command for command, remark in COMMANDS if not remark and command not in ELSEWHERE]


def test_the_page_has_commands_of_every_kind() -> None:
    assert len(COMMANDS) > 8
    assert any(remark for _, remark in COMMANDS)
    assert ALONE


@pytest.mark.parametrize(("command", "remark"), COMMANDS)
def test_a_remark_says_what_the_command_needs(command: str, remark: str) -> None:
    assert not remark or remark.startswith(tuple(f"needs {need}" for need in NEEDS)), command


@pytest.mark.parametrize(("command", "place"), ELSEWHERE.items())
def test_what_is_executed_elsewhere_is_on_the_page_and_there(command: str, place: str) -> None:
    assert command in [typed for typed, _ in COMMANDS]
    text = (ROOT / place).read_text(encoding="utf-8")
    assert all(word in text for word in shlex.split(command)[1:] if word not in ("flight.tlog", "--airframe", "replay"))


@pytest.mark.parametrize("command", ALONE)
def test_every_other_command_does_what_it_says(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    program, *words = shlex.split(command)
    assert program == "spanwise"
    assert main(words) in (0, 4), "done, or something of this machine is to be mended"
    said = capsys.readouterr()
    assert said.out
    assert said.err == ""

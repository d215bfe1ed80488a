"""The command line on itself: its version, and the effects it knows."""

from __future__ import annotations

import re
import tomllib
from importlib import metadata
from pathlib import Path

import pytest

from companion.cli.main import main
from companion.core.wing.effects import catalogue

ROOT = Path(__file__).resolve().parents[2]


def said_by(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 0
    return capsys.readouterr().out


def test_the_version_is_the_installed_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert said_by(capsys, "--version") == f"spanwise {metadata.version('spanwise')}\n"


def test_the_newest_changes_are_those_of_the_version_in_pyproject() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    headings = re.findall(r"^## (\S+)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    assert headings[0] == version
    numbers = [tuple(map(int, heading.split("."))) for heading in headings]
    assert numbers == sorted(numbers, reverse=True)


@pytest.mark.parametrize("command", ["simulate", "diagnose"])
def test_help_lists_every_effect_with_its_unit(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    text = said_by(capsys, command, "--help")
    for name, effect in catalogue().items():
        (line,) = (line for line in text.splitlines() if line.startswith(f"  {name} "))
        size = "recorded channel" if effect.follows_channel else effect.parameters()[0].unit or "ratio"
        assert size in line
    assert max(map(len, text.splitlines())) <= 120


@pytest.mark.parametrize(
    ("command", "defaults"),
    [
        (("calibrate", "stereo"), ("out/calibrate", "10 7", "20", "600")),
        (("identify", "flight"), ("out/identify/flight", "2 40")),
        (("identify", "gvt"), ("out/identify/gvt",)),
        (("setup", "wing"), ("out/wing", "10", "300")),
        (("simulate",), ("nadir-2m", "60")),
    ],
)
def test_help_says_the_defaults_of_a_command_and_of_its_parts(
    command: tuple[str, ...], defaults: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    text = " ".join(said_by(capsys, *command, "--help").split())
    for default in defaults:
        assert f"(default: {default})" in text

"""Every ``spanwise`` command that the pages show is one that the program takes: commands, options, choices."""

from __future__ import annotations

import argparse
import re
import shlex
from pathlib import Path

import pytest

from companion.cli.main import build_parser

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "config").glob("*.md")),
    *sorted((ROOT / "companion").rglob("README.md")),
    *sorted((ROOT / "mission_scripts").glob("*.md")),
    *sorted((ROOT / "tools").rglob("*.md")),
    ROOT / "sitl_tests" / "README.md",
]
_INCOMPLETE = ("the following arguments are required", "one of the arguments", "expected one argument")
"""What argparse says of a command that a sentence only mentions: its values are left out."""


class Refused(Exception):
    """Words that argparse would have used."""


def shown(text: str) -> list[tuple[str, bool]]:
    """Commands of a page; the flag says whether it stands in a block, to be typed as it is."""
    blocks = re.findall(r"^```.*?$(.*?)^```", text, re.MULTILINE | re.DOTALL)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    typed = [line.partition("#")[0].strip().removeprefix("$ ") for line in lines]
    rest = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    mentioned = [" ".join(code.split()) for code in re.findall(r"`([^`]+)`", rest)]
    both = [(command, True) for command in typed] + [(command, False) for command in mentioned]
    return [(command, verbatim) for command, verbatim in both if command.startswith("spanwise ")]


COMMANDS = [
    pytest.param(command, verbatim, id=f"{page.relative_to(ROOT)}: {command}")
    for page in PAGES
    for command, verbatim in dict.fromkeys(shown(page.read_text(encoding="utf-8")))
]


@pytest.mark.parametrize(("command", "verbatim"), COMMANDS)
def test_a_command_that_a_page_shows_is_taken(command: str, verbatim: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: argparse.ArgumentParser, message: str) -> None:
        raise Refused(message)

    monkeypatch.setattr(argparse.ArgumentParser, "error", refuse)
    words = shlex.split(re.sub(r"[\[\]]", " ", command))[1:]  # [--option ...] is optional
    words = ["1" if word == "N" else word for word in words]
    try:
        build_parser(words[0]).parse_args(words)
    except Refused as refused:
        if verbatim or not any(text in str(refused) for text in _INCOMPLETE):
            raise
    except SystemExit as ended:
        if ended.code != 0:  # --help and --version end with 0
            raise


def test_pages_show_commands_at_all() -> None:
    assert len(COMMANDS) > 30
    assert sum(bool(verbatim) for _, verbatim in (case.values for case in COMMANDS)) >= 5

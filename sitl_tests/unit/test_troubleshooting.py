"""The troubleshooting table quotes what the program prints: every sentence of its first column is in the code."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "config" / "TROUBLESHOOTING.md"


@functools.cache
def sentences_of_the_code() -> tuple[str, ...]:
    """Every string of the package, with an ellipsis where a value is put in."""
    strings: list[str] = []
    for path in sorted((ROOT / "companion").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.JoinedStr):
                strings.append("".join(str(v.value) if isinstance(v, ast.Constant) else "…" for v in node.values))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                strings.append(node.value)
    return tuple(strings)


def quoted() -> list[str]:
    """Words between backticks in the first column."""
    rows = [line for line in PAGE.read_text().splitlines() if line.startswith("| `")]
    return [sentence for row in rows for sentence in re.findall(r"`([^`]+)`", row.split(" | ")[0])]


@pytest.mark.parametrize("sentence", quoted())
def test_the_program_prints_this_sentence(sentence: str) -> None:
    assert any(sentence in printed for printed in sentences_of_the_code()), "the program does not say this (any more)"


def test_a_sentence_that_is_not_printed_is_noticed() -> None:
    assert not any("the port is in use" in printed for printed in sentences_of_the_code())


def test_the_table_covers_what_withholds_a_range() -> None:
    """Every verdict that the user can do something about has its row."""
    page = " ".join(quoted())
    for reason in ("clock not synced", "stream stopped", "tracker not settled", "sigma too large", "too few matches"):
        assert reason in page
    assert len(quoted()) >= 40

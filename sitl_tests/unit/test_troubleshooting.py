"""The troubleshooting table quotes what the program prints: every sentence of its first column is in the code."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest

from companion.records import Reject

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


# of samples, frames and forecasts: the service shows their counts, and another row has what to do
COUNTED_ALONE = {
    Reject.NO_MODE,
    Reject.BEYOND_RANGE,
    Reject.LAPSED,
    Reject.TOO_LATE,
    Reject.NOT_FINITE,
    Reject.TIME_BACKWARDS,
    Reject.DEVICE_FAILED,
    Reject.QUEUE_FULL,
    Reject.FOREIGN_SOURCE,
    Reject.CRC,
    Reject.IMPLAUSIBLE,
    Reject.INTERNAL_ERROR,
}


@pytest.mark.parametrize("reason", [reason for reason in Reject if reason not in COUNTED_ALONE])
def test_the_table_covers_what_withholds_a_range(reason: Reject) -> None:
    assert any(reason in sentence for sentence in quoted()), f"TROUBLESHOOTING.md needs a row for '{reason}'"

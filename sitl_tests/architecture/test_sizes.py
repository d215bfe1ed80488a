"""Sizes that can be read: most functions fit a glance, and a file holds one thing."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "companion").rglob("*.py"))
LARGEST_FILE = 400  # lines (convention): 350 are aimed at


def _lengths() -> list[int]:
    nodes = (node for path in FILES for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    functions = (node for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    return [(node.end_lineno or node.lineno) - node.lineno + 1 for node in functions]


def test_a_function_has_8_lines_in_the_middle_and_22_at_nine_tenths() -> None:
    """Docstrings included."""
    median, most = np.percentile(_lengths(), [50, 90])
    assert median <= 8
    assert most <= 22


def test_no_file_is_longer_than_400_lines() -> None:
    lines = {
        str(path.relative_to(ROOT / "companion")): len(path.read_text(encoding="utf-8").splitlines()) for path in FILES
    }
    assert {name: count for name, count in lines.items() if count > LARGEST_FILE} == {}

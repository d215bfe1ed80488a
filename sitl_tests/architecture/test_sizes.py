"""Sizes that can be read: most functions fit a glance, and a file holds one thing."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "companion").rglob("*.py"))
PROGRAMS = sorted((ROOT / "tools").rglob("*.py"))
REPEATED = 6  # equal lines in a row that are written once (convention)
LARGEST_FILE = 400  # lines (convention): 350 are aimed at


def _lengths() -> list[int]:
    nodes = (node for path in FILES for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    functions = (node for node in nodes if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    return [(node.end_lineno or node.lineno) - node.lineno + 1 for node in functions]


def test_a_function_has_8_lines_in_the_middle_and_22_at_nine_tenths() -> None:
    """Docstrings included."""
    median, most = np.percentile(_lengths(), [50, 90])
    assert median <= 8, "lines, docstring included, in half of the functions: split the long ones"
    assert most <= 22, "lines, docstring included, in nine of ten functions: split the long ones"


def test_no_file_is_longer_than_400_lines() -> None:
    files = FILES + PROGRAMS
    lines = {str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines()) for path in files}
    longer = {name: count for name, count in lines.items() if count > LARGEST_FILE}
    assert longer == {}, "split the file by what it holds"


def test_no_line_of_c_is_longer_than_120_columns() -> None:
    """As ruff says of Python."""
    longer = [
        f"{path.name}:{number}"
        for path in sorted((ROOT / "companion" / "native").glob("*.[ch]"))
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if len(line) > 120
    ]
    assert longer == []


def _code(path: Path) -> list[tuple[int, str]]:
    """Numbered lines of code: no blank line, comment, docstring or import."""
    text = path.read_text(encoding="utf-8")
    prose: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if is_text or isinstance(node, ast.Import | ast.ImportFrom):
            prose |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = enumerate((line.strip() for line in text.splitlines()), start=1)
    return [(k, line) for k, line in lines if line and not line.startswith("#") and k not in prose]


def test_no_six_lines_of_code_stand_twice() -> None:
    places: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for path in FILES:
        lines = _code(path)
        for start in range(len(lines) - REPEATED + 1):
            run = lines[start : start + REPEATED]
            places[tuple(line for _, line in run)].append(f"{path.relative_to(ROOT)}:{run[0][0]}")
    assert [where for where in places.values() if len(where) > 1] == [], "the same lines twice: make them a function"

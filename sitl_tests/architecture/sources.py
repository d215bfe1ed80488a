"""Texts and syntax trees of the repository's files, each read once, and what breaks a rule by file."""

from __future__ import annotations

import ast
import functools
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import TypeVar

Wrong = TypeVar("Wrong", bound=Collection[object])
ROOT = Path(__file__).resolve().parents[2]


def python_files(*tops: str) -> list[str]:
    """Names of the Python files below these top folders, relative to the root."""
    return [str(path.relative_to(ROOT)) for top in tops for path in sorted((ROOT / top).rglob("*.py"))]


@functools.cache
def text_of(name: str) -> str:
    """Text of a file of the repository."""
    return (ROOT / name).read_text(encoding="utf-8")


@functools.cache
def tree_of(name: str) -> ast.Module:
    """Syntax tree of a Python file of the repository."""
    return ast.parse(text_of(name))


def offences(names: Iterable[str], check: Callable[[str], Wrong]) -> dict[str, Wrong]:
    """Offences that a check finds, by file; files without a fault are left out."""
    return {name: wrong for name in names if (wrong := check(name))}

"""Files are named in the field's terms, and constants say their unit or their source; names: test_names.py."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted((ROOT / "companion").rglob("*.py"))

# file names of an earlier private vocabulary; the field has its own word for each
RETIRED_FILES = frozenset(
    [
        "stretch",
        "floor",
        "rig",
        "layout",
        "slow",
        "trust",
        "silent",
        "folding",
        "feasible",
        "window",
        "remote",
        "alignment",
        "astray",
        "leads",
        "begin",
        "cut",
        "latent",
        "straighten",
        "part",
        "rivals",
        "directions",
        "fates",
        "honesty",
        "debrief",
        "verdicts",
        "judge",
        "tally",
        "questions",
        "texts",
        "outputs",
        "translate",
        "computer",
        "restart",
        "opening",
        "packed",
        "inlet",
        "standin",
        "orders",
        "pilot",
        "feedback",
        "delivery",
        "publishing",
    ]
)
UNIT = re.compile(
    r"_(S|NS|US|MS|MIN|HZ|RAD|RADPS|RADPM|MRAD|M|MM|CM|KM|MPS|MPS2|PX|KG|DEG|DEGPS|G|MG|N|PA|KPA|W|V|A|J|C|K|DB|PPM|"
    r"BPS|BAUD|BYTES|BITS|PERCENT|RATIO|FRACTION|SIGMA|SIGMAS|PER_[A-Z0-9_]+|ID|IDS)$"
)


def _relative(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_files_are_named_in_the_fields_terms() -> None:
    assert not [_relative(path) for path in FILES if path.stem in RETIRED_FILES]


def _numbers(tree: ast.Module) -> Iterator[ast.Assign | ast.AnnAssign]:
    """Module-level constants that are one number."""
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            value = node.value.operand if isinstance(node.value, ast.UnaryOp) else node.value
            if isinstance(value, ast.Constant) and type(value.value) in (int, float):
                yield node


@pytest.mark.parametrize("path", FILES, ids=_relative)
def test_a_constant_says_its_unit_or_its_source(path: Path) -> None:
    text = path.read_text()
    lines, tree = text.splitlines(), ast.parse(text)
    strings = {node.lineno for node in tree.body if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)}
    wrong = []
    for node in _numbers(tree):
        name = ast.unparse(node.targets[0] if isinstance(node, ast.Assign) else node.target)
        commented = "#" in lines[node.lineno - 1] or lines[node.lineno - 2].strip().startswith("#")
        documented = (node.end_lineno or node.lineno) + 1 in strings
        if not (UNIT.search(name) or commented or documented):
            wrong.append(f"{node.lineno}: {name}")
    assert not wrong, wrong

"""Files are named in the field's terms, and constants say where their number comes from; names: test_names.py."""

from __future__ import annotations

import ast
import itertools
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from sitl_tests.architecture.sources import offences, python_files, text_of

FILES = python_files("companion")

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
# what a constant's comment or docstring says of its number: the kind of source, or the work that states it
SOURCE = re.compile(
    r"\b(?:[Cc]hosen|[Cc]hoice|[Dd]erived|[Mm]easured|[Tt]uned|[Cc]onvention|[Nn]umerical|[Bb]y definition|[Bb]ound)\b"
    r"|[Tt]he paper|\b(?:Tables?|Figs?\.) \d|\b(?:19|20)\d\d\)"  # the reproduced paper; another one by its year
    r"|MAVLink|MAV_|ArduPilot|ArduPlane|AP_|PX4|OpenCV|DepthAI|MCAP spec|MAT-File|\.h\b"
)
_SAY_WHERE_FROM = (
    "a comment beside each constant says where its number comes from: chosen, derived, measured, tuned, convention, "
    "numerical, bound or by definition, or the work that states it, with its year"
)
_ARITHMETIC = (ast.Constant, ast.Name, ast.Attribute, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop)
_NUMERIC = (*_ARITHMETIC, ast.Tuple, ast.List, ast.Load)


def test_files_are_named_in_the_fields_terms() -> None:
    retired = [name for name in FILES if Path(name).stem in RETIRED_FILES]
    assert retired == [], "name the file by the field's word for what it holds"


def _is_numeric(value: ast.expr) -> bool:
    """Whether a value is a number, arithmetic with numbers, or tuples of these."""
    nodes = list(ast.walk(value))
    kinds = {type(node.value) for node in nodes if isinstance(node, ast.Constant)}
    return bool(kinds) and kinds <= {int, float} and all(isinstance(node, _NUMERIC) for node in nodes)


def _numeric(tree: ast.Module) -> Iterator[tuple[ast.Assign | ast.AnnAssign, ast.stmt | None]]:
    """Module-level numeric constants, each with the statement behind it."""
    for node, behind in itertools.zip_longest(tree.body, tree.body[1:]):
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and _is_numeric(node.value):
            yield node, behind


def _said(node: ast.stmt, behind: ast.stmt | None, lines: list[str]) -> str:
    """Comments above and beside a constant, and its docstring."""
    first = node.lineno - 1
    while first and lines[first - 1].startswith("#"):
        first -= 1
    said = [line.partition("#")[2] for line in lines[first : node.end_lineno]]
    return " ".join([*said, ast.unparse(behind) if isinstance(behind, ast.Expr) else ""])


def without_source(text: str) -> list[str]:
    """Names of the module-level numeric constants that do not say where their number comes from."""
    lines = text.splitlines()
    constants = ((node, _said(node, behind, lines)) for node, behind in _numeric(ast.parse(text)))
    return [ast.unparse(node).split(" = ")[0] for node, said in constants if not SOURCE.search(said)]


def test_a_constant_says_where_its_number_comes_from() -> None:
    assert offences(FILES, lambda name: without_source(text_of(name))) == {}, _SAY_WHERE_FROM


@pytest.mark.parametrize(
    "text",
    [
        "A_S = 1.0  # chosen: long beside a period",
        "# bound of memory\nA = 16",
        'A_S = 2 * B_S\n"""How long an answer may take (choice)."""',
        "A, B = 1, -2  # derived: of a beam",
        "A = 72  # length of the array (MAVLink common.xml)",
        "A = 4.685  # (Huber and Ronchetti 2009)",
        'A = "text"',
        "A = B * C",
    ],
)
def test_a_constant_with_a_source_passes(text: str) -> None:
    assert without_source(text) == []


@pytest.mark.parametrize(
    "text",
    ["A = 1.0", "A = 1  # seconds", "A: int = -1", "B = C  # chosen\nA = 2 * B", "A = ((1.0, 2 * B), C)  # in m"],
)
def test_a_constant_without_a_source_is_named(text: str) -> None:
    assert [name[0] for name in without_source(text)] == ["A"]

"""Names are the field's terms: no class name stands for two things, and no variable is called by an empty word."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = sorted((ROOT / "companion").rglob("*.py")) + sorted((ROOT / "mission_scripts").rglob("*.py"))
MODULES = {str(path.relative_to(ROOT)): path for path in PACKAGE}
PROGRAMS = {str(path.relative_to(ROOT)): path for path in sorted((ROOT / "tools").rglob("*.py"))}
TESTS = {str(path.relative_to(ROOT)): path for path in sorted((ROOT / "sitl_tests").rglob("*.py"))}

# words that carry no type of thing; ``left`` is a wing, so it is not among them
EMPTY_WORDS = frozenset(
    ["found", "one", "seen", "part", "own", "share", "known", "whole", "there", "told", "mine", "kept", "given"]
)

# names that stand in recordings and airframe files
ON_DISK = {("companion/records/ranging.py", "known"), ("companion/core/wing/effects/damping/hysteresis.py", "share")}

# what things were called before they had the field's name
RETIRED = frozenset(
    (
        "_ROUNDS",
        "_without_idle_seconds",
        "astray",
        "bridged",
        "cell_means",
        "Cells",
        "ClockWatch",
        "crooked",
        "Data",
        "debrief",
        "Delivery",
        "doubt",
        "evened",
        "Family",
        "fates",
        "feasible",
        "Fixed",
        "Floor",
        "folded",
        "folding",
        "FrontEnd",
        "growing",
        "honesty",
        "IdentityWatch",
        "influence",
        "Inlet",
        "inlet",
        "knock",
        "latent",
        "LatentForce",
        "Layout",
        "Lead",
        "leads",
        "likeliest",
        "Memory",
        "misfit",
        "Outlet",
        "OwnComponent",
        "Part",
        "Publishing",
        "Push",
        "questions",
        "RangeStandIn",
        "Reading",
        "restored",
        "RigTracker",
        "rivals",
        "SilentNodes",
        "SlowPrior",
        "SlowRotation",
        "smeared",
        "standin",
        "steepness",
        "Step",
        "StepModel",
        "straighten",
        "Straightener",
        "Stretch",
        "surprise",
        "SURPRISED",
        "Tally",
        "tally",
        "translate",
        "turned_apart",
        "TwoClocks",
        "unnamed",
        "verdicts",
        "when_evened",
        "whole_frame",
        "worth_of",
    )
)


def _defined(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name


def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def test_a_class_name_stands_for_one_thing() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for name, path in MODULES.items():
        if name.startswith("companion/"):
            for node in ast.walk(_tree(path)):
                if isinstance(node, ast.ClassDef):
                    places[node.name].append(name)
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


@pytest.mark.parametrize("name", sorted({**MODULES, **PROGRAMS, **TESTS}))
def test_no_variable_is_called_by_an_empty_word(name: str) -> None:
    names = {defined for defined in _defined(_tree(ROOT / name)) if (name, defined) not in ON_DISK}
    assert {defined for defined in names if defined.strip("_").lower() in EMPTY_WORDS} == set()


@pytest.mark.parametrize("name", MODULES)
def test_no_retired_name_is_back(name: str) -> None:
    assert RETIRED & set(_defined(_tree(MODULES[name]))) == set()


@pytest.mark.parametrize("name", sorted({**MODULES, **PROGRAMS, **TESTS}))
def test_no_docstring_opens_with_an_empty_word(name: str) -> None:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    texts = [ast.get_docstring(node) or "" for node in ast.walk(_tree(ROOT / name)) if isinstance(node, kinds)]
    assert [text.splitlines()[0] for text in texts if text.startswith(("Of ", "By ", "What ", "Let "))] == []

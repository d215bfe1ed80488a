"""Names are the field's terms: no class name stands for two things, and no variable is called by an empty word."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator

from sitl_tests.architecture.sources import offences, python_files, tree_of

MODULES = python_files("companion", "mission_scripts")
ALL_FILES = [*MODULES, *python_files("tools", "sitl_tests")]

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


def _empty_words(name: str) -> set[str]:
    names = {defined for defined in _defined(tree_of(name)) if (name, defined) not in ON_DISK}
    return {defined for defined in names if defined.strip("_").lower() in EMPTY_WORDS}


def _empty_openings(name: str) -> list[str]:
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    texts = [ast.get_docstring(node) or "" for node in ast.walk(tree_of(name)) if isinstance(node, kinds)]
    return [text.splitlines()[0] for text in texts if text.startswith(("Of ", "By ", "What ", "Let "))]


def test_a_class_name_stands_for_one_thing() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for name in MODULES:
        if name.startswith("companion/"):
            for node in ast.walk(tree_of(name)):
                if isinstance(node, ast.ClassDef):
                    places[node.name].append(name)
    twice = {name: where for name, where in places.items() if len(where) > 1}
    assert twice == {}, "two classes of one name: name the new one by how it differs"


def test_no_variable_is_called_by_an_empty_word() -> None:
    assert offences(ALL_FILES, _empty_words) == {}, f"name the thing; these say nothing: {sorted(EMPTY_WORDS)}"


def test_no_retired_name_is_back() -> None:
    back = offences(MODULES, lambda name: RETIRED & set(_defined(tree_of(name))))
    assert back == {}, "private words that were given up: take the field's"


def test_no_docstring_opens_with_an_empty_word() -> None:
    openings = offences(ALL_FILES, _empty_openings)
    assert openings == {}, "open a docstring with a verb or with the thing, not with Of, By, What or Let"

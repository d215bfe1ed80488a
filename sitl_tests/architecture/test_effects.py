"""An effect is one class: its name stands nowhere else in the package, so that adding one changes no other file."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from companion.core.wing.effects import catalogue

PACKAGE = Path(__file__).resolve().parents[2] / "companion"
OWN_FILES = PACKAGE / "core" / "wing" / "effects"
# a name that is also an ordinary word may stand in a page's or a log's keys; it is no effect there
ORDINARY_WORDS = {name for name in catalogue() if "-" not in name}
ROOMS_THAT_KNOW_EFFECTS = ("core", "diagnosis", "sim")


def strings(path: Path) -> Iterator[tuple[int, str]]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


@pytest.mark.parametrize("room", sorted(path.name for path in PACKAGE.iterdir() if path.is_dir()))
def test_no_effect_s_name_stands_outside_its_own_class(room: str) -> None:
    names = set(catalogue()) - (set() if room in ROOMS_THAT_KNOW_EFFECTS else ORDINARY_WORDS)
    wrong = [
        f"{path.relative_to(PACKAGE)}:{line} {text}"
        for path in sorted((PACKAGE / room).rglob("*.py"))
        if OWN_FILES not in path.parents
        for line, text in strings(path)
        if text in names
    ]
    assert wrong == [], "an effect is found by being in its folder: ask its class, not its name"


def test_an_effect_s_name_stands_in_one_file_only() -> None:
    for name in catalogue():
        files = [path.name for path in OWN_FILES.rglob("*.py") if any(text == name for _, text in strings(path))]
        assert len(files) == 1, (name, files)


def test_the_page_of_effects_has_each_with_its_parameters_units_and_priors() -> None:
    page = (PACKAGE / "diagnosis" / "flights" / "EFFECTS.md").read_text(encoding="utf-8")
    catalogued = page.split("## Forms of an effect")[0]
    rows = {row.split("`")[1]: row for row in catalogued.splitlines() if row.startswith("| `")}
    assert set(rows) <= set(catalogue()), "rows of EFFECTS.md for effects that no file has"
    for name, kind in catalogue().items():
        law = " ".join((kind.__doc__ or "").partition("\n\n")[0].split()).replace("``", "`").replace("|", r"\|")
        declared = [f"`{p.name}` {p.sigma:g} {p.unit}".rstrip() for p in kind.parameters()]
        wanted = f"| `{name}` | {law} | {'; '.join(declared)} | where a fit begins, if not at 0 |"
        assert name in rows, f"companion/diagnosis/flights/EFFECTS.md needs a row, as: {wanted}"
        assert [entry for entry in declared if entry not in rows[name]] == [], f"EFFECTS.md; as: {wanted}"

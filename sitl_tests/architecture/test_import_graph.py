"""The graph of imports when modules are loaded: no circle anywhere, a diagnosis nine layers deep at most."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def _module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {_module_name(path): path for path in sorted((ROOT / "companion").rglob("*.py"))}


def _imported_modules(path: Path) -> set[str]:
    """Modules of ours that a file imports when it is loaded or checked; what a function imports later is no edge."""
    edges: set[str] = set()
    body = ast.parse(path.read_text()).body
    for node in [*body, *(inner for outer in body if isinstance(outer, ast.If) for inner in outer.body)]:
        if isinstance(node, ast.Import):
            edges |= {alias.name for alias in node.names if alias.name in FILES}
        elif isinstance(node, ast.ImportFrom) and node.module in FILES:
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            submodules = inner & FILES.keys()
            edges |= submodules or {node.module}
    return edges - {_module_name(path)}


GRAPH = {name: _imported_modules(path) for name, path in FILES.items()}


def test_no_module_imports_itself_by_a_detour() -> None:
    done: set[str] = set()

    def visit(name: str, trail: tuple[str, ...]) -> None:
        assert name not in trail, f"circle: {' -> '.join((*trail[trail.index(name) :], name))}"
        if name not in done:
            for other in GRAPH[name]:
                visit(other, (*trail, name))
            done.add(name)

    for name in GRAPH:
        visit(name, ())


def test_diagnosis_is_nine_layers_deep_at_most() -> None:
    room = "companion.diagnosis"
    chains: dict[str, tuple[str, ...]] = {}

    def chain(name: str) -> tuple[str, ...]:
        if name not in chains:
            below = [chain(other) for other in GRAPH[name] if other.startswith(room)]
            chains[name] = (name, *max(below, key=len, default=()))
        return chains[name]

    longest = max((chain(name) for name in GRAPH if name.startswith(room)), key=len)
    assert len(longest) <= 9, " -> ".join(longest)

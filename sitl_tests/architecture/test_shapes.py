"""Public functions of arrays state a shape in their docstrings, or override a method of ours whose docstring does."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from sitl_tests.architecture.sources import offences, python_files, tree_of

TREES = {name: tree_of(name) for name in python_files("companion")}

ARRAY = re.compile(r"\b(Floats|Floats32|Ints|Bools|Complexes|Array|NDArray|ndarray|Image|Images|ArrayLike)\b")
# (n,), (2, n), (5 + 4 (m - 1),), or a sentence about the shape
SHAPE = re.compile(
    r"\([\w.]+(?:\s*[-+*/]\s*(?:\w+|\([^()]*\))|\s\([^()]*\))*,(?:[^()]|\([^()]*\))*\)|\bshapes?\b", re.IGNORECASE
)


def _functions(tree: ast.Module | ast.ClassDef, prefix: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    """Public functions and methods by qualified name."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from _functions(node, f"{node.name}.")
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
            yield prefix + node.name, node


def _bases() -> dict[str, list[str]]:
    classes = (node for tree in TREES.values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef))
    return {node.name: [ast.unparse(base).partition("[")[0] for base in node.bases] for node in classes}


BASES = _bases()
DOCSTRINGS = {
    qualified: ast.get_docstring(node) or "" for tree in TREES.values() for qualified, node in _functions(tree)
}


def _of_arrays(node: ast.FunctionDef) -> bool:
    arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    annotations = [entry.annotation for entry in arguments] + [node.returns]
    return any(ARRAY.search(ast.unparse(entry)) for entry in annotations if entry is not None)


def _inherits_shape(qualified: str) -> bool:
    class_name, _, method = qualified.rpartition(".")
    above = [f"{base}.{method}" for base in BASES.get(class_name, ())]
    return any(SHAPE.search(DOCSTRINGS.get(name, "")) or _inherits_shape(name) for name in above)


def _without_shape(name: str) -> set[str]:
    functions = [(qualified, node) for qualified, node in _functions(TREES[name]) if _of_arrays(node)]
    return {
        qualified
        for qualified, node in functions
        if not SHAPE.search(ast.get_docstring(node) or "") and not _inherits_shape(qualified)
    }


def test_public_functions_of_arrays_state_shapes() -> None:
    silent = offences(TREES, _without_shape)
    assert silent == {}, "the docstring of a public function of arrays states their shapes: (n, 3), (c,)"

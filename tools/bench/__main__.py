"""Run the benches: ``python -m tools.bench [--publish] [name ...]``; without a name, all but ``world`` (hours).

``--publish`` also writes each print-out to ``results/`` and RESULTS.md anew from all of them. ``--help`` lists the
benches; ``python -m tools.bench NAME --help`` has the options of one.

A bench is a module of this package with ``main(arguments) -> int``; it prints its table and returns 1 where a target is
missed. Modules whose name has an underscore help others and are not benches.
"""

from __future__ import annotations

import ast
import importlib
import pkgutil
import sys
from pathlib import Path

import tools.bench
from companion.errors import SpanwiseError
from tools.bench import publish_results

_BY_NAME_ALONE = ("world",)  # 1,850 flights take hours


def names() -> list[str]:
    """The benches there are; accuracy, the longest, is last."""
    listed = [module.name for module in pkgutil.iter_modules(tools.bench.__path__) if "_" not in module.name]
    return sorted(listed, key=lambda name: (name == "accuracy", name))


def summary(name: str) -> str:
    """First paragraph of a bench's docstring, on one line."""
    text = ast.get_docstring(ast.parse((Path(__file__).parent / f"{name}.py").read_text(encoding="utf-8"))) or ""
    return " ".join(text.partition("\n\n")[0].split())


def main(arguments: list[str]) -> int:
    """Run the named benches; an argument that begins with a dash, and all after it, go to every one of them."""
    if arguments[:1] in (["-h"], ["--help"]):
        print(__doc__)
        print("\n".join(f"{name:16s} {summary(name)}" for name in names()))
        return 0
    publishing = "--publish" in arguments[:1]
    arguments = arguments[1:] if publishing else arguments
    options_at = next((i for i, word in enumerate(arguments) if word.startswith("-")), len(arguments))
    wanted, options = arguments[:options_at], arguments[options_at:]
    unknown = sorted(set(wanted) - set(names()))
    if unknown:
        print(f"no bench {', '.join(unknown)}; there are: {', '.join(names())}", file=sys.stderr)
        return 2
    missed = 0
    for name in wanted or [name for name in names() if name not in _BY_NAME_ALONE]:
        print(f"\n== {name}", flush=True)
        try:
            printout, code = publish_results.capture(name, options, importlib.import_module(f"tools.bench.{name}").main)
        except SpanwiseError as error:
            print(f"{name}: {error}", file=sys.stderr)
            missed = 1
            continue
        missed |= code
        if publishing:
            publish_results.write([printout])
    return missed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""Run the benches: ``python -m tools.bench [name ...]``; without a name, all of them, in order.

A bench is a module of this package with ``main(arguments) -> int``; it prints its table and returns 1 where a target is
missed. Modules whose name has an underscore help others and are not benches.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys

import tools.bench


def names() -> list[str]:
    """The benches there are; accuracy, the longest, is last."""
    found = [module.name for module in pkgutil.iter_modules(tools.bench.__path__) if "_" not in module.name]
    return sorted(found, key=lambda name: (name == "accuracy", name))


def main(arguments: list[str]) -> int:
    """Run the named benches; an argument that begins with a dash, and all after it, go to every one of them."""
    options_at = next((i for i, word in enumerate(arguments) if word.startswith("-")), len(arguments))
    wanted, options = arguments[:options_at], arguments[options_at:]
    known = names()
    unknown = [name for name in wanted if name not in known]
    if unknown:
        print(f"no bench {', '.join(unknown)}; there are: {', '.join(known)}", file=sys.stderr)
        return 2
    missed = 0
    for name in wanted or known:
        print(f"\n== {name}", flush=True)
        missed |= importlib.import_module(f"tools.bench.{name}").main(options)
    return missed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""The demo's tables: a simulated aircraft in lock-step with the service, judged by its truth (seed 1 unless told)."""

from __future__ import annotations

from companion.cli.main import main as spanwise


def main(arguments: list[str]) -> int:
    """Run ``spanwise demo`` with the arguments; 0 where it published ranges and met its targets."""
    return spanwise(["demo", *arguments])

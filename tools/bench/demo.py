"""Tables of ``make demo``: a minute in the world ``fair``, in lock-step with the service, judged by its truth."""

from __future__ import annotations

from companion.cli.main import main as spanwise


def main(arguments: list[str]) -> int:
    """Run ``spanwise demo --world fair`` with the arguments; 0 where it published ranges and met its targets."""
    return spanwise(["demo", "--world", "fair", *arguments])

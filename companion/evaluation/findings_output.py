"""Findings of a diagnosis to a terminal, as JSON and as a page, as the command line asks."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any


def write_findings(
    plain: dict[str, Any],
    json_target: str | None,
    html_target: str | None,
    tell: Callable[[dict[str, Any]], None],
    make_page: Callable[[], str],
) -> None:
    """Print the findings, or JSON alone where its target is ``-``; write the files that were asked for."""
    text = json.dumps(plain, indent=2, allow_nan=False)
    if json_target == "-":
        print(text)
    else:
        tell(plain)
        if json_target:
            Path(json_target).write_text(text + "\n", encoding="utf-8")
    if html_target:
        Path(html_target).write_text(make_page(), encoding="utf-8")
    files = [target for target in (json_target, html_target) if target]
    if files and json_target != "-":
        print(f"wrote {' and '.join(files)}")

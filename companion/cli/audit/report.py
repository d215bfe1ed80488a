"""All sections in order, and the three files of the report."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from companion.cli.audit import beam_tables, boom, equations, range_tables, wing_shapes
from companion.cli.audit.findings import Section
from companion.cli.audit.report_html import html
from companion.cli.audit.report_markdown import markdown


def make_sections() -> list[Section]:
    """Run the whole audit."""
    return [
        beam_tables.section(),
        range_tables.section(),
        equations.section(),
        boom.fig_4(),
        wing_shapes.section(),
        boom.figs_11_12(),
    ]


def plain(sections: Sequence[Section]) -> dict[str, Any]:
    """Every number by section, for JSON; what is not finite becomes null."""
    return {
        section.key: {"title": section.title, "findings": list(section.findings), **_finite(section.data)}
        for section in sections
    }


def write(sections: Sequence[Section], folder: Path) -> list[Path]:
    """Write ``report.html``, ``report.md`` and ``numbers.json``; give their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {
        "report.html": html(sections),
        "report.md": markdown(sections),
        "numbers.json": json.dumps(plain(sections), indent=1) + "\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in texts]


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value

"""The report as Markdown: findings and tables, no pictures."""

from __future__ import annotations

from collections.abc import Iterable

from companion.paper.findings import Section
from companion.reporting.blocks import Table

TITLE = "The paper, reproduced and audited"
SUBTITLE = (
    'Short, Lanier, Kochersberger, Abbott, "Modal-based camera correction for large baseline stereo imaging". '
    "Every number was computed in this run, by the code that flies; what the paper prints is quoted as printed."
)


def markdown(sections: Iterable[Section]) -> str:
    """The whole text."""
    lines = [f"# {TITLE}", "", SUBTITLE, ""]
    for section in sections:
        lines += [f"## {section.title}", ""]
        lines += [f"- {finding}" for finding in section.findings]
        for table in section.tables:
            lines += ["", *_table(table)]
        lines.append("")
    return "\n".join(lines)


def _table(table: Table) -> list[str]:
    lines = [f"**{table.title}**", "", _row(table.heads), _row(["---"] * len(table.heads))]
    lines += [_row(row) for row in table.rows]
    return [*lines, "", table.note] if table.note else lines


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

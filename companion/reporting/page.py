"""Pieces of a self-contained HTML page: head, tables, pictures inside the page."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from typing import Any

from companion.reporting.plotting import BLUE, GREY, VERMILLION

BEFORE, AFTER, DATA = VERMILLION, BLUE, GREY
COLOURS = {"adequate": "#2e7d4f", "explained": "#1f6fb4", "unexplained": "#b23b2e", "not-identifiable": "#8a6d1d"}
_STYLE = """
body{font:16px/1.5 system-ui,sans-serif;color:#20262d;max-width:1080px;margin:2rem auto;padding:0 1.2rem}
h1{font-size:1.4rem;line-height:1.35;color:#fff;padding:1rem 1.2rem;border-radius:8px;margin:0 0 .4rem}
h2{font-size:1.15rem;margin:2rem 0 .5rem;border-bottom:1px solid #d9dee3;padding-bottom:.2rem}
p.what{color:#5b6670;margin:.2rem 0 1rem}table{border-collapse:collapse;width:100%;font-size:.93rem}
th,td{text-align:left;padding:.35rem .6rem;border-bottom:1px solid #e6eaee}th{color:#5b6670;font-weight:600}
img{width:100%;margin:.3rem 0}
.advice{background:#f3f6f9;border-left:4px solid #1f6fb4;padding:.6rem .9rem;border-radius:4px;margin:.6rem 0}
.bad{color:#b23b2e;font-weight:600}tr.worst td{background:#fdeee6;font-weight:600}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.5rem 1.2rem;background:#f3f6f9}
dl{padding:1rem 1.2rem;border-radius:8px}
dt{color:#5b6670;font-weight:600}dd{margin:0}
"""


def page(verdict: str, headline: str, what: str, body: Sequence[str]) -> str:
    """A whole page: the verdict in its colour first."""
    return "\n".join(
        [
            f"<!doctype html><html lang=en><meta charset=utf-8><title>Diagnosis: {html.escape(verdict)}</title>",
            f"<style>{_STYLE}</style>",
            f'<h1 style="background:{COLOURS[verdict]}">{html.escape(headline[:1].upper() + headline[1:])}</h1>',
            paragraph(what),
            *body,
            "</html>",
            "",
        ]
    )


def heading(text: str) -> str:
    """A section's title."""
    return f"<h2>{html.escape(text)}</h2>"


def paragraph(text: str) -> str:
    """A sentence of explanation."""
    return f'<p class="what">{html.escape(text)}</p>'


def advice(text: str) -> str:
    """What to do."""
    return f'<p class="advice">{html.escape(text)}</p>'


def told(sentences: Sequence[tuple[str, str]]) -> str:
    """What a reader wants first: questions, each with its answer."""
    return "<dl>" + "".join(f"<dt>{html.escape(q)}</dt><dd>{html.escape(a)}</dd>" for q, a in sentences) + "</dl>"


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], worst: int | None = None) -> str:
    """A table; a cell that says ``failed`` is marked, and the row with the index ``worst`` stands out."""
    top = "".join(f"<th>{html.escape(head)}</th>" for head in heads)
    lines = []
    for index, row in enumerate(rows):
        cells = [('<td class="bad">' if cell == "failed" else "<td>") + html.escape(cell) + "</td>" for cell in row]
        lines.append(("<tr class=worst>" if index == worst else "<tr>") + "".join(cells) + "</tr>")
    return f"<table><tr>{top}</tr>{''.join(lines)}</table>"


def picture(figure: Any, text: str) -> str:
    """A matplotlib figure, inside the page; ``text`` for those who cannot see it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130)
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<img alt="{html.escape(text)}" src="data:image/png;base64,{data}">'

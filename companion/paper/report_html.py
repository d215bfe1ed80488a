"""The report as one HTML file that needs nothing else: no script, no font, no picture from anywhere."""

from __future__ import annotations

import re
from collections.abc import Sequence

from companion.paper.findings import Section
from companion.paper.report_markdown import SUBTITLE, TITLE
from companion.reporting.blocks import Block, Findings, Heading, Page
from companion.reporting.embedding import embed_image
from companion.reporting.page import render

_POINTS_PER_IN = 72.0  # by definition
_SYMBOLS = (
    (r"\bbeta\*l\b", "βl"),
    (r"\bomega_([123])\b", lambda match: "ω" + "₁₂₃"[int(match[1]) - 1]),
    (r"\bomega\b", "ω"),
    (r"\btheta(?=_|\b)", "θ"),
    (r"\bOmega(?=_|\b)", "Ω"),
    (r"\bmu\b", "μ"),
    (r"\brho\b", "ρ"),
    (r"\bzeta\b", "ζ"),
    (r"\^([234])", lambda match: "²³⁴"[int(match[1]) - 2]),
    (r"\^T", "ᵀ"),
    (r"-&gt;", "→"),
    (r"(?<=\d) (?=(?:%|m|mm|Hz|mrad|kg|px|s|±)(?:\W|$))", "\u00a0"),
    (r"± (?=\d)", "±\u00a0"),
    (r"(?<=\d)e([+-]?)0*(\d+)(?=\D|$)", lambda match: f"·10<sup>{'−' if match[1] == '-' else ''}{match[2]}</sup>"),
    (r"(?<![\w.)])-(?=[\d.])", "−"),
)


def html(sections: Sequence[Section]) -> str:
    """Whole report as one page with a table of contents."""
    body = [block for section in sections for block in _blocks(section)]
    return render(Page(title=TITLE, headline=TITLE, body=body, subject=SUBTITLE, contents=True), with_symbols)


def with_symbols(escaped: str) -> str:
    """Escaped text with the symbols that plain text spells out: Greek letters, powers, minus signs, close units."""
    for pattern, symbol in _SYMBOLS:
        escaped = re.sub(pattern, symbol, escaped)
    return escaped


def _width_in(svg: str) -> float:
    """Width of a drawing, as matplotlib states it in points; 0 for one that has none."""
    width = re.search(r'<svg[^>]* width="([\d.]+)pt"', svg)
    return float(width[1]) / _POINTS_PER_IN if width else 0.0


def _blocks(section: Section) -> list[Block]:
    return [
        Heading(section.title, key=section.key),
        Findings(section.findings),
        *[
            embed_image(picture.svg.encode(), "svg+xml", picture.title, picture.title, _width_in(picture.svg))
            for picture in section.pictures
        ],
        *section.tables,
    ]

"""The report as one HTML file that needs nothing else: no script, no font, no picture from anywhere."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from html import escape

from companion.paper.findings import Picture, Section, Table
from companion.paper.report_markdown import SUBTITLE, TITLE

_STYLE = """
:root { --ink: #1c2733; --soft: #5b6875; --line: #d9dfe5; --tint: #f5f7f9; --mark: #2166ac; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #fff; font: 16px/1.55 system-ui, "Segoe UI", sans-serif; }
main { max-width: 66rem; margin: 0 auto; padding: 2.5rem 1.5rem 5rem; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 .5rem; }
h2 { font-size: 1.35rem; margin: 3.2rem 0 .8rem; padding-top: 1rem; border-top: 2px solid var(--ink); }
h3 { font-size: 1rem; margin: 1.8rem 0 .4rem; }
p.sub, p.note { color: var(--soft); max-width: 48rem; }
p.note { font-size: .87rem; margin: .4rem 0 0; }
nav { margin: 1.6rem 0 0; padding: 1rem 1.2rem; background: var(--tint); border-radius: 6px; }
nav ol { margin: 0; padding-left: 1.3rem; columns: 2; column-gap: 2.5rem; font-size: .93rem; }
a { color: var(--mark); text-decoration: none; } a:hover { text-decoration: underline; }
ul.findings { padding-left: 1.2rem; max-width: 54rem; } ul.findings li { margin: .35rem 0; }
ul.findings li:first-child { font-weight: 600; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .87rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .32rem .8rem .32rem 0; border-bottom: 1px solid var(--line); }
sup { line-height: 0; font-size: .72em; }
th.n, td.n { text-align: right; }
th { color: var(--soft); font-weight: 600; border-bottom: 1.5px solid var(--ink); vertical-align: bottom; }
figure { margin: 1.6rem 0 0; } figure img { width: 100%; height: auto; display: block; }
figcaption { font-size: .87rem; color: var(--soft); margin-top: .3rem; }
@media (max-width: 44rem) { nav ol { columns: 1; } main { padding: 1.5rem 1rem; } }
@media print { nav { display: none; } h2 { break-after: avoid; } table, figure { break-inside: avoid; } }
"""


_SYMBOLS = (
    (r"\bbeta\*l\b", "βl"),
    (r"\bomega_([123])\b", lambda found: "ω" + "₁₂₃"[int(found[1]) - 1]),
    (r"\bomega\b", "ω"),
    (r"\btheta(?=_|\b)", "θ"),
    (r"\bOmega(?=_|\b)", "Ω"),
    (r"\bmu\b", "μ"),
    (r"\brho\b", "ρ"),
    (r"\bzeta\b", "ζ"),
    (r"\^([234])", lambda found: "²³⁴"[int(found[1]) - 2]),
    (r"\^T", "ᵀ"),
    (r"-&gt;", "→"),
    (r"(?<=\d) (?=(?:%|m|mm|Hz|mrad|kg|px|s|±)(?:\W|$))", "\u00a0"),
    (r"± (?=\d)", "±\u00a0"),
    (r"(?<=\d)e([+-]?)0*(\d+)(?=\D|$)", lambda found: f"·10<sup>{'−' if found[1] == '-' else ''}{found[2]}</sup>"),
    (r"(?<![\w.)])-(?=[\d.])", "−"),
)
_NUMERIC = re.compile(r"[−~>±·\d.,/%+\s()→a-z]*\d[−~>±·\d.,/%+\s()→]*(<sup>.*</sup>)?\s*(%|m|mm|mrad|px)?|-|")


def html(sections: Sequence[Section]) -> str:
    """The whole document."""
    links = "".join(f'<li><a href="#{escape(s.key)}">{escape(s.title)}</a></li>' for s in sections)
    body = "\n".join(_section(section) for section in sections)
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{TITLE}</title>'
        f'<meta name="viewport" content="width=device-width, initial-scale=1"><style>{_STYLE}</style></head>\n'
        f'<body><main><h1>{TITLE}</h1><p class="sub">{escape(SUBTITLE)}</p><nav><ol>{links}</ol></nav>\n'
        f"{body}\n</main></body></html>\n"
    )


def _text(plain: str) -> str:
    """Escaped, with the symbols that plain text spells out."""
    text = escape(plain, quote=False)
    for pattern, symbol in _SYMBOLS:
        text = re.sub(pattern, symbol, text)
    return text


def _section(section: Section) -> str:
    findings = "".join(f"<li>{_text(finding)}</li>" for finding in section.findings)
    parts = [
        f'<section id="{escape(section.key)}"><h2>{escape(section.title)}</h2><ul class="findings">{findings}</ul>'
    ]
    parts += [_picture(picture) for picture in section.pictures]
    parts += [_table(table) for table in section.tables]
    return "\n".join([*parts, "</section>"])


def _table(table: Table) -> str:
    columns = list(zip(*table.rows, strict=True))
    numeric = [all(_NUMERIC.fullmatch(_text(cell)) for cell in column) for column in columns]
    numeric[0] &= not any(re.search("[A-Za-z]{2}", cell) for cell in columns[0])  # names, though they end in numbers
    head = _row("th", table.header, numeric)
    rows = "".join(_row("td", row, numeric) for row in table.rows)
    note = f'<p class="note">{_text(table.note)}</p>' if table.note else ""
    return (
        f'<h3>{_text(table.title)}</h3><div class="wide"><table><thead>{head}</thead>'
        f"<tbody>{rows}</tbody></table></div>{note}"
    )


def _row(tag: str, cells: Sequence[str], numeric: Sequence[bool]) -> str:
    """Numbers stand at the right, so that they can be compared."""
    marked = zip(cells, numeric, strict=True)
    return (
        "<tr>"
        + "".join(f"<{tag}{' class=n' if right else ''}>{_text(cell)}</{tag}>" for cell, right in marked)
        + "</tr>"
    )


def _picture(picture: Picture) -> str:
    data = base64.b64encode(picture.svg.encode()).decode()
    return (
        f'<figure><img alt="{escape(picture.title)}" src="data:image/svg+xml;base64,{data}">'
        f"<figcaption>{_text(picture.title)}</figcaption></figure>"
    )

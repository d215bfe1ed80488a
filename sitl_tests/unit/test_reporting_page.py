"""Pages of every report: one template and one style sheet, nothing external, all text escaped."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import numpy as np
import pytest

from companion.reporting.blocks import (
    Advice,
    Answers,
    Block,
    Details,
    Findings,
    Heading,
    Page,
    Paragraph,
    Picture,
    Table,
)
from companion.reporting.embedding import embed, embed_image
from companion.reporting.page import numeric_columns, render
from companion.reporting.plotting import new_figure

PACKAGE = Path(__file__).resolve().parents[2] / "companion"
HOSTILE = '<script>alert("&")</script>'
EVERY_BLOCK: list[Block] = [
    Heading(HOSTILE, key="first"),
    Paragraph(HOSTILE),
    Advice(HOSTILE),
    Findings([HOSTILE]),
    Answers([(HOSTILE, HOSTILE)]),
    Picture("data:image/png;base64,", HOSTILE, HOSTILE),
    Table([HOSTILE], [[HOSTILE]], title=HOSTILE, note=HOSTILE),
    Details(HOSTILE, Table([HOSTILE], [[HOSTILE]])),
]


@pytest.mark.parametrize("block", EVERY_BLOCK, ids=lambda block: block.kind)
def test_the_text_of_every_block_is_escaped(block: Block) -> None:
    text = render(Page(HOSTILE, HOSTILE, [block], subject=HOSTILE, contents=True))
    assert "<script" not in text
    assert text.count("&lt;script&gt;") >= 4


def test_a_page_is_one_file_with_nothing_external() -> None:
    text = render(Page("title", "headline", EVERY_BLOCK, grade="explained"))
    assert not re.search(r"https?:|url\(|@import|<link|<script", text)
    assert text.count("<style>") == 1
    assert '<h1 class="verdict explained">Headline</h1>' in text


def test_a_row_and_a_cell_that_went_wrong_stand_out() -> None:
    text = render(
        Page("t", "h", [Table(["test", "z", ""], [["a", "+1.0", "passed"], ["b", "+9.0", "failed"]], worst=1)])
    )
    rows = text.split("<tr")[2:]
    assert ['class="worst"' in row for row in rows] == [False, True]
    assert '<td class="bad">failed</td>' in rows[1]
    assert 'class="worst"' not in render(Page("t", "h", [Table(["a"], [["b"]])]))


@pytest.mark.parametrize(
    ("cells", "numeric"),
    [
        (("1.5 ± 0.2", "-3", "–"), True),
        (("12 → 3 %", "0.5 to 0.7 Hz"), True),
        (("1e-05", "infinite", "4"), True),
        (("passed", "failed"), False),
        (("sensor-filter", "tone"), False),
        (("–", "-"), False),
    ],
)
def test_columns_of_figures_are_set_right(cells: tuple[str, ...], numeric: bool) -> None:
    table = Table(["name", "value"], [["run 1", cell] for cell in cells])
    assert numeric_columns(table) == [False, numeric]


def test_a_table_without_rows_has_its_heads() -> None:
    assert "<th>a</th>" in render(Page("t", "h", [Table(["a", "b"], [])]))


def test_a_figure_states_the_width_that_its_lettering_needs_and_a_photograph_none() -> None:
    figure = render(Page("t", "h", [embed(new_figure(11, 2), "a figure")]))
    assert 'style="--readable: 880px"' in figure
    assert "style=" not in render(Page("t", "h", [embed_image(b"", "jpeg", "a view")]))


def test_a_figure_becomes_an_image_inside_the_page() -> None:
    figure = new_figure(3, 2)
    figure.subplots().plot(np.arange(3.0))
    picture = embed(figure, "a line", "its caption")
    assert picture.source.startswith("data:image/png;base64,iVBOR")
    assert "<figcaption>its caption</figcaption>" in render(Page("t", "h", [picture]))


@pytest.mark.parametrize("path", sorted(PACKAGE.rglob("*.py")), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_module_spells_html_itself(path: Path) -> None:
    tags = re.compile(r"</?(?:html|head|body|h[1-3]|p|table|t[rdh]|img|span|div|style|ul|li|figure|dl|details)[ >]")
    wrong = [
        f"{path.name}:{node.lineno}"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and tags.search(node.value)
    ]
    assert not wrong

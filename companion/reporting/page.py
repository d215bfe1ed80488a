"""Rendering of a page to one HTML file that needs nothing else: no script, no font, no picture from anywhere."""

from __future__ import annotations

import html
import re
from collections.abc import Callable
from importlib.resources import files
from typing import Any

from companion.errors import import_extra
from companion.reporting.blocks import Page, Table

_TEMPLATES = "templates"
# figures with sign, bound, range, sigma and unit: what a reader compares down a column
_WORDS = re.compile(r"(?<![^\W\d_])(?:e|to|of|m|mm|m/s²|mrad|rad|px|nat|Hz|s|ms|dB|infinite)(?![^\W\d_])")
_FIGURES = re.compile(r"[\d.,+\-−–~<>≤≥±()/→∞%°\s]*")
_NAME = re.compile("[A-Za-z]{2}")

Typeset = Callable[[str], str]


def render(page: Page, typeset: Typeset | None = None) -> str:
    """HTML text of a page.

    The templates escape all texts; ``typeset`` turns escaped text into HTML with symbols, without it escaped text
    stands as it is.

    Raises
    ------
    MissingExtra
        The extra ``report`` is not installed.
    """
    template = _environment(typeset).get_template("page.html.j2")
    return printable(str(template.render(page=page)))


def printable(text: str) -> str:
    r"""The text with what UTF-8 cannot hold spelled out (``\udcff``): names of files may be of any bytes."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def capitalised(text: str) -> str:
    """The text with a capital first letter; the others stay as they are."""
    return text[:1].upper() + text[1:]


def numeric_columns(table: Table) -> list[bool]:
    """Whether each column of a table holds figures alone; names in the first column count as text, digits or not."""
    columns = list(zip(*table.rows, strict=True)) or [()] * len(table.heads)
    return [
        any(re.search(r"\d", cell) for cell in column)
        and all(_FIGURES.fullmatch(_WORDS.sub("", cell)) for cell in column)
        and not (k == 0 and any(_NAME.search(cell) for cell in column))
        for k, column in enumerate(columns)
    ]


def _environment(typeset: Typeset | None) -> Any:
    jinja2 = import_extra("jinja2", "pages", "report")
    markup = import_extra("markupsafe", "pages", "report").Markup
    loader = jinja2.PackageLoader("companion.reporting", _TEMPLATES)
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined)
    symbols = typeset or str
    environment.filters["typeset"] = lambda text: markup(symbols(html.escape(str(text), quote=False)))
    environment.filters["capitalised"] = capitalised
    environment.filters["numeric_columns"] = numeric_columns
    style = (files("companion.reporting") / _TEMPLATES / "style.css").read_text(encoding="utf-8")
    environment.globals["style"] = markup(style)
    return environment

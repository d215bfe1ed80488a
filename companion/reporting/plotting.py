"""Style that all pictures share: colours that the colour-blind tell apart, gaps that stay gaps, the headline figure."""

from __future__ import annotations

import textwrap
from typing import Any

import numpy as np

from companion.errors import import_extra
from companion.records import Floats

# Okabe and Ito's palette, in which any two differ for every kind of colour vision, and in lightness
BLUE, VERMILLION, ORANGE, GREEN, SKY, PURPLE = "#0072B2", "#D55E00", "#E69F00", "#009E73", "#56B4E9", "#CC79A7"
GREY, INK, PALE = "#7F868D", "#20262D", "#D9DEE3"
BEFORE, AFTER, DATA = VERMILLION, BLUE, GREY  # a model before and after a cause is named, and the recording

_LETTERS_PER_IN = 11.0  # of a title of 12.5 points in matplotlib's own typeface; measured on a rendered figure
_GAP_RATIO = 3.0  # usual steps; a convention
_REPORT_LIBRARIES = ("matplotlib", "jinja2", "rich")


def require_report() -> None:
    """Refuse a command that ends in pages or pictures, before its work.

    Raises
    ------
    MissingExtra
        The extra ``report`` is not installed.
    """
    for library in _REPORT_LIBRARIES:
        import_extra(library, "pages and pictures", "report")


def new_figure(width_in: float, height_in: float) -> Any:
    """Empty matplotlib figure, laid out by its constrained engine; the library is imported here, not with the module.

    Raises
    ------
    MissingExtra
        The extra ``report`` is not installed.
    """
    return import_extra("matplotlib.figure", "pictures", "report").Figure(
        figsize=(width_in, height_in), layout="constrained"
    )


def panels(height_in: float, columns: int, width_in: float = 11.0, **shared: bool) -> tuple[Any, Any]:
    """Figure of axes side by side with a faint grid, and the axes; ``shared`` as matplotlib's sharex and sharey."""
    figure = new_figure(width_in, height_in)
    axes = np.atleast_1d(figure.subplots(1, columns, **shared))
    for axis in axes:
        axis.grid(alpha=0.3)
    return figure, axes


def with_gaps(t_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """A line's points (n,) with a break wherever the next is more than three usual steps away."""
    if len(t_s) < 3:
        return t_s, values
    steps = np.diff(t_s)
    breaks = np.flatnonzero(steps > _GAP_RATIO * float(np.median(steps))) + 1
    return np.insert(t_s, breaks, np.nan), np.insert(values, breaks, np.nan)


def dots(axis: Any, x: Floats, y: Floats, sigma: Floats, colour: str, label: str | None = None) -> None:
    """Points (n,) with thin bars of one sigma, which do not hide one another."""
    axis.errorbar(x, y, sigma, fmt=".", ms=3.5, color=colour, ecolor=colour, elinewidth=0.5, alpha=0.8, label=label)


def headline(figure: Any, text: str, what: str = "") -> None:
    """The figure that counts, above the picture; ``what`` stands smaller beneath it."""
    letters = int(_LETTERS_PER_IN * figure.get_figwidth())
    lines = [line for block in (text, what) for row in block.split("\n") for line in textwrap.wrap(row, letters)]
    figure.suptitle("\n".join(lines), fontsize=12.5, x=0.01, ha="left", color=INK)

"""Plots as the text of an SVG, all in one style."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

from companion.paper.findings import SectionPicture
from companion.reporting.plotting import BLUE, GREEN, GREY, ORANGE, VERMILLION, headline

__all__ = ["BLUE", "GREEN", "GREY", "ORANGE", "RED", "draw"]

RED = VERMILLION
_STYLE = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e7eb",
    "grid.linewidth": 0.7,
    "axes.edgecolor": "#5b6875",
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "legend.frameon": False,
    "legend.fontsize": 8,
    "svg.hashsalt": "spanwise",
}


def draw(
    title: str, rows: int, columns: int, paint: Callable[[Any], None], height_in: float = 3.2, *, said: str
) -> SectionPicture:
    """Figure of ``rows`` x ``columns`` axes, which ``paint`` fills; it is given the array of axes.

    ``said`` is the number that counts, in a sentence: it is written on the picture, which is seen without its caption.
    Lines of many points are drawn as pixels where ``paint`` rasterizes them, so that the file stays small.
    """
    import matplotlib as mpl  # takes most of a second to import
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(9.5, height_in * rows), layout="constrained", dpi=110)
        FigureCanvasSVG(figure)
        paint(figure.subplots(rows, columns, squeeze=False))
        headline(figure, said)
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None})
    return SectionPicture(title, text.getvalue())

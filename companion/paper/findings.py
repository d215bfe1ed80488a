"""Contents of an audit section: sentences, tables, pictures, and the numbers behind them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from companion.reporting.blocks import Table

_AS_FACTOR = 100.0  # convention: a ratio beyond it reads better as a factor than in percent


@dataclass(frozen=True, slots=True)
class SectionPicture:
    """A drawn figure as the text of an SVG."""

    title: str
    svg: str


@dataclass(frozen=True, slots=True)
class Section:
    """One part of the report.

    ``key`` is its name in the JSON and its anchor in the HTML; ``findings`` are sentences, the most important first;
    ``data`` holds every number, in plain JSON types.
    """

    key: str
    title: str
    findings: tuple[str, ...]
    tables: Sequence[Table] = ()
    pictures: tuple[SectionPicture, ...] = ()
    data: dict[str, Any] = field(default_factory=dict)


def number(value: float | None, digits: int = 4) -> str:
    """Significant digits, without an exponent where a person would not write one; a dash for nothing."""
    if value is None or not math.isfinite(value):
        return "-" if value is None or math.isnan(value) else "infinite"
    if value == 0.0:
        return "0"
    power = math.floor(math.log10(abs(value)))
    if not -4 <= power <= 6:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(digits - 1 - power, 0)}f}"


def percent(ratio: float | None, digits: int = 2) -> str:
    """A share as a percentage; beyond a hundredfold as a factor, which says more."""
    if ratio is None or not math.isfinite(ratio):
        return "-"
    if ratio > _AS_FACTOR:
        return f"factor {number(1.0 + ratio, 2)}"
    return f"{round(100.0 * ratio, digits) + 0.0:.{digits}f}\u00a0%"


def deviation(computed: float, printed: float) -> float:
    """Relative deviation from the printed figure."""
    return computed / printed - 1.0

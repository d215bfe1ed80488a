"""The fleet's page: what could not be read, which aircraft's mode drifts, which sensor ages, and every flight."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from companion.evaluation.fleet.trends import findings
from companion.reporting import page, plotting
from companion.reporting.blocks import Block, Findings, Heading, Page, Table
from companion.reporting.embedding import embed

_FEWEST = 3  # points that make a picture
_COLORS = (plotting.BLUE, plotting.VERMILLION, plotting.GREEN, plotting.ORANGE, plotting.PURPLE, plotting.SKY)
_MOST_COLUMNS = 8  # that a page is wide enough for
_MOST_RECURRING = 12  # most frequent first
_COUNTED = ("withheld: ", "effect: ", "proposed: ")  # columns that most rows lack: what recurs is counted by them
_NOTHING = "nothing drifts, recurs or leaves its aircraft's median by three sigma"
_PLACES = ("file", "page", "code")
_SHARED = ("verdict", "reason", "result")  # texts that several files may have in common

Rows = Sequence[Mapping[str, Any]]


def render(kind: str, rows: Rows) -> str:
    """The page as HTML."""
    failed = [row for row in rows if row.get("failed")]
    good = [row for row in rows if not row.get("failed")]
    aircraft = {row["airframe"] for row in good if row.get("airframe")}
    headline = f"{len(good)} of {len(rows)} files give a result"
    headline += f", {len(aircraft)} airframe{'s' if len(aircraft) > 1 else ''}" if aircraft else ""
    grade = "adequate" if not failed else "fair"
    return page.render(Page(f"Fleet: {kind}", headline, list(_body(good, failed)), subject=kind, grade=grade))


def _body(good: Rows, failed: Rows) -> Iterator[Block]:
    yield Findings(findings(good) or [_NOTHING])
    yield from _frequencies(good)
    if failed:
        yield Heading("Files without a result")
        yield Table(("file", "why"), [(Path(str(row["file"])).name, str(row["failed"])) for row in failed])
    recurring = _recurring(good)
    if recurring:
        yield Heading("What recurs")
        yield Table(("what", "files"), [(text, str(count)) for text, count in recurring])
    yield Heading("Every file")
    columns = [name for name in dict.fromkeys(name for row in good for name in row) if name not in _PLACES]
    shown = [name for name in columns if not name.startswith(_COUNTED)][:_MOST_COLUMNS]
    cells = [(Path(str(row["file"])).name, *(_cell(row.get(name)) for name in shown)) for row in good]
    links = [str(row.get("page", "")) for row in good]
    yield Table(("file", *shown), cells, note="all columns are in fleet.csv and fleet.parquet", links=links)


def _frequencies(rows: Rows) -> Iterator[Block]:
    """Frequency of each aircraft's first mode over its flights, in the order of their names."""
    tracked = [row for row in rows if row.get("airframe") and row.get("symmetric_hz") is not None]
    if len(tracked) < _FEWEST:
        return
    figure = plotting.new_figure(10.0, 3.2)
    axes = figure.subplots()
    for name, color in zip(sorted({row["airframe"] for row in tracked}), itertools.cycle(_COLORS), strict=False):
        flights = [(place, row) for place, row in enumerate(tracked) if row["airframe"] == name]
        places, values = [place for place, _ in flights], [row["symmetric_hz"] for _, row in flights]
        sigmas = [row["symmetric_sigma_hz"] for _, row in flights]
        axes.errorbar(places, values, sigmas, fmt="o", color=color, ms=4, label=name)
    axes.set(xlabel="flight", ylabel="symmetric mode, Hz")
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.legend(frameon=False)
    yield Heading("First symmetric mode")
    yield embed(figure, "frequency of the first symmetric mode by flight, with sigma")


def _recurring(rows: Rows) -> list[tuple[str, int]]:
    """Reasons and words that several files share."""
    counts: Counter[str] = Counter()
    for row in rows:
        words = {name for name, value in row.items() if name.startswith(_COUNTED) and value is not None}
        words |= {f"{name}: {row[name]}" for name in _SHARED if row.get(name)}
        counts.update(words)
    return [(text, count) for text, count in counts.most_common(_MOST_RECURRING) if count > 1]


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)

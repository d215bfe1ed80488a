"""The fleet's page: what could not be read, which aircraft's mode drifts, which sensor ages, and every flight."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from companion.evaluation.fleet.file_task import reason_alone
from companion.evaluation.fleet.trends import sentences
from companion.reporting import page, plotting
from companion.reporting.blocks import Block, Findings, Heading, Page, Table
from companion.reporting.embedding import embed

_FEWEST = 3  # points that make a picture (choice)
_COLORS = (plotting.BLUE, plotting.VERMILLION, plotting.GREEN, plotting.ORANGE, plotting.PURPLE, plotting.SKY)
_MOST_COLUMNS = 8  # chosen: that a page is wide enough for
_MOST_RECURRING = 12  # chosen: most frequent first: a list that is read
_MOST_NAMES = 16  # beneath a picture of 10 inches (choice)
_MOST_LETTERS = 18  # of a file's name there: the end of it, which tells flights apart (choice)
_WITHHELD = "withheld: "
_NOW_AND_THEN = "that a range is withheld now and then is normal: see the report of each flight"
_COUNTED = (_WITHHELD, "effect: ", "proposed: ")  # columns that most rows lack: what recurs is counted by them
_PLACES = ("file", "page", "code", "cut", "incomplete", "failed")
_SHARED = ("verdict", "reason", "result")  # texts that several files may have in common
_NORMAL = ("usable", "adequate")  # verdicts that are no news, however often they come
_SUBJECTS = {
    "report": "each flight's ranges, modes and sensors, by its own records (spanwise fleet report)",
    "diagnose": "what the wing's model gets wrong on each flight (spanwise fleet diagnose)",
    "identify": "the wing's modes on each flight (spanwise fleet identify)",
    "tune": "parameter values proposed from each flight (spanwise fleet tune)",
}
_HEADS = {
    "duration_s": "length,\N{NO-BREAK SPACE}s",
    "published": "ranges published",
    "sigma_ratio": "sigma, % of range",
    "sigma_ratio_then": "sigma then, % of range",
    "tracked_ratio": "wing tracked, % of time",
    "active_ratio": "service active, % of time",
    "symmetric_damping": "symmetric damping of critical",
    "antisymmetric_damping": "antisymmetric damping of critical",
}
_UNITS = {"hz": "Hz", "s": "s", "m": "m", "nat": "nat", "ratio": "%"}  # that end a column's name

Rows = Sequence[Mapping[str, Any]]


def render(kind: str, rows: Rows) -> str:
    """The page as HTML."""
    good = [row for row in rows if not row.get("failed")]
    cut = sum(bool(row.get("cut")) for row in good)
    aircraft = {row["airframe"] for row in good if row.get("airframe")}
    headline = f"{len(good)} of {len(rows)} files give a result"
    headline += f" ({cut} of them cut off)" if cut else ""
    headline += f", {len(aircraft)} airframe{'s' if len(aircraft) > 1 else ''}" if aircraft else ""
    grade = "good" if len(good) == len(rows) and not cut else "fair"
    title, subject = f"Fleet: {kind}", _SUBJECTS.get(kind, kind)
    return page.render(Page(title, headline, list(_body(rows, good)), subject=subject, grade=grade))


def _body(rows: Rows, good: Rows) -> Iterator[Block]:
    said = sentences(good)
    if said:
        yield Findings(said)
    yield from _frequencies(good)
    failed = [row for row in rows if row.get("failed")]
    if failed:
        yield Heading("Files without a result")
        yield Table(("file", "why"), [(_name(row), reason_alone(row["file"], str(row["failed"]))) for row in failed])
    recurring = _recurring(good)
    if recurring:
        yield Heading("In more than one file")
        counted = [(text, f"{count} of {len(good)}") for text, count in recurring]
        withheld = any(text.startswith(_WITHHELD) for text, _ in recurring)
        yield Table(("what", "files"), counted, note=_NOW_AND_THEN if withheld else "")
    yield Heading("Every file")
    columns = [name for name in dict.fromkeys(name for row in good for name in row) if name not in _PLACES]
    shown = [name for name in columns if not name.startswith(_COUNTED)][:_MOST_COLUMNS]
    cells = [(_name(row), _state(row), *(_cell(name, row.get(name)) for name in shown)) for row in rows]
    links = [quote(str(row.get("page", ""))) for row in rows]
    heads = ("file", "state", *map(_head, shown))
    yield Table(heads, cells, note="all columns are in fleet.csv and fleet.parquet", links=links)


def _name(row: Mapping[str, Any]) -> str:
    return Path(str(row["file"])).name


def _state(row: Mapping[str, Any]) -> str:
    return next((state for state in ("failed", "cut", "incomplete") if row.get(state)), "read")


def _frequencies(rows: Rows) -> Iterator[Block]:
    """Frequency of each aircraft's first mode over its flights, in the order of their names."""
    tracked = [row for row in rows if row.get("airframe") and row.get("symmetric_hz") is not None]
    if len(tracked) < _FEWEST:
        return
    figure = plotting.new_figure(10.0, 3.6)
    axes = figure.subplots()
    for name, color in zip(sorted({row["airframe"] for row in tracked}), itertools.cycle(_COLORS), strict=False):
        flights = [(place, row) for place, row in enumerate(tracked) if row["airframe"] == name]
        places, values = [place for place, _ in flights], [row["symmetric_hz"] for _, row in flights]
        sigmas = [row["symmetric_sigma_hz"] for _, row in flights]
        axes.errorbar(places, values, sigmas, fmt="o", color=color, ms=4, label=name)
    axes.set(ylabel="symmetric mode, Hz")
    labelled = range(0, len(tracked), -(-len(tracked) // _MOST_NAMES))
    axes.set_xticks(labelled, [short_name(tracked[place]["file"]) for place in labelled], rotation=30, ha="right")
    figure.legend(loc="outside upper right", ncols=len(_COLORS), frameon=False)  # beside the bars, never over them
    yield Heading("First symmetric mode")
    yield embed(figure, "frequency of the first symmetric mode by flight, with sigma")


def short_name(file: str) -> str:
    """Name of a file without its ending, of a long name the last letters."""
    stem = Path(file).stem
    return stem if len(stem) <= _MOST_LETTERS else f"…{stem[1 - _MOST_LETTERS :]}"


def _recurring(rows: Rows) -> list[tuple[str, int]]:
    """Reasons and words that several files share, without the verdicts of a good file."""
    counts: Counter[str] = Counter()
    for row in rows:
        words = {name for name, value in row.items() if name.startswith(_COUNTED) and value is not None}
        words |= {f"{name}: {row[name]}" for name in _SHARED if row.get(name) and row[name] not in _NORMAL}
        counts.update(sorted(words))  # equal counts come in the same order in every run
    return [(text, count) for text, count in counts.most_common(_MOST_RECURRING) if count > 1]


def _head(name: str) -> str:
    """Column's name in words, with its unit."""
    stem, _, unit = name.rpartition("_")
    words = f"{stem},\N{NO-BREAK SPACE}{_UNITS[unit]}" if stem and unit in _UNITS else name
    return _HEADS.get(name, words.replace("_", " "))


def _cell(name: str, value: Any) -> str:
    if isinstance(value, float):
        return f"{100.0 * value if '_ratio' in name else value:.4g}"
    return "" if value is None else str(value)

"""README.txt in a folder of converted tables: which file holds what, and every column with its unit."""

from __future__ import annotations

import inspect
import itertools
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from companion.adapters.recordings.recording import Recording
from companion.adapters.recordings.tables.record_tables import POINTS, RecordTables
from companion.adapters.recordings.tables.units import unit_of

README = "README.txt"
_FIRST_WORDS = "CSV tables that spanwise convert wrote"
_WIDTH = 100  # chosen: letters of a line that a terminal shows whole
_UNITS = {"hz": "Hz", "mps": "m/s", "mps2": "m/s^2", "radps": "rad/s", "count": ""}  # as they are written
_TIED = "\N{NO-BREAK SPACE}"  # between a name and its unit, which stay on a line
_FEW = 3  # chosen: entries of an array that are listed before the rest is counted
_GENERAL = """\
Columns are the attributes of a record. name_0, name_1 are the entries of an array (of a matrix row by row), name.part
is an entry of a nested record, an empty cell is a value that was absent, an array of more than 64 entries is one cell.

Columns that end in _host_ns are nanoseconds of the companion's own clock, which counts from its start. Samples are in
the clock of their sensor, t_s in seconds; time_clock.csv relates it to the companion's: remote = host + offset.

Not here: the bytes of the MAVLink link (spanwise convert RECORDING FILE.tlog) and images, which the recording keeps.
"""
_POINTS = """\
Matched features of the pairs in vision_matches.csv, a row each, in raw (distorted) pixels. filled are no features but
places between them, by dense disparity. The columns earlier_ are the same feature in the left image of an earlier pair,
where that shows it.
"""


def write_readme(folder: Path, recording: Recording, tables: RecordTables, samples: Mapping[str, str]) -> None:
    """Write the page; ``samples`` says for each folder of samples what it holds."""
    head = f"{_FIRST_WORDS} from {recording.path.name}, airframe {recording.airframe.name}.\n"
    entries = [_entry(name, tables) for name in sorted(tables.rows)]
    entries += [f"{name}/: {text}; units end the columns' names" for name, text in samples.items()]
    (folder / README).write_text("\n".join([head, _GENERAL, *entries, ""]), encoding="utf-8")


def is_converted(folder: Path) -> bool:
    """Whether a folder holds tables that were converted, and is no recording."""
    readme = folder / README
    if readme.is_file():
        return readme.read_text(encoding="utf-8", errors="replace").startswith(_FIRST_WORDS)
    return any(folder.glob("samples_*/accel.csv"))  # of an earlier version, without the page


def column_unit(column: str) -> str:
    """Unit that the name of a column ends in, before the number of an entry; empty for none."""
    name = re.sub(r"_\d+$", "", column).rpartition(".")[2]
    unit = "ppm" if name.endswith("_ppm") else unit_of(name) if "_" in name else ""
    return _UNITS.get(unit, unit)


def _entry(name: str, tables: RecordTables) -> str:
    text = _POINTS if name == POINTS else inspect.getdoc(tables.kinds[name]) or ""
    columns = textwrap.wrap(f"Columns: {', '.join(_listed(tables.columns[name]))}", _WIDTH, break_on_hyphens=False)
    body = [*_plain(text).splitlines(), *(line.replace(_TIED, " ") for line in columns)]
    return "\n".join([f"{name}: {tables.rows[name]} rows", *(f"    {line}".rstrip() for line in body), ""])


def _listed(columns: Iterable[str]) -> Iterator[str]:
    """Columns with their units, those of a long array as the first and the last."""
    for _, group in itertools.groupby(columns, lambda column: re.sub(r"_\d+$", "_", column)):
        entries = list(group)
        unit = column_unit(entries[0])
        names = [f"{entries[0]} to {entries[-1]}"] if len(entries) > _FEW else entries
        yield from (f"{name} [{unit}]".replace(" ", _TIED) if unit else name for name in names)


def _plain(text: str) -> str:
    """Docstring without the marks of its typesetting."""
    return re.sub(r":\w+:`~?([^`]*)`", r"\1", text).replace("``", "")

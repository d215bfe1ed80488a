"""Mapping files: what the columns of a laboratory's own table are (config/README.md), read and checked.

A mapping names each column's channel as ``accel.csv`` would name it, the unit that the table is in, and the scale
between the two where it is not plain.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from companion.adapters.recordings.tables.units import conversion, unit_of
from companion.errors import ConfigError
from companion.params.airframe import Uncertain
from companion.params.shipped import read_shipped, shipped_names
from companion.params.toml import LARGEST, parse_toml

_MOST_LINES = 1_000_000  # header of a table: more is a slip (choice)
_DECIMALS = {"point": ".", "comma": ","}
_DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "space": None}


FLIGHT = "flight"
"""Kind of test that a mapping is of where it names none."""


@dataclass(frozen=True, slots=True)
class ColumnMapping:
    """One column: its name in the table (or ``#3``), the channel it is, and value = scale * cell + offset."""

    name: str
    channel: str
    unit: str
    scale: float
    offset: float
    optional: bool = False

    @property
    def label(self) -> str:
        """The column in the words of a sentence about it."""
        return f"'{self.name}' ({self.channel}, unit {self.unit or 'none'})"


@dataclass(frozen=True, slots=True)
class TextLayout:
    """A text table: ``header_line`` and ``first_line`` count from 1; without a header (0) columns go by number.

    ``decimal`` is the sign before the decimals of a number.
    """

    delimiter: str | None = ","
    header_line: int = 1
    first_line: int = 2
    decimal: str = "."


@dataclass(frozen=True, slots=True)
class MatlabLayout:
    """A MATLAB v5 file: ``array`` holds the channels side by side, named by ``names``; or each is a variable."""

    array: str = ""
    names: str = ""


@dataclass(frozen=True, slots=True)
class TableMapping:
    """A whole mapping file.

    ``origin`` is its name, for messages; ``test`` the kind of test, a flight or a kind that ``diagnose`` knows.
    ``rate_hz`` is the rate of the rows where no column is the time, else 0; ``files`` is the pattern of the files that
    belong to a folder. ``constants`` holds, by file name, what was set once for that recording (sensor position, run
    order). ``band_hz`` is where the modes of interest are; ``belief`` has ``frequency_hz`` and ``damping`` of a
    structure that has no airframe file.
    """

    origin: str
    description: str
    test: str
    files: str
    rate_hz: float
    layout: TextLayout | MatlabLayout
    columns: tuple[ColumnMapping, ...]
    constants: dict[str, dict[str, float]]
    band_hz: tuple[float, float] | None = None
    belief: dict[str, Uncertain] = field(default_factory=dict)


def shipped_mappings() -> list[str]:
    """Names of the mappings that travel with Spanwise."""
    return shipped_names("mappings")


def load_mapping(name_or_path: str) -> TableMapping:
    """Read a mapping by name, or from the path of a ``.toml`` file.

    Raises
    ------
    ConfigError
        No such mapping, no TOML, or a key that is missing, unknown or of a wrong type; file and key are named.
    """
    shipped_file = read_shipped("mappings", name_or_path)
    if shipped_file is None:
        names = ", ".join(shipped_mappings())
        raise ConfigError(f"no mapping '{name_or_path}'; known: {names} (or give the path of a .toml file)")
    return parse_mapping(*shipped_file)


def parse_mapping(text: str, origin: str) -> TableMapping:
    """Parse the text of a mapping file; ``origin`` is named in errors."""
    keys = _Keys(parse_toml(text, origin), origin, "")
    table, matlab = keys.table("table"), keys.table("matlab")
    if table is not None and matlab is not None:
        raise ConfigError(f"{origin}: [table] is for text, [matlab] for .mat files: give one of them")
    mapping = TableMapping(
        origin,
        keys.text("description", ""),
        keys.text("test", FLIGHT),
        keys.text("files", "*"),
        keys.number("rate_hz", 0.0),
        _matlab(matlab) if matlab is not None else _text(table or _Keys({}, origin, "table")),
        _columns(keys),
        _constants(keys),
        _band(keys),
        _belief(keys),
    )
    keys.done()
    _check_time(mapping)
    return mapping


class _Keys:
    """A TOML table whose keys are taken one by one; what is left at the end is unknown."""

    def __init__(self, table: Mapping[str, Any], origin: str, where: str) -> None:
        self._unread, self.origin, self.where = dict(table), origin, where

    def take(self, key: str, kind: type | tuple[type, ...], expected: str, default: Any = None) -> Any:
        value = self._unread.pop(key, default)
        if value is not default and (not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool)):
            raise self.error(key, f"must be {expected}, not {value!r:.80}")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        value = self.take(key, str, "a text in quotes", default)
        if value is None:
            raise self.error(key, "is missing")
        return str(value)

    def number(self, key: str, default: float | None = None) -> float:
        value = self.take(key, (int, float), "a number", default)
        if value is None:
            raise self.error(key, "is missing")
        if not abs(value) <= LARGEST:
            raise self.error(key, f"must be a finite number, not {value!r:.80}")
        return float(value)

    def count(self, key: str, default: int) -> int:
        """A line's number; 0 is none."""
        value = int(self.take(key, int, "a whole number", default))
        if not 0 <= value <= _MOST_LINES:
            raise self.error(key, f"must be 0 to {_MOST_LINES}, not {value!r:.80}")
        return value

    def table(self, key: str) -> _Keys | None:
        value = self.take(key, dict, "a table")
        return None if value is None else _Keys(value, self.origin, f"{self.where}{key}.")

    def error(self, key: str, problem: str) -> ConfigError:
        return ConfigError(f"{self.origin}: '{self.where}{key}' {problem}")

    def done(self) -> None:
        for key in self._unread:
            raise self.error(key, "is no key of a mapping file")

    def names(self) -> list[str]:
        return list(self._unread)

    def items(self) -> list[tuple[str, Any]]:
        unread, self._unread = list(self._unread.items()), {}
        return unread


def _text(keys: _Keys) -> TextLayout:
    name = keys.text("delimiter", "comma")
    if name not in _DELIMITERS:
        raise keys.error("delimiter", f"must be one of {', '.join(_DELIMITERS)}, not {name!r}")
    header = keys.count("header_line", 1)
    decimal = keys.text("decimal", "point")
    if decimal not in _DECIMALS:
        raise keys.error("decimal", f"must be one of {', '.join(_DECIMALS)}, not {decimal!r}")
    layout = TextLayout(_DELIMITERS[name], header, keys.count("first_line", header + 1), _DECIMALS[decimal])
    if layout.decimal == layout.delimiter:
        raise keys.error("decimal", "is the delimiter, too: is it a semicolon?")
    if layout.first_line <= header:
        raise keys.error("first_line", "must come after the header line")
    keys.done()
    return layout


def _matlab(keys: _Keys) -> MatlabLayout:
    layout = MatlabLayout(keys.text("array", ""), keys.text("names", ""))
    keys.done()
    return layout


def _columns(keys: _Keys) -> tuple[ColumnMapping, ...]:
    table = keys.table("columns")
    if table is None:
        raise keys.error("columns", "is missing: it says which column is which channel")
    columns: list[ColumnMapping] = []
    for name, entry in table.items():
        if not isinstance(entry, dict):
            raise table.error(name, "must be a table such as { channel = 'left_z_mps2', unit = 'g' }")
        column = _column(name, _Keys(entry, keys.origin, f"columns.{name}."))
        if column.channel in [other.channel for other in columns]:
            raise table.error(name, f"is the second column of channel '{column.channel}'")
        columns.append(column)
    return tuple(columns)


def _column(name: str, keys: _Keys) -> ColumnMapping:
    channel = keys.text("channel")
    unit = keys.text("unit", unit_of(channel))
    factor = conversion(unit, unit_of(channel))
    if factor is None and "scale" not in keys.names():
        raise keys.error(
            "scale", f"is missing: nothing is known that makes '{unit_of(channel) or channel}' of unit '{unit}'"
        )
    scale = keys.number("scale", factor)
    if scale == 0.0:
        raise keys.error("scale", "must not be 0")
    optional = bool(keys.take("optional", bool, "true or false", False))
    column = ColumnMapping(name, channel, unit, scale, keys.number("offset", 0.0), optional)
    keys.done()
    return column


def _constants(keys: _Keys) -> dict[str, dict[str, float]]:
    constants: dict[str, dict[str, float]] = {}
    entries = keys.take("recordings", list, "a list of tables", [])
    for entry in entries:
        if not isinstance(entry, dict):
            raise keys.error("recordings", "must be tables: [[recordings]]")
        recording = _Keys(entry, keys.origin, "recordings.")
        file, values = recording.text("file"), recording.table("values")
        constants[file] = {name: values.number(name) for name in values.names()} if values is not None else {}
        recording.done()
    return constants


def _band(keys: _Keys) -> tuple[float, float] | None:
    band = keys.take("band_hz", list, "two frequencies, [low, high]")
    if band is None:
        return None
    numbers = [edge for edge in band if isinstance(edge, int | float)]
    if len(band) != 2 or len(numbers) != 2 or not 0 < numbers[0] < numbers[1] <= LARGEST:
        raise keys.error("band_hz", f"must be two frequencies, [low, high], not {band!r:.80}")
    return float(band[0]), float(band[1])


def _belief(keys: _Keys) -> dict[str, Uncertain]:
    table = keys.table("belief")
    if table is None:
        return {}
    belief: dict[str, Uncertain] = {}
    for name in ("frequency_hz", "damping"):
        entry = table.table(name)
        if entry is not None:
            belief[name] = Uncertain(entry.number("value"), entry.number("sigma"))
            entry.done()
    table.done()
    return belief


def _check_time(mapping: TableMapping) -> None:
    timed = any(column.channel == "t_s" for column in mapping.columns)
    if timed == bool(mapping.rate_hz):
        raise ConfigError(
            f"{mapping.origin}: give either a column with channel = 't_s' or rate_hz, not both and not none"
        )

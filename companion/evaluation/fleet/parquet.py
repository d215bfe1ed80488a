"""The fleet's table as a Parquet file: a column a figure, of one type."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from companion.errors import import_extra


def write_parquet(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write all rows; columns in the order in which they first come, null where a row has none.

    Raises
    ------
    MissingExtra
        The extra ``fleet`` is not installed.
    """
    pa = import_extra("pyarrow", "Parquet tables", "fleet")
    pq = import_extra("pyarrow.parquet", "Parquet tables", "fleet")
    names = dict.fromkeys(name for row in rows for name in row)
    columns = {name: _of_one_type([row.get(name) for row in rows]) for name in names}
    arrays = {name: pa.array(values, pa.string() if _is_empty(values) else None) for name, values in columns.items()}
    pq.write_table(pa.table(arrays), path)


def _of_one_type(values: list[Any]) -> list[Any]:
    """The values as texts, numbers or truth values: the narrowest type that holds all of them."""
    kinds = {type(value) for value in values if value is not None}
    if len(kinds) <= 1:
        return values
    wider = float if kinds <= {int, float} else str
    return [None if value is None else wider(value) for value in values]


def _is_empty(values: list[Any]) -> bool:
    return all(value is None for value in values)

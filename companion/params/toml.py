"""Reads TOML, with one sentence for whatever is wrong with the file."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from companion.errors import ConfigError

_CONTROL = re.compile(r"[\x00-\x1f\x7f]")  # letters that stand in no TOML text as they are (TOML 1.0)
LARGEST = 1e300  # far below the largest float, so that squares do not overflow (numerical)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a file; raise :class:`ConfigError` where it cannot be read or is no TOML in UTF-8."""
    return parse_toml(read_text(path), str(path))


def read_text(path: Path) -> str:
    """Read a file of text; raise :class:`ConfigError` where it cannot be read or is not UTF-8."""
    try:
        return path.read_text(encoding="utf-8-sig")  # some editors begin a file with a mark
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not text in UTF-8 (byte {error.start})") from error


def settings_of(table: dict[str, Any], origin: str) -> dict[str, float]:
    """The same table, of which every value is a number; raise :class:`ConfigError` for one that is not."""
    for name, value in table.items():
        if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) < LARGEST:
            raise ConfigError(f"{origin}: '{name}' must be a finite number, not {value!r:.80}")
    return table


def quoted(text: str) -> str:
    r"""A text as TOML writes it; of bytes that are not UTF-8, which no TOML holds, their spelling (``\udcff``)."""
    legible = text.encode("utf-8", "backslashreplace").decode("utf-8")
    escaped = legible.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return '"' + _CONTROL.sub(lambda letter: f"\\u{ord(letter[0]):04x}", escaped) + '"'


def parse_toml(text: str, origin: str) -> dict[str, Any]:
    """Parse a text; raise :class:`ConfigError`, which names ``origin``, where it is no TOML."""
    try:
        return tomllib.loads(text)
    except ValueError as error:
        raise ConfigError(f"{origin}: not valid TOML: {error}") from error
    except RecursionError as error:
        raise ConfigError(f"{origin}: not valid TOML: nested too deeply") from error

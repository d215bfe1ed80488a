"""Options that several commands share."""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path

from companion.errors import ConfigError
from companion.params.settings import Settings


def add_settings(parser: argparse.ArgumentParser) -> None:
    """``--settings FILE`` and ``--set NAME=VALUE``."""
    parser.add_argument("--settings", type=Path, metavar="FILE", help="TOML file of NAME = value lines (see params)")
    parser.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", dest="changes", help="one setting; may be repeated"
    )


def read_settings(options: argparse.Namespace) -> Settings:
    """The settings in force: defaults, then the file, then the command line."""
    settings = Settings()
    for name, value in _from_file(options.settings).items():
        settings = settings.replace(name, value)
    for change in options.changes:
        name, equals, text = change.partition("=")
        try:
            value = float(text)
        except ValueError as error:
            raise ConfigError(f"--set {change}: give NAME=VALUE with a number") from error
        if not equals:
            raise ConfigError(f"--set {change}: give NAME=VALUE")
        settings = settings.replace(name.strip(), value)
    return settings


def _from_file(path: Path | None) -> dict[str, float]:
    if path is None:
        return {}
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"cannot read settings {path}: {error.strerror}") from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"{path}: not valid TOML: {error}") from error
    for name, value in table.items():
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise ConfigError(f"{path}: '{name}' must be a number, not {value!r}")
    return table

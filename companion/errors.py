"""The exceptions of Spanwise: a bad input or a dead device. A refusal is a value, :class:`companion.records.Reject`.

SpanwiseError                   the base; ``str()`` says what was wrong, where, and what to do
├── ConfigError                 an airframe or settings file
│   └── UnknownAirframe         no airframe of that name
├── RecordingError              a recording that cannot be read
│   ├── AirframeNeeded          it does not say of which aircraft it is
│   └── TableError              a CSV table: file, line and column are named
├── LinkError                   a MAVLink connection that cannot be opened or was lost
│   └── LinkDown                it is spelled well, and nothing is at its other end now
├── DeviceError                 a camera, trigger or clock device
└── MissingExtra                an optional dependency that is not installed
"""

from __future__ import annotations

import importlib
import traceback
from collections.abc import Iterable
from pathlib import Path
from typing import Any

_LONGEST_TEXT = 200  # characters: two lines of a terminal (choice)


class SpanwiseError(Exception):
    """Base of every error that Spanwise raises on purpose."""


class ConfigError(SpanwiseError):
    """A settings or airframe file is wrong; the message names file and key."""


class UnknownAirframe(ConfigError):
    """No airframe of that name; the message lists the known ones."""

    def __init__(self, name: str, names: Iterable[str]) -> None:
        super().__init__(f"no airframe '{name}'; known: {', '.join(sorted(names))} (or give the path of a .toml file)")


class RecordingError(SpanwiseError):
    """A recording cannot be opened, or holds nothing that can be used."""


class AirframeNeeded(RecordingError):
    """A recording does not say of which aircraft it is."""


class TableError(RecordingError):
    """A CSV table is wrong at a named file and line."""

    def __init__(self, path: Path, line: int, problem: str) -> None:
        super().__init__(f"{path}, line {line}: {problem}")


class LinkError(SpanwiseError):
    """A MAVLink connection cannot be opened, or was lost."""


class LinkDown(LinkError):
    """A MAVLink connection has nothing at its other end: a device is unplugged, a server is not up."""


class DeviceError(SpanwiseError):
    """A camera, trigger or clock device failed."""


class MissingExtra(SpanwiseError):
    """An optional dependency is not installed; the message names the extra that brings it."""


def missing_extra(purpose: str, extra: str) -> str:
    """Sentence for a ``purpose`` ("OAK cameras") whose library comes with an optional extra of the package."""
    return f"{purpose} need more than the base installation: pip install 'spanwise[{extra}]'"


def import_extra(module: str, purpose: str, extra: str, refused: type[SpanwiseError] = MissingExtra) -> Any:
    """Module of an optional dependency, imported where it is used.

    Raises
    ------
    MissingExtra, or ``refused``
        It is not installed; the message names its extra and what it is for ("OAK cameras").
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise refused(missing_extra(purpose, extra)) from error


class SetupError(SpanwiseError):
    """The companion's system cannot be set up as asked; what was done up to there is taken back."""


def described(error: Exception) -> str:
    """Text of an exception and the place where it was raised, on one line."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    said = " ".join(str(error).split())[:_LONGEST_TEXT]
    return f"{type(error).__name__}{': ' if said else ''}{said}{where}"


# exit code of a command that ended well without a mode, a range or a cause; see the README (convention)
NOTHING_TO_ESTIMATE = 3
TO_FIX = 4  # exit code of the doctor where the vehicle wants a change; see the README (convention)

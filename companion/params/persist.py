"""The values set from a ground station, kept over restarts: atomic writes, a checksum, and the last good file beside.

The file is plain ``NAME = value`` lines under a first line that carries the CRC-32 of the rest; only values that differ
from the start are in it. A write goes to a temporary file, is flushed to the disk, and takes the file's place in one
step, while the file that it replaces stays as ``<name>.last``. A power cut leaves the old file or the new one.
"""

from __future__ import annotations

import math
import os
import queue
import struct
import threading
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from companion.errors import ConfigError
from companion.params.settings import tunables

_HEAD = "# spanwise parameters, crc32 "
_LARGEST_BYTES = 65_536  # chosen: many times what all parameters fill; a larger file is not ours


@dataclass(frozen=True, slots=True)
class Stored:
    """Contents of a parameter file: values by MAVLink name, and sentences about what was wrong with it."""

    values: dict[str, float]
    problems: tuple[str, ...] = ()


def load_stored(path: Path) -> Stored:
    """Read the parameter file; a damaged one is named and the last good one taken in its place.

    Where there is no file nothing is set, whatever the last good one holds: a write never leaves the file missing, so
    somebody removed it to begin anew.
    A value that the table does not know, or that is out of its range (a table of another version), is left out and
    named. Never raises for what the file holds.
    """
    problems: list[str] = []
    for candidate in (path, last_good(path)):
        try:
            return _checked(_parse(candidate), candidate, problems)
        except FileNotFoundError:
            break
        except UnicodeDecodeError as error:
            problems.append(f"{candidate}: is not text in UTF-8 (byte {error.start}), so no parameter file; not used")
        except (OSError, ValueError) as error:
            problems.append(f"{candidate}: {error}; not used")
    return Stored({}, tuple(problems))


def store(path: Path, values: Mapping[str, float]) -> None:
    """Write the values, whole or not at all; the file before, if it is good, stays as the last good one.

    Raises
    ------
    ConfigError
        The file cannot be written; the message says why.
    """
    body = "".join(f"{name} = {value!r}\n" for name, value in sorted(values.items()))
    text = f"{_HEAD}{zlib.crc32(body.encode()):08x}\n{body}"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if _is_good(path):
            write_atomically(last_good(path), path.read_text(encoding="utf-8"))
        write_atomically(path, text)
    except OSError as error:
        raise ConfigError(f"cannot keep parameters in {path}: {error.strerror}") from error


def last_good(path: Path) -> Path:
    """Where the file before the newest one is kept."""
    return path.with_name(path.name + ".last")


def write_atomically(path: Path, text: str) -> None:
    """Write a file in one step: after a power cut there is the old one or the new one; OSError where it cannot be."""
    fresh = path.with_name(path.name + ".new")
    with fresh.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(fresh, path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Force a folder's names to the disk, without which a new file has none after a power cut."""
    number = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def _is_good(path: Path) -> bool:
    try:
        _parse(path)
    except (OSError, ValueError):
        return False
    return True


def _parse(path: Path) -> dict[str, float]:
    """Values of a file whose checksum is right; ValueError (also for bad UTF-8) says what is wrong."""
    if path.stat().st_size > _LARGEST_BYTES:
        raise ValueError("too large for a parameter file")
    head, newline, body = path.read_bytes().decode("utf-8").partition("\n")
    if not newline or head != f"{_HEAD}{zlib.crc32(body.encode()):08x}":
        raise ValueError("damaged (its checksum is wrong)")
    values: dict[str, float] = {}
    for line in body.splitlines():
        name, _, text = line.partition(" = ")
        values[name] = float(text)
    return values


def _checked(values: Mapping[str, float], path: Path, problems: list[str]) -> Stored:
    rows = {row.name: row for row in tunables()}
    accepted: dict[str, float] = {}
    for name, value in values.items():
        row = rows.get(name)
        problem = f"no parameter '{name}'" if row is None else row.check(value)
        if problem is None:
            accepted[name] = value
        else:
            problems.append(f"{path}: {problem}; not used")
    return Stored(accepted, tuple(problems))


class Keeper:
    """Writes in a thread of its own, for a disk may take a second and the loop must not wait; the newest values win."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._newest: queue.SimpleQueue[dict[str, float] | None] = queue.SimpleQueue()
        self._problems: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name="parameter-keeper", daemon=True)
        self._thread.start()

    def keep(self, values: Mapping[str, float]) -> None:
        """Have these values written soon."""
        self._newest.put(dict(values))

    def problems(self) -> list[str]:
        """Problems since the last call."""
        taken: list[str] = []
        while not self._problems.empty():
            taken.append(self._problems.get())
        return taken

    def close(self) -> None:
        """Write what waits, and end."""
        self._newest.put(None)
        self._thread.join(5.0)

    def _work(self) -> None:
        ended = False
        while not ended:
            values = self._newest.get()
            while not self._newest.empty() and values is not None:
                newer = self._newest.get()
                if newer is None:
                    ended = True
                    break
                values = newer
            if values is None:
                return
            try:
                store(self._path, values)
            except ConfigError as error:
                self._problems.put(str(error))


def decimal32(value: float) -> float:
    """The shortest decimal that a 32-bit float stands for: 0.05 for the 0.0500000007 that a link delivers.

    Ranges and files hold decimals; without this the upper end of a range could not be set over MAVLink.
    """
    if not math.isfinite(value):
        return value
    for digits in range(1, 10):
        short = float(f"{value:.{digits}g}")
        if _as_float32(short) == _as_float32(value):
            return short
    return value


def _as_float32(value: float) -> bytes:
    try:
        return struct.pack("<f", value)
    except OverflowError:
        return b""

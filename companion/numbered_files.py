"""Files that share a name and never overwrite one another: ``name.mcap``, ``name.2.mcap``, ``name.3.mcap``."""

from __future__ import annotations

import re
from pathlib import Path


def numbered_files(path: Path) -> list[tuple[int, Path]]:
    """Files of this name with their numbers, in no order; the path itself has number 1.

    A number has at most five digits: a name with a date (``flight.20261130.mcap``) is somebody's own.
    """
    pattern = re.compile(rf"{re.escape(path.stem)}(?:\.([0-9]{{1,5}}))?{re.escape(path.suffix)}")
    files = path.parent.iterdir() if path.parent.is_dir() else ()
    fits = ((pattern.fullmatch(file.name), file) for file in files)
    return [(int(match[1] or 1), file) for match, file in fits if match is not None and file.is_file()]


def free_path(path: Path) -> Path:
    """The path itself, or ``name.2.mcap``, ``name.3.mcap`` and so on behind the highest number that is there."""
    number = max((number for number, _ in numbered_files(path)), default=0)
    if not number and not path.exists():
        return path
    number = max(number, 1) + 1
    while (numbered := path.with_name(f"{path.stem}.{number}{path.suffix}")).exists():
        number += 1
    return numbered


def remove_oldest(path: Path, most_bytes: int) -> None:
    """Remove the oldest files of this name until the others together take at most ``most_bytes``."""
    family = sorted(numbered_files(path))
    total = sum(file.stat().st_size for _, file in family)
    for _, file in family:
        if total <= most_bytes:
            return
        total -= file.stat().st_size
        file.unlink(missing_ok=True)

"""The work on one file as a task: what to do, and where its results go."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class FileTask:
    """Work on one file: what to do (words, as on a command line), and where its results go; both paths absolute."""

    path: Path
    words: tuple[str, ...]
    folder: Path

    @property
    def name(self) -> str:
        """The file's path."""
        return str(self.path)

    @property
    def key(self) -> str:
        """Name of the part: of the file's place, size and time, and of the words; another file of this name differs."""
        state = self.path.stat() if self.path.exists() else None
        identity: list[object] = [str(self.path.resolve()), list(self.words)]
        identity += [] if state is None else [state.st_size, state.st_mtime_ns]
        digest = hashlib.sha256(json.dumps(identity).encode()).hexdigest()
        return f"{self.path.stem}-{digest[:12]}"

    @property
    def result_file(self) -> Path:
        """Where the row lies once it is made."""
        return self.folder / "parts" / f"{self.key}.json"


def tasks_of(paths: Sequence[Path], words: tuple[str, ...], folder: Path) -> list[FileTask]:
    """Tasks of the files, each once, in the order of their names; a worker elsewhere reads the same places."""
    unique = sorted({path.resolve() for path in paths})
    return [FileTask(path, words, folder.resolve()) for path in unique]


def reason_alone(name: str, reason: str) -> str:
    """Reason of a failure without the file's name, with which most sentences of a refusal begin."""
    for named in (name, Path(name).name):
        reason = reason.removeprefix(f"{named}: ")
    return reason

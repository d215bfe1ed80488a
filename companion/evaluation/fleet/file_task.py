"""The work on one file as a task: what to do, and where its results go."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

_STEM_BYTES = 60  # of a file's name in that of its part, with digest and ending far below 255 (choice)


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
        """Name of the part: of all that its result depends on, so that a further run makes anew what has changed.

        That is the file's place, size and time (of a folder: its files'), the words, what is in files that words name,
        and the software's version. Of a long name the part has the first letters, and none that is not UTF-8.
        """
        identity: list[object] = [str(self.path.resolve()), list(self.words), metadata.version("spanwise")]
        files = sorted(self.path.iterdir()) if self.path.is_dir() else [self.path]
        states = [(path.name, path.stat()) for path in files if path.is_file()]
        identity += [(name, state.st_size, state.st_mtime_ns) for name, state in states]
        named = [Path(word) for word in self.words]
        identity += [hashlib.sha256(path.read_bytes()).hexdigest() for path in named if path.is_file()]
        digest = hashlib.sha256(json.dumps(identity).encode()).hexdigest()
        stem = self.path.stem.encode("utf-8", "ignore")[:_STEM_BYTES].decode("utf-8", "ignore")
        return f"{stem}-{digest[:12]}"

    @property
    def result_file(self) -> Path:
        """Where the row lies once it is made."""
        return self.folder / "parts" / f"{self.key}.json"


def tasks_of(paths: Sequence[Path], words: tuple[str, ...], folder: Path) -> list[FileTask]:
    """Tasks of the files, each once, in the order of their names; a worker elsewhere reads the same places."""
    unique = sorted({path.resolve() for path in paths})
    return [FileTask(path, words, folder.resolve()) for path in unique]


def without_copies(paths: Sequence[Path]) -> tuple[list[Path], list[tuple[Path, Path]]]:
    """The paths without files that hold the same bytes as an earlier one; and each such copy, with the earlier file.

    A flight that counted twice would weigh twice in its aircraft's medians. Folders are all different.
    """
    unique: list[Path] = []
    copies: list[tuple[Path, Path]] = []
    sizes = Counter(path.stat().st_size for path in paths if path.is_file())
    first: dict[bytes, Path] = {}
    for path in sorted({path.resolve() for path in paths}):
        if not path.is_file() or sizes[path.stat().st_size] == 1:
            unique.append(path)
            continue
        try:
            with path.open("rb") as file:
                digest = hashlib.file_digest(file, "sha256").digest()
        except OSError:  # its task says why it cannot be read
            unique.append(path)
            continue
        if first.setdefault(digest, path) == path:
            unique.append(path)
        else:
            copies.append((path, first[digest]))
    return unique, copies


def reason_alone(name: str, reason: str) -> str:
    """Reason of a failure without the file's name, with which most sentences of a refusal begin."""
    for named in (name, Path(name).name):
        reason = reason.removeprefix(f"{named}: ")
    return reason

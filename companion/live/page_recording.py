"""The page's own recordings, begun and ended by its button, and the list of what may be fetched."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from companion.adapters.recordings.mcap.channels import Recordable
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.errors import RecordingError
from companion.numbered_files import free_path

_NAME = "live.mcap"
_SUFFIX = ".mcap"
_MOST_LISTED = 50  # chosen: newest first: a list that is read


class PageRecording:
    """Writes what the live view is given while it is switched on.

    Such a recording begins in flight: its estimation began before it, as that of a further part does.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._writer: McapWriter | None = None
        self.path: Path | None = None

    @property
    def is_on(self) -> bool:
        """Whether it writes."""
        return self._writer is not None

    def begin(self, about: About) -> None:
        """Begin a file.

        Raises
        ------
        RecordingError
            The file cannot be created.
        """
        self.end()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(f"{self.folder}: cannot be made: {error.strerror}") from error
        self.path = free_path(self.folder / _NAME)
        self._writer = McapWriter(self.path, about)

    def write(self, record: Recordable) -> None:
        """Append a record; a full disk ends the recording.

        Raises
        ------
        RecordingError
            The file cannot be written any further.
        """
        if self._writer is None:
            return
        try:
            self._writer.write(record)
            self._writer.keep_synced()
        except OSError as error:
            self._writer.abandon()
            self._writer = None
            raise RecordingError(f"{self.path}: cannot be written any further: {error.strerror}") from error

    def end(self) -> None:
        """Finish the file."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close(sync=True)

    def listed(self) -> list[dict[str, Any]]:
        """Name, size and age order of the recordings, newest first."""
        if not self.folder.is_dir():
            return []
        files = [(path, path.stat()) for path in self.folder.iterdir() if path.suffix == _SUFFIX and path.is_file()]
        files.sort(key=lambda entry: -entry[1].st_mtime_ns)
        return [{"name": path.name, "bytes": status.st_size} for path, status in files[:_MOST_LISTED]]

    def file(self, name: str) -> Path | None:
        """Path of a listed recording; None for any other name."""
        return self.folder / name if any(entry["name"] == name for entry in self.listed()) else None

"""The file tree that is set up: ``/``, or the folder of an image. Whole files and links, each replaced in one step."""

from __future__ import annotations

import contextlib
import os
import stat
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from companion.errors import SetupError

_NEW_FILE_MODE = 0o644  # read by everybody, written by the owner (convention)


@dataclass(frozen=True, slots=True)
class File:
    """A regular file; a ``mode`` of None is that of the file before, or 0644."""

    data: bytes
    mode: int | None = None

    def same(self, other: Entry | None) -> bool:
        """Whether both hold the same bytes."""
        return isinstance(other, File) and other.data == self.data


@dataclass(frozen=True, slots=True)
class Symlink:
    """A symbolic link, to be kept as it is and not followed."""

    target: str

    def same(self, other: Entry | None) -> bool:
        """Whether both lead to the same name."""
        return isinstance(other, Symlink) and other.target == self.target


Entry = File | Symlink


def same(first: Entry | None, other: Entry | None) -> bool:
    """Whether two names hold the same; None is nothing."""
    return other is None if first is None else first.same(other)


class Tree:
    """Names are relative to ``root``, as in ``etc/default/spanwise``.

    Raises
    ------
    SetupError
        At construction: ``root`` is no folder. From every method: a name cannot be read or written, or a link leads out
        of the tree; the sentence names it.
    """

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            raise SetupError(f"--root {root}: no such folder")
        self.root = root.resolve()

    def path(self, name: str) -> Path:
        """Where a name is; its folder is inside the tree, whatever links are on the way."""
        path = self.root / name
        with self._sentence("read", name):
            folder = path.parent.resolve()
        if not folder.is_relative_to(self.root):
            raise SetupError(f"{path}: leads out of {self.root} (to {folder}); mount the image and use chroot")
        return folder / path.name

    def entry(self, name: str) -> Entry | None:
        """The content of a name; None where nothing is."""
        path = self.path(name)
        with self._sentence("read", name):
            if path.is_symlink():
                return Symlink(str(path.readlink()))
            if not path.exists():
                return None
            if not path.is_file():
                raise SetupError(f"{path}: is not a file")
            return File(path.read_bytes(), stat.S_IMODE(path.stat().st_mode))

    def text(self, name: str) -> str | None:
        """A file of the system as text, links followed; None where it is absent."""
        path = self.path(name)
        with self._sentence("read", name):
            return path.read_text(encoding="utf-8", errors="replace") if path.is_file() else None

    def put(self, name: str, entry: Entry | None) -> None:
        """Have a name hold this, or nothing; its folder must exist. It holds the old or the new, never a part."""
        path = self.path(name)
        with self._sentence("write", name):
            if entry is None:
                path.unlink(missing_ok=True)
            elif isinstance(entry, Symlink):
                path.unlink(missing_ok=True)
                path.symlink_to(entry.target)
            else:
                _replace(path, entry)

    def missing_folders(self, name: str) -> list[str]:
        """Folders above a name that do not exist, outermost first."""
        above = Path(name).parents
        return [str(folder) for folder in reversed(above) if not (self.root / folder).exists()]

    def make_folder(self, name: str) -> None:
        """Make one folder; its parent exists."""
        with self._sentence("make", name):
            self.path(name).mkdir()

    def drop_folder(self, name: str) -> bool:
        """Remove a folder if it is there and empty."""
        try:
            self.path(name).rmdir()
        except OSError:
            return False
        return True

    @contextlib.contextmanager
    def _sentence(self, doing: str, name: str) -> Iterator[None]:
        try:
            yield
        except PermissionError as error:
            advice = "; use sudo" if os.geteuid() != 0 else ""
            raise SetupError(f"cannot {doing} {self.root / name}: permission denied{advice}") from error
        except OSError as error:
            raise SetupError(f"cannot {doing} {self.root / name}: {error.strerror or error}") from error


def _replace(path: Path, file: File) -> None:
    """Write beside and rename; owner and permissions stay, on file systems that have any."""
    before = path.stat() if path.exists() else None
    mode = file.mode or (stat.S_IMODE(before.st_mode) if before is not None else _NEW_FILE_MODE)
    descriptor, beside = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    try:
        with open(descriptor, "wb") as stream:
            stream.write(file.data)
            stream.flush()
            os.fsync(stream.fileno())
        with contextlib.suppress(PermissionError):  # FAT has neither
            Path(beside).chmod(mode)
            if before is not None:
                os.chown(beside, before.st_uid, before.st_gid)
        os.replace(beside, path)
    except BaseException:
        Path(beside).unlink(missing_ok=True)
        raise

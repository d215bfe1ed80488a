"""Spanwise: stereo ranges that stay true while the wing bends. The rooms are drawn in companion/README.md."""

import hashlib
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

_OLDER_STATES = 3  # who goes back and forth between versions should not wait for the compiler each time


def _keep_machine_code_by_its_sources() -> None:
    """Give each state of the compiled folders a cache of its own: beside the sources, or where this user may write.

    The compiler asks whether a function's own file has changed, not whether those that it calls have: after an update
    it would go on with what they said before. Where nothing can be written, nothing is kept: every start compiles.
    """
    if "NUMBA_CACHE_DIR" in os.environ:  # chosen by the user, or by the process that started this one
        return
    here = Path(__file__).parent
    sources = {path: path.read_bytes() for path in sorted(here.rglob("*.py"))}
    folders = {path.parent for path, text in sources.items() if b"kernels.compiled import" in text}
    digest = hashlib.sha256(b"".join(text for path, text in sources.items() if path.parent in folders))
    name, beside = f"machine-code-{digest.hexdigest()[:16]}", here / "__pycache__"
    home = beside if _writable(beside) or _writable(here) else next(filter(_ours, _elsewhere()), None)
    if home is None:
        return
    cache = home / name
    os.environ["NUMBA_CACHE_DIR"] = str(cache)
    if not cache.exists():
        for folder in sorted(home.glob("machine-code-*"), key=_written_s)[:-_OLDER_STATES]:
            shutil.rmtree(folder, ignore_errors=True)
        if home is not beside and (beside / name).is_dir():  # who installed it has compiled it
            with suppress(OSError):
                shutil.copytree(beside / name, cache)
    if home is not beside:
        os.environ.setdefault("MPLCONFIGDIR", str(home / "matplotlib"))


def _elsewhere() -> Iterator[Path]:
    """Where a user's caches belong: as systemd says, by the XDG rules, or among the temporary files."""
    if parent := os.environ.get("CACHE_DIRECTORY"):
        yield Path(parent.split(":")[0]) / "spanwise"
    if parent := os.environ.get("XDG_CACHE_HOME"):
        yield Path(parent) / "spanwise"
    with suppress(RuntimeError):  # a user without a home
        yield Path.home() / ".cache" / "spanwise"
    with suppress(OSError):  # no folder for temporary files either
        yield Path(tempfile.gettempdir()) / f"spanwise-{os.geteuid()}"


def _ours(folder: Path) -> bool:
    """Whether the folder is there, or can be made, and nobody else can put code into it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.lstat()
    except OSError:
        return False
    private = status.st_uid == os.geteuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return stat.S_ISDIR(status.st_mode) and private and _writable(folder)


def _writable(folder: Path) -> bool:
    return folder.is_dir() and os.access(folder, os.W_OK | os.X_OK)


def _written_s(folder: Path) -> float:
    try:
        return folder.stat().st_mtime
    except OSError:  # another start is clearing up as well
        return 0.0


_keep_machine_code_by_its_sources()

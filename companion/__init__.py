"""Spanwise: stereo ranges that stay true while the wing bends. The rooms are drawn in companion/README.md."""

import hashlib
import os
import shutil
from pathlib import Path

_OLDER_STATES = 3  # who goes back and forth between versions should not wait for the compiler each time


def _keep_machine_code_by_its_sources() -> None:
    """Give each state of the compiled folders a cache of its own, beside the sources.

    The compiler asks whether a function's own file has changed, not whether those that it calls have: after an update
    it would go on with what they said before.
    """
    if "NUMBA_CACHE_DIR" in os.environ:  # chosen by the user, or by the process that started this one
        return
    here = Path(__file__).parent
    sources = {path: path.read_bytes() for path in sorted(here.rglob("*.py"))}
    folders = {path.parent for path, text in sources.items() if b"core.compiled import" in text}
    digest = hashlib.sha256(b"".join(text for path, text in sources.items() if path.parent in folders))
    kept = here / "__pycache__" / f"machine-code-{digest.hexdigest()[:16]}"
    os.environ["NUMBA_CACHE_DIR"] = str(kept)
    if not kept.exists():
        for folder in sorted(kept.parent.glob("machine-code-*"), key=_written_s)[:-_OLDER_STATES]:
            shutil.rmtree(folder, ignore_errors=True)


def _written_s(folder: Path) -> float:
    try:
        return folder.stat().st_mtime
    except OSError:  # another start is clearing up as well
        return 0.0


_keep_machine_code_by_its_sources()

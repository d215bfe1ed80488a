"""Spanwise: stereo ranges that stay true while the wing bends. The rooms are drawn in companion/README.md."""

import hashlib
import os
from pathlib import Path


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
    os.environ["NUMBA_CACHE_DIR"] = str(here / "__pycache__" / f"machine-code-{digest.hexdigest()[:16]}")


_keep_machine_code_by_its_sources()

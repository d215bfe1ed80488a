"""Digest by which a library older than its sources is known; the build runs this file alone."""

from __future__ import annotations

import hashlib
from pathlib import Path


def sources_digest(folder: Path) -> str | None:
    """Digest of the C sources in a folder; None where there are none, as in an installed package."""
    sources = sorted(folder.glob("*.[ch]"))
    digest = hashlib.sha256()
    for path in sources:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16] if sources else None

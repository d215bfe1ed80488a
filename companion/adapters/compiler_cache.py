"""The compiler's cache on a disk that is full: what cannot be kept is compiled again next time, and nothing ends."""

from __future__ import annotations

import contextlib
from typing import Any


def outlive_full_disk() -> None:
    """Have numba, where it is installed, go on when it cannot write its cache (it raises OSError in the first call)."""
    try:
        from numba.core.caching import Cache
    except ImportError:
        return
    save = Cache.save_overload

    def careful(cache: Any, signature: Any, data: Any) -> None:
        with contextlib.suppress(OSError):
            save(cache, signature, data)

    Cache.save_overload = careful

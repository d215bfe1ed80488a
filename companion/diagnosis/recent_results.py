"""The last few results of a slow computation, by what they were computed from."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")


class RecentResults(Generic[Key, Result]):
    """At most so many results; the oldest goes first."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._results: dict[Key, Result] = {}

    def get(self, key: Key, compute: Callable[[], Result]) -> Result:
        """Result of a key, computed where it is not at hand."""
        if key not in self._results:
            if len(self._results) >= self._most:
                self._results.pop(next(iter(self._results)))
            self._results[key] = compute()
        return self._results[key]

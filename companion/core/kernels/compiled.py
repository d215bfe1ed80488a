"""Just-in-time compilation of the inner loops: by numba where it is installed; elsewhere they run as they stand.

Functions under :func:`compiled` use nothing that numpy does not do as well by itself, and give the same numbers to
rounding. The machine code is cached beside the source or in the user's cache: only the first start after an update
pays for the compiler.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar, cast

try:
    from numba import njit
    from numba.core import event
    from numba.core.caching import IndexDataCacheFile
except ImportError:  # the plain fall-back
    njit = event = IndexDataCacheFile = None

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Array = TypeVar("_Array", bound=Any)

COMPILED = njit is not None


def _recompile_after_renames() -> None:
    """Make numba compile anew where its cache names types of an earlier version.

    It unpickles a cache's index before it compares the source's time stamp: a named tuple that has been renamed since
    would end the program at its first start after an update.
    """
    load = IndexDataCacheFile._load_index

    def load_or_empty(cache: Any) -> Any:
        try:
            return load(cache)
        except (AttributeError, ImportError):
            return {}

    IndexDataCacheFile._load_index = load_or_empty


if COMPILED:
    _recompile_after_renames()


def compiled(function: _Function) -> _Function:
    """Compile a function of arrays and named tuples of arrays, where possible; the order of sums is kept."""
    return _compiled(function)


def compiled_loops(function: _Function) -> _Function:
    """Compile plain loops, sums in any order: faster than numpy on small arrays, and slow where not compiled.

    Each user has a numpy version beside it, and a test that both agree. Not-a-number and infinity stay what they are.
    """
    return _compiled(function, fastmath={"reassoc", "contract", "nsz"})


def _compiled(function: _Function, **options: Any) -> _Function:
    if njit is None:
        return function
    try:
        return cast(_Function, njit(cache=True, error_model="numpy", **options)(function))
    except RuntimeError:  # there is no folder that machine code can be kept in
        return cast(_Function, njit(error_model="numpy", **options)(function))


def watched(begins: Callable[[str], None]) -> AbstractContextManager[object]:
    """Context that calls ``begins`` with the name of each function whose compilation begins; cached ones: never."""
    if event is None:
        return nullcontext()

    class Watcher(event.Listener):  # type: ignore[misc]
        def on_start(self, event: Any) -> None:
            begins(str(event.data["dispatcher"].py_func.__name__))

        def on_end(self, event: Any) -> None:
            """Ignore: only beginnings are asked for."""

    return cast(AbstractContextManager[object], event.install_listener("numba:compile", Watcher()))


def plain(array: _Array) -> _Array:
    """The array, or a contiguous writable copy of a view with gaps or a read-only array.

    Another memory layout is another type, for which a compiled function would be compiled anew: seconds, in flight.
    """
    return array if array.flags.carray else cast(_Array, array.copy())

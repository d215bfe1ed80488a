"""The optional accelerator: inner loops are compiled by numba where it is installed, and run as they stand where not.

What is :func:`compiled` uses nothing that numpy does not do as well by itself, and gives the same numbers to rounding.
The machine code is kept beside the source or in the user's cache, so that only the first start after an update
pays for the compiler.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, TypeVar, cast

try:
    from numba import njit
    from numba.core import event
except ImportError:  # the plain fall-back
    njit = event = None

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Array = TypeVar("_Array", bound=Any)

COMPILED = njit is not None


def compiled(function: _Function) -> _Function:
    """Compile a function of arrays and named tuples of arrays, if that can be done here."""
    return _compiled(function)


def compiled_loops(function: _Function) -> _Function:
    """Compile plain loops, sums in any order: faster than numpy on small arrays, and unbearable where not compiled.

    Whoever uses it keeps a numpy version beside it, and a test that both agree. Not-a-number and infinity stay what
    they are.
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
    """While inside, ``begins`` hears the name of each function as it begins to be compiled: none whose code is kept."""
    if event is None:
        return nullcontext()

    class Watcher(event.Listener):  # type: ignore[misc]
        def on_start(self, told: Any) -> None:
            begins(str(told.data["dispatcher"].py_func.__name__))

        def on_end(self, told: Any) -> None:
            """Nobody asks."""

    return cast(AbstractContextManager[object], event.install_listener("numba:compile", Watcher()))


def plain(array: _Array) -> _Array:
    """The array, or a copy of one that is a view with gaps or may not be written.

    What is compiled would be compiled anew for such an array, which takes seconds, in flight.
    """
    return array if array.flags.carray else cast(_Array, array.copy())

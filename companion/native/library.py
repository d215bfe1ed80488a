"""The library of the inner loops: loaded once, checked, its functions declared by those who call them.

A kernel takes arrays as they are (:data:`ARRAY`), integers, reals, and named tuples of these as one :func:`packed`
record. It allocates nothing that it returns, and refuses an array of other elements, of other dimensions or with gaps.
"""

from __future__ import annotations

import ctypes
import operator
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np

from companion.errors import SpanwiseError
from companion.native.digest import sources_digest

ARRAY, INTEGER, REAL, RECORD = ctypes.py_object, ctypes.c_int64, ctypes.c_double, ctypes.c_char_p
_HERE = Path(__file__).resolve().parent
_BAD_ARRAY, _NO_MEMORY = -1, -2  # convention: what a kernel returns instead of its result (arrays.h)
_BUILD = "`make native` builds it in a checkout, `pip install --force-reinstall spanwise` elsewhere"


class NativeLibraryError(SpanwiseError):
    """The library of the inner loops is missing, is older than its sources, or does not fit this Python."""


def kernel(name: str, *arguments: Any) -> Callable[..., int]:
    """Function of the library with arguments of these kinds; it raises where the kernel refuses an array."""
    function: Any = getattr(_LIBRARY, name)
    function.argtypes, function.restype, function.errcheck = arguments, INTEGER, _checked
    return function  # type: ignore[no-any-return]


def packed(record: type[Any]) -> Callable[[Any], bytes]:
    """Function that lays out a named tuple of arrays, integers and reals as the C structure of the same members.

    A member that is a named tuple itself is laid out in its place. The bytes hold addresses of the arrays, whose tuple
    is kept until the next one comes: constants and models are laid out once.
    """
    codes = _member_codes(record)
    pack = struct.Struct("=" + "".join(codes.values())).pack
    scalars = [k for k, code in enumerate(codes.values()) if code != "Q"]
    nested = any("." in name for name in codes)
    flat: Callable[[Any], Any] = operator.attrgetter(*codes) if nested else tuple
    newest: tuple[Any, bytes] = (None, b"")

    def laid_out(values: Any) -> bytes:
        nonlocal newest
        before, layout = newest
        if values is not before:
            members = flat(values)
            numbers = [*map(id, members)]
            for k in scalars:
                numbers[k] = members[k]
            layout = pack(*numbers)
            newest = values, layout
        return layout

    return laid_out


def library_variant() -> str:
    """Name of the library that is in use, and of what compiled it: its results may depend on both in the last bits."""
    _LIBRARY.compiler.restype = ctypes.c_char_p
    return f"{Path(_LIBRARY._name).stem} by {_LIBRARY.compiler().decode().strip()}"


def _member_codes(record: type[Any]) -> dict[str, str]:
    """Code for :mod:`struct` of each member of a named tuple, by name; those of nested ones in their place, dotted."""
    scalars = {int: "q", bool: "q", float: "d"}
    codes: dict[str, str] = {}
    for name, kind in get_type_hints(record).items():
        if hasattr(kind, "_fields"):
            codes |= {f"{name}.{member}": code for member, code in _member_codes(kind).items()}
        else:
            codes[name] = scalars.get(kind, "Q")
    return codes


def _checked(result: int, function: Any, _: Any) -> int:
    if result == _BAD_ARRAY:
        raise TypeError(f"{function.__name__}: an array of other elements or lengths, or with gaps between them")
    if result == _NO_MEMORY:
        raise MemoryError(function.__name__)
    return result


def _load() -> Any:
    library, wider = _opened(_HERE / "kernels.so"), _HERE / "kernels-avx2.so"
    if library.has_avx2() and wider.exists():
        library = _opened(wider)
    probe = np.empty((3, 5))
    library.layout_agrees.argtypes = (ARRAY, INTEGER)
    if not library.layout_agrees(probe, probe.ctypes.data):
        raise NativeLibraryError("this Python or numpy lays out its arrays in a way that the library does not know")
    return library


def _opened(path: Path) -> Any:
    try:
        library = ctypes.PyDLL(str(path))
    except OSError as error:
        problem = f"does not load ({error})" if path.exists() else "is missing"
        raise NativeLibraryError(f"the compiled library {path} {problem}: {_BUILD}") from error
    library.sources_digest.restype = ctypes.c_char_p
    if sources_digest(_HERE) not in (None, library.sources_digest().decode()):
        raise NativeLibraryError(f"the compiled library {path} is not of the sources beside it: {_BUILD}")
    return library


_LIBRARY = _load()

"""The machine on which estimates are made: all that their last bits depend on, in one line.

Two machines of the same line give the same bytes for the same inputs. Others may differ in rounding: by the compiler's
and the C library's ``exp``, by the order in which a matrix product is summed on a wider processor.
"""

from __future__ import annotations

import os
import platform
import re
from importlib import metadata
from pathlib import Path

from companion.native.library import library_variant

_PACKAGES = ("numpy", "scipy", "opencv-python-headless")
_FEATURES = {"x86_64": ("avx2", "fma", "avx512f"), "aarch64": ("asimd", "sve")}
"""By which numpy and its linear algebra choose their loops; an emulator shows those of its host, too."""
_LINEAR_ALGEBRA = "OPENBLAS_CORETYPE"
"""Variable of OpenBLAS that chooses them in its place."""


def machine() -> str:
    """Processor and its features, our library, Python, C library and the packages whose arithmetic is used."""
    processor = " ".join([platform.machine(), *processor_features(platform.machine())])
    chosen = os.environ.get(_LINEAR_ALGEBRA)
    packages = (f"{name} {_version(name)}" for name in _PACKAGES)
    system = [f"python {platform.python_version()}", c_library()]
    return ", ".join([processor, library_variant(), *system, *packages, *([f"OpenBLAS {chosen}"] if chosen else [])])


def processor_features(architecture: str, table: Path = Path("/proc/cpuinfo")) -> list[str]:
    """Features of the first processor that arithmetic may depend on; none where the system has no such table."""
    try:
        words = re.search(r"^(?:flags|Features)\s*:(.*)$", table.read_text(encoding="utf-8"), re.MULTILINE)
    except (OSError, UnicodeDecodeError):
        return []
    present = words[1].split() if words else []
    return [name for name in _FEATURES.get(architecture, ()) if name in present]


def c_library() -> str:
    """C library with its version, as ``glibc 2.36``."""
    try:
        return os.confstr("CS_GNU_LIBC_VERSION") or "another C library"
    except (ValueError, OSError):
        return "another C library"


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "none"

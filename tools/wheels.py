"""Wheels for x86_64 and aarch64, cross-compiled by the ``ziglang`` package: ``make wheels``.

The compiler is given the oldest glibc that the wheel's tag promises, so that the same wheels come from any Linux
machine. Each wheel is looked into before it is handed over: processor, glibc versions that it asks for, size.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import re
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterable
from pathlib import Path

from companion.errors import SpanwiseError

ROOT = Path(__file__).resolve().parents[1]
GLIBC = (2, 28)
"""Oldest C library of the wheels: numpy's and scipy's of today ask for it too (their tags, manylinux_2_28)."""
LIMIT_MB = 3.0
"""Largest wheel (choice)."""
ELF_MACHINES = {"x86_64": 62, "aarch64": 183}
"""Code of each processor in an ELF header (elf.h, ``EM_X86_64`` and ``EM_AARCH64``)."""
_PACKAGED = ("companion", "config", "mission_scripts", "tools")
_NOT_COPIED = shutil.ignore_patterns("__pycache__", ".build", "*.so")
_BUILD_S = 600
_MB = 1e6


def copy_sources(folder: Path) -> Path:
    """Copy what a wheel is built from, so that the build leaves nothing behind in the tree."""
    copy = folder / "checkout"
    for name in _PACKAGED:
        shutil.copytree(ROOT / name, copy / name, ignore=_NOT_COPIED)
    for path in ROOT.iterdir():
        if path.is_file():
            shutil.copy(path, copy)
    return copy


def platform_tag(machine: str) -> str:
    """Platform of a wheel's name (PEP 600)."""
    return f"manylinux_{GLIBC[0]}_{GLIBC[1]}_{machine}"


def build(machine: str, out: Path) -> Path:
    """Build the wheel of a processor into a folder, and give its path.

    Raises
    ------
    SpanwiseError
        The compiler is not installed.
    subprocess.CalledProcessError
        The compiler or the build failed; it has said why.
    """
    if importlib.util.find_spec("ziglang") is None:
        raise SpanwiseError("the wheels are compiled by ziglang, which is not installed: run make wheels once")
    target = f"{machine}-linux-gnu.{GLIBC[0]}.{GLIBC[1]}"
    compiler = shlex.join([sys.executable, "-m", "ziglang", "cc", "-target", target, "-s"])
    pip = (sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "--disable-pip-version-check")
    option = f"--config-settings=--build-option=--plat-name={platform_tag(machine)}"
    with tempfile.TemporaryDirectory(prefix="spanwise-wheel-") as folder:
        checkout, fresh = copy_sources(Path(folder)), Path(folder, "wheel")
        subprocess.run(
            [*pip, "-q", option, "-w", str(fresh), str(checkout)],
            check=True, timeout=_BUILD_S, env={**os.environ, "CC": compiler},
        )  # fmt: skip
        (wheel,) = fresh.glob("*.whl")
        out.mkdir(parents=True, exist_ok=True)
        return Path(shutil.copy(wheel, out))


def libraries(wheel: Path) -> dict[str, bytes]:
    """Compiled libraries of a wheel by their names."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist() if name.endswith(".so")}


def faults(wheel: Path, machine: str) -> list[str]:
    """Claims of a wheel's name that it breaks, a sentence each."""
    compiled = libraries(wheel)
    size_mb = wheel.stat().st_size / _MB
    return [
        *([] if compiled else [f"{wheel.name} holds no compiled library"]),
        *([] if wheel.name.endswith(f"-py3-none-{platform_tag(machine)}.whl") else [f"{wheel.name} names another tag"]),
        *([] if size_mb <= LIMIT_MB else [f"{wheel.name} has {size_mb:.1f} MB, {LIMIT_MB:g} are allowed"]),
        *_library_faults(compiled, machine),
    ]


def _library_faults(compiled: dict[str, bytes], machine: str) -> Iterable[str]:
    for name, data in compiled.items():
        if elf_machine(data) != ELF_MACHINES[machine]:
            yield f"{name} is not for {machine} (ELF machine {elf_machine(data)})"
        if (newest := newest_glibc(data)) > GLIBC:
            yield f"{name} asks for glibc {newest[0]}.{newest[1]}"


def elf_machine(data: bytes) -> int:
    """Processor of an ELF file: the 16 bits at 18 of its header."""
    return int(struct.unpack_from("<H", data, 18)[0]) if data[:4] == b"\x7fELF" else 0


def newest_glibc(data: bytes) -> tuple[int, int]:
    """Newest version of the C library that a library's symbols name."""
    versions = re.findall(rb"\bGLIBC_(\d+)\.(\d+)", data)
    return max(((int(major), int(minor)) for major, minor in versions), default=(0, 0))


def main() -> int:
    """Build them and print a line for each; 1 where one is not what its name says."""
    parser = argparse.ArgumentParser(prog="wheels", description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="FOLDER", help="where they are put")
    parser.add_argument("--machine", action="append", choices=list(ELF_MACHINES), help="this one alone")
    options = parser.parse_args()
    wrong = []
    for machine in options.machine or ELF_MACHINES:
        print(f"compiling for {machine}: the first time takes a minute", flush=True)
        wheel = build(machine, options.out)
        print(f"  {wheel}  {wheel.stat().st_size / _MB:.2f} MB", flush=True)
        wrong += faults(wheel, machine)
    for sentence in wrong:
        print(f"wheels: {sentence}", file=sys.stderr)
    return int(bool(wrong))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except SpanwiseError as error:
        sys.exit(f"wheels: {error}")

"""The wheel: ``companion``, with ``config`` inside as ``companion.config``, and the C library of its inner loops.

The library is compiled by ``$CC``, cc, gcc or clang, or else by the ``ziglang`` package, which is asked for where pip
builds in an environment of its own. It links to nothing of Python: one wheel of a machine serves every Python 3.
"""

from __future__ import annotations

import importlib.util
import os
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import Extension, find_packages, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).resolve().parent
NATIVE = Path("companion", "native")
# the order of sums is kept, and no product is fused with a sum: sums have the same bits with every compiler
FLAGS = ("-std=c11", "-O3", "-fno-fast-math", "-ffp-contract=off", "-fPIC", "-fvisibility=hidden", "-shared", "-lm")
WARNINGS = ("-Wall", "-Wextra", "-Wno-unknown-pragmas")


def files(pattern: str) -> list[str]:
    """Give the library's files of a kind."""
    return [str(path.relative_to(ROOT)) for path in sorted((ROOT / NATIVE).glob(pattern))]


def installed_compiler() -> list[str] | None:
    """Give the command of a C compiler of this machine; None without one."""
    if os.environ.get("CC"):
        return shlex.split(os.environ["CC"])
    found = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)
    return [found] if found else None


def compiler() -> list[str]:
    """Give the command of the C compiler to use, or end with what to do."""
    if (command := installed_compiler()) is not None:
        return command
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc", "-s"]
    sys.exit("Spanwise needs a C compiler: install cc, gcc or clang, or `pip install ziglang` into this environment")


def compiles_for_x86_64() -> bool:
    """Tell whether the compiler's target, which need not be this machine, is an x86_64 processor."""
    asked = [*compiler(), "-dM", "-E", "-x", "c", os.devnull]
    return "__x86_64__" in subprocess.run(asked, check=True, capture_output=True, text=True).stdout


class BuildNative(build_ext):
    """Compiles the library; its name has no Python's in it."""

    def get_ext_filename(self, fullname: str) -> str:
        """Name the library, relative to the build's folder."""
        return f"{fullname.replace('.', os.sep)}.so"

    def build_extension(self, ext: Extension) -> None:
        """Compile all sources at once."""
        digest = runpy.run_path(str(ROOT / NATIVE / "digest.py"))["sources_digest"](ROOT / NATIVE)
        defined = f'-DSOURCES_DIGEST="{digest}"'
        options = [*compiler(), *WARNINGS, defined, *shlex.split(os.environ.get("CFLAGS", "")), *ext.sources, *FLAGS]
        for name, wider in self._variants(ext).items():
            out = Path(self.build_lib, name)
            out.parent.mkdir(parents=True, exist_ok=True)
            subprocess.run([*options, *wider, "-o", str(out)], check=True)

    def _variants(self, ext: Extension) -> dict[str, list[str]]:
        """Name the libraries, with what each is compiled for: AVX2 doubles the speed where there is some, same bits."""
        name = self.get_ext_filename(ext.name)
        return {name: []} | ({name.replace(".so", "-avx2.so"): ["-mavx2"]} if compiles_for_x86_64() else {})

    def copy_extensions_to_source(self) -> None:
        """Put the library into the checkout, at once whole: somebody may be loading it."""
        for name in (name for ext in self.extensions for name in self._variants(ext)):
            place = ROOT / name
            part = place.with_suffix(f".{os.getpid()}")
            shutil.copyfile(Path(self.build_lib, name), part)
            part.replace(place)  # a running service keeps the library that it has loaded


class PlatformWheel(bdist_wheel):
    """A wheel of one platform and of every Python 3."""

    def get_tag(self) -> tuple[str, str, str]:
        """Give the tag of the wheel: no interface of Python's is used."""
        return "py3", "none", super().get_tag()[2]


setup(
    packages=[*find_packages(include=["companion*"]), "companion.config"],
    package_dir={"companion.config": "config"},
    exclude_package_data={"companion.native": ["*.c", "*.h"]},
    ext_modules=[Extension("companion.native.kernels", files("*.c"), depends=files("*.h"))],
    cmdclass={"build_ext": BuildNative, "bdist_wheel": PlatformWheel},
    setup_requires=[] if installed_compiler() else ["ziglang"],
)

"""The inner loops under the address and undefined-behaviour sanitizers, driven by the tests of this folder."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CHECKS = "-fsanitize=address,undefined -fno-sanitize-recover=all -g -fno-omit-frame-pointer"
DRIVERS = (
    "sitl_tests/native",
    "sitl_tests/unit/test_mavlink_bulk.py",
    "sitl_tests/unit/test_tracking_averaging.py",
    "sitl_tests/unit/test_tracking_lapses.py",
    "sitl_tests/unit/test_tracking_kernel.py",
)
_WRONG = """
#include <stdlib.h>
#include "arrays.h"
EXPORT int wrong(int at)
{
    int *numbers = calloc(4, sizeof *numbers), read = numbers[at];
    free(numbers);
    return read;
}
"""


def _sanitizer() -> str:
    """Library of the address sanitizer that has to be there before Python is."""
    compiler = shlex.split(os.environ.get("CC", "cc"))
    if shutil.which(compiler[0]) is None:
        pytest.skip(f"no C compiler: {compiler[0]} is not there")
    library = subprocess.run([*compiler, "-print-file-name=libasan.so"], capture_output=True, text=True).stdout.strip()
    if not Path(library).is_absolute():
        pytest.skip(f"{compiler[0]} has no address sanitizer")
    return library


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    tree = tmp_path_factory.mktemp("sanitized")
    ignored = shutil.ignore_patterns("__pycache__", "*.so")
    for folder in ("companion", "config", "sitl_tests", "tools"):
        shutil.copytree(ROOT / folder, tree / folder, ignore=ignored)
    for name in ("setup.py", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tree)
    (tree / "companion" / "native" / "wrong.c").write_text(_WRONG)
    return tree


def _run(tree: Path, *command: str) -> subprocess.CompletedProcess[str]:
    surroundings = {
        **os.environ,
        "PYTHONPATH": str(tree),
        "LD_PRELOAD": _sanitizer(),
        "ASAN_OPTIONS": "detect_leaks=0",  # Python's own are not ours
        "PYTHONMALLOC": "malloc",  # a byte behind an array of numpy's is seen too
    }
    return subprocess.run([sys.executable, *command], cwd=tree, env=surroundings, capture_output=True, text=True)


@pytest.mark.long
def test_no_kernel_reads_or_writes_where_it_should_not(tree: Path) -> None:
    _sanitizer()
    build = [sys.executable, "setup.py", "-q", "build_ext", "--inplace"]
    subprocess.run(build, cwd=tree, env={**os.environ, "CFLAGS": CHECKS}, check=True)
    here = str(Path(__file__).relative_to(ROOT))
    options = ("-x", "-p", "no:cacheprovider", f"--ignore={here}", "-m", "not slow and not long")
    done = _run(tree, "-m", "pytest", *options, *DRIVERS)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    assert " passed" in done.stdout
    wrong_write = _run(tree, "-c", "import ctypes; ctypes.CDLL('companion/native/kernels.so').wrong(4)")
    assert "wrong.c" in wrong_write.stderr, "the sanitizer sees nothing"

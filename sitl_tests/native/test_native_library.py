"""The loader of the inner loops: what it refuses, and what it says then."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from companion.adapters.mavlink.decode.bulk import _CRC, _checksum_tables
from companion.native.library import ARRAY, kernel, packed
from companion.records import Floats

ROOT = Path(__file__).resolve().parents[2]
_seek = kernel("mavlink_seek", ARRAY, ARRAY, ARRAY, ARRAY)
_SMOOTHED = """
import numpy as np
from companion.native.library import ARRAY, kernel
rng = np.random.default_rng(1)
powers, noise = np.empty((8, 40, 24)), np.empty((8, 8, 40))
made = kernel("forecast_powers", ARRAY, ARRAY, ARRAY, ARRAY, ARRAY)
made(0.2 * rng.standard_normal((24, 24)), rng.standard_normal((24, 24)), np.arange(8), powers, noise)
print(powers.tobytes().hex(), noise.tobytes().hex())
"""


def _loaded(tree: Path) -> subprocess.CompletedProcess[str]:
    surroundings = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    load = "from companion.native import library; print(library.__file__)"
    return subprocess.run([sys.executable, "-P", "-c", load], env=surroundings, capture_output=True, text=True)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for name in ("__init__.py", "errors.py"):
        (tmp_path / "companion").mkdir(exist_ok=True)
        shutil.copy(ROOT / "companion" / name, tmp_path / "companion")
    shutil.copytree(ROOT / "companion" / "native", tmp_path / "companion" / "native")
    return tmp_path


def test_a_library_of_the_sources_beside_it_is_loaded(tree: Path) -> None:
    assert Path(_loaded(tree).stdout.strip()).is_relative_to(tree)


def test_a_missing_library_is_named_with_what_to_do(tree: Path) -> None:
    (tree / "companion/native/kernels.so").unlink()
    said = _loaded(tree).stderr
    assert "kernels.so is missing" in said
    assert "make native" in said


def test_a_library_older_than_its_sources_is_not_run(tree: Path) -> None:
    source = tree / "companion/native/mavlink.c"
    source.write_text(source.read_text() + "/* changed */\n")
    assert "is not of the sources beside it" in _loaded(tree).stderr


def test_both_libraries_give_the_same_bits(tree: Path) -> None:
    """The wider one, where this processor has what it needs, only adds and multiplies more numbers at once."""
    wider = tree / "companion/native/kernels-avx2.so"
    if not wider.exists():
        pytest.skip("this machine has one library")
    environment = {**os.environ, "PYTHONPATH": f"{tree}:{ROOT}", "PYTHONDONTWRITEBYTECODE": "1"}
    said = []
    for _ in range(2):
        done = subprocess.run([sys.executable, "-P", "-c", _SMOOTHED], env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        said.append(done.stdout)
        wider.unlink(missing_ok=True)
    assert said[0] == said[1] != ""


def test_an_installed_library_has_no_sources_beside_it(tree: Path) -> None:
    for source in (tree / "companion/native").glob("*.[ch]"):
        source.unlink()
    assert _loaded(tree).returncode == 0


def test_a_file_that_is_no_library_is_said_so(tree: Path) -> None:
    (tree / "companion/native/kernels.so").write_bytes(b"no library")
    assert "does not load" in _loaded(tree).stderr


@pytest.mark.parametrize(
    "wrong",
    [
        np.zeros(40, np.int8),
        np.zeros((4, 10), np.uint8),
        np.zeros(40, np.uint8)[::2],
        np.zeros(40, ">i8"),
        np.zeros(40),
    ],
    ids=["signed", "two dimensions", "gaps", "byte order", "reals"],
)
def test_an_array_that_is_not_as_declared_is_refused(wrong: np.ndarray) -> None:
    assert _seek(np.zeros(40, np.uint8), _CRC, *_checksum_tables()) == 40
    with pytest.raises(TypeError, match="mavlink_seek"):
        _seek(wrong, _CRC, *_checksum_tables())


class _Inner(NamedTuple):
    at: int
    values: Floats


class _Outer(NamedTuple):
    step_s: float
    inner: _Inner
    valid: bool


def test_a_record_is_laid_out_member_by_member() -> None:
    values = np.zeros(3)
    laid_out = packed(_Outer)(_Outer(0.5, _Inner(-7, values), True))
    assert np.frombuffer(laid_out, np.float64)[0] == 0.5
    assert np.frombuffer(laid_out, np.int64)[1:].tolist() == [-7, id(values), 1]


def test_a_record_is_laid_out_anew_where_it_is_another_one() -> None:
    laid_out, values = packed(_Outer), np.zeros(3)
    first = _Outer(0.5, _Inner(-7, values), True)
    assert laid_out(first) is laid_out(first)
    others = [first._replace(step_s=0.25), first._replace(inner=_Inner(3, np.ones(2)))]
    for other in [*others, first]:
        fields = np.frombuffer(laid_out(other), np.int64)[1:].tolist()
        assert fields == [other.inner.at, id(other.inner.values), 1]
        assert np.frombuffer(laid_out(other), np.float64)[0] == other.step_s
    steps_s = [np.frombuffer(laid_out(_Outer(float(k), _Inner(1, values), True)), np.float64)[0] for k in range(4)]
    assert steps_s == [0.0, 1.0, 2.0, 3.0], "temporaries, whose places are used again"

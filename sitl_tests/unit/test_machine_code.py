"""Machine code is kept by the sources it was made from: a changed callee must not live on in its callers."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import companion
from companion.core.kernels.compiled import COMPILED

ROOT = Path(companion.__file__).resolve().parents[1]
PRINT = "import os, companion; print(os.environ['NUMBA_CACHE_DIR'])"


def _cache(root: Path, **more: str) -> str:
    clean = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    found = subprocess.run(
        [sys.executable, "-c", PRINT], cwd=root, env=clean | {"PYTHONPATH": str(root)} | more, capture_output=True
    )
    return found.stdout.decode().strip()


def test_only_what_is_compiled_decides_where_machine_code_is_kept(tmp_path: Path) -> None:
    shutil.copytree(
        Path(companion.__file__).parent, tmp_path / "companion", ignore=shutil.ignore_patterns("__pycache__")
    )
    first = _cache(tmp_path)
    assert first.startswith(str(tmp_path))
    (tmp_path / "companion/cli/demo.py").write_text("changed = True\n")
    assert _cache(tmp_path) == first
    callee = tmp_path / "companion/core/tracking/smoother.py"
    callee.write_text(callee.read_text() + "changed = True\n")
    assert _cache(tmp_path) != first
    assert _cache(tmp_path, NUMBA_CACHE_DIR="/elsewhere") == "/elsewhere"


def test_a_new_state_clears_all_but_the_newest_old_ones_away(tmp_path: Path) -> None:
    shutil.copytree(
        Path(companion.__file__).parent, tmp_path / "companion", ignore=shutil.ignore_patterns("__pycache__")
    )
    now = Path(_cache(tmp_path))
    others = [now.parent / f"machine-code-{k}" for k in range(6)]
    for age, folder in enumerate(others):
        folder.mkdir(parents=True)
        (folder / "code").write_text("compiled")
        os.utime(folder, (1e9 - age, 1e9 - age))
    assert Path(_cache(tmp_path)) == now
    assert [folder.exists() for folder in others] == [True, True, True, False, False, False]
    now.mkdir()
    others[5].mkdir()
    _cache(tmp_path)
    assert others[5].exists(), "nothing is searched for where the code is already there"


@pytest.mark.skipif(not COMPILED, reason="nothing is compiled without numba")
def test_code_that_is_cached_for_a_type_of_an_earlier_version_is_compiled_anew(tmp_path: Path) -> None:
    """Where the folder is set from outside, it holds the code of all versions."""
    source = (
        "from typing import NamedTuple\n"
        "from companion.core.kernels.compiled import compiled\n"
        "class Old(NamedTuple):\n    value: float\n"
        "@compiled\ndef doubled(pair):\n    return 2.0 * pair.value\n"
        "print(doubled(Old(2.0)))\n"
    )
    for text in (source, source.replace("Old", "New")):
        (tmp_path / "module.py").write_text(text)
        run = subprocess.run(
            [sys.executable, "-c", "import module"],
            cwd=tmp_path,
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "code"), "PYTHONPATH": f"{tmp_path}:{ROOT}"},
            capture_output=True,
            text=True,
        )
        assert (run.stdout, run.returncode) == ("4.0\n", 0), run.stderr

"""Machine code is kept by the sources it was made from: a changed callee must not live on in its callers."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import companion

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
    callee = tmp_path / "companion/core/tracking/resampling.py"
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

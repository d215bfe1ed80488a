"""As another user, without a home, from a tree that cannot be written: everything starts all the same."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("numba")
ROOT = Path(__file__).resolve().parents[2]
NOBODY = 65534
# reads what root's interpreter needs, and writes nothing: all that root may do beyond is gone
_AS_NOBODY = (
    "setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups",
    "--inh-caps=-all,+dac_read_search", "--ambient-caps=+dac_read_search", "--bounding-set=-all,+dac_read_search",
)  # fmt: skip
_SMALL = """
import os
import numpy as np
import companion
from companion.core.kernels.compiled import compiled
from companion.core.tracking.streams import respaced
print(respaced(np.arange(4, dtype=np.int64), 1))
print(os.environ.get("NUMBA_CACHE_DIR", ""))
"""


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that everybody may read, with one of nobody's own in it."""
    if os.geteuid() != 0 or shutil.which("setpriv") is None:
        pytest.skip("needs root and setpriv, to become another user")
    import tempfile  # pytest's own folder is closed to others

    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        place.chmod(0o755)
        (place / "own").mkdir(mode=0o700)
        os.chown(place / "own", NOBODY, NOBODY)
        (place / "temporary").mkdir()
        (place / "temporary").chmod(0o1777)
        (place / "tree").mkdir()
        shutil.copytree(ROOT / "companion", place / "tree" / "companion", ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copytree(ROOT / "config", place / "tree" / "config")
        yield place


def as_nobody(place: Path, *command: str, timeout_s: float = 120.0, **given: str) -> subprocess.CompletedProcess[str]:
    surroundings = {
        "PATH": os.environ["PATH"],
        "PYTHONPATH": str(place / "tree"),
        "PYTHONDONTWRITEBYTECODE": "1",
        **given,
    }
    return subprocess.run(
        [*_AS_NOBODY, *command], cwd="/", env=surroundings, capture_output=True, text=True, timeout=timeout_s
    )  # fmt: skip


def kept(place: Path) -> list[Path]:
    return sorted(place.rglob("*.nbi"))


@pytest.mark.slow
@pytest.mark.parametrize("way", ["CACHE_DIRECTORY", "XDG_CACHE_HOME", "HOME"])
def test_machine_code_is_kept_where_the_user_may_write(open_folder: Path, way: str) -> None:
    done = as_nobody(open_folder, sys.executable, "-c", _SMALL, **{way: str(open_folder / "own")})
    assert done.returncode == 0, done.stderr
    numbers, folder = done.stdout.splitlines()
    assert numbers == "[0 1 2 3]"
    assert Path(folder).is_relative_to(open_folder / "own")
    assert "machine-code-" in folder
    assert kept(Path(folder))


@pytest.mark.slow
def test_without_a_home_it_is_kept_in_a_temporary_folder_of_the_user_alone(open_folder: Path) -> None:
    done = as_nobody(open_folder, sys.executable, "-c", _SMALL, TMPDIR=str(open_folder / "temporary"))
    assert done.returncode == 0, done.stderr
    (made,) = (open_folder / "temporary").iterdir()
    assert kept(made)
    assert made.stat().st_uid == NOBODY
    assert stat.S_IMODE(made.stat().st_mode) == 0o700


@pytest.mark.slow
@pytest.mark.parametrize("trap", ["somebody else's", "open to all", "a link"])
def test_code_is_never_taken_from_a_folder_that_somebody_else_may_write(open_folder: Path, trap: str) -> None:
    temporary = open_folder / "temporary"
    folder = temporary / f"spanwise-{NOBODY}"
    if trap == "a link":
        (open_folder / "bait").mkdir()
        os.chown(open_folder / "bait", NOBODY, NOBODY)
        folder.symlink_to(open_folder / "bait")
    else:
        folder.mkdir()
        folder.chmod(0o777)
        if trap == "open to all":
            os.chown(folder, NOBODY, NOBODY)
    done = as_nobody(open_folder, sys.executable, "-c", _SMALL, TMPDIR=str(temporary))
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["[0 1 2 3]", ""], "compiled anew, and kept nowhere"
    assert kept(open_folder) == []


@pytest.mark.slow
def test_what_the_one_who_installed_it_has_compiled_is_used(open_folder: Path) -> None:
    tree = {**os.environ, "PYTHONPATH": str(open_folder / "tree")}
    tree.pop("NUMBA_CACHE_DIR", None)
    subprocess.run([sys.executable, "-c", _SMALL], cwd="/", env=tree, check=True, capture_output=True, timeout=120)
    compiled = kept(open_folder / "tree")
    assert compiled
    done = as_nobody(open_folder, sys.executable, "-c", _SMALL, CACHE_DIRECTORY=str(open_folder / "own"))
    assert done.returncode == 0, done.stderr
    copied = {path.name: path for path in kept(open_folder / "own")}
    for path in compiled:  # had it been compiled again, it would have been written again
        assert copied[path.name].read_bytes() == path.read_bytes()
        assert copied[path.name].stat().st_mtime_ns == path.stat().st_mtime_ns


@pytest.mark.slow
def test_help_and_a_plain_service_start_where_nothing_can_be_written_but_temporary_files(open_folder: Path) -> None:
    """Without the accelerator, which would compile for minutes: what else would be written?"""
    stub = open_folder / "tree" / "numba.py"
    stub.write_text("raise ImportError('not installed')\n")
    run = "from companion.cli.main import main; import sys; sys.exit(main())"
    temporary = {"TMPDIR": str(open_folder / "temporary")}
    helped = as_nobody(open_folder, sys.executable, "-c", run, "--help", **temporary)
    assert helped.returncode == 0, helped.stderr
    assert "doctor" in helped.stdout
    (open_folder / "service.py").write_text(f"if __name__ == '__main__':\n    {run}\n")
    options = ("--connect", "udpin:127.0.0.1:0", "--airframe", "nadir-2m", "--for", "4", "--plain")
    flown = as_nobody(open_folder, sys.executable, str(open_folder / "service.py"), "run", *options, **temporary)
    assert "Traceback" not in flown.stderr
    assert "ended (" not in flown.stderr, "no process died"
    assert flown.returncode in (0, 3), flown.stderr
    assert "state" in flown.stdout + flown.stderr

"""As another user, without a home, from a tree that cannot be written: everything starts all the same."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOBODY = 65534
# reads what root's interpreter needs, and writes nothing: all that root may do beyond is gone
_AS_NOBODY = (
    "setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups",
    "--inh-caps=-all,+dac_read_search", "--ambient-caps=+dac_read_search", "--bounding-set=-all,+dac_read_search",
)  # fmt: skip


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


def as_nobody(
    place: Path, *command: str, timeout_s: float = 120.0, **variables: str
) -> subprocess.CompletedProcess[str]:
    surroundings = {
        "PATH": os.environ["PATH"],
        "PYTHONPATH": str(place / "tree"),
        "PYTHONDONTWRITEBYTECODE": "1",
        **variables,
    }
    return subprocess.run(
        [*_AS_NOBODY, *command], cwd="/", env=surroundings, capture_output=True, text=True, timeout=timeout_s
    )  # fmt: skip


@pytest.mark.slow
def test_help_and_the_service_start_where_nothing_can_be_written_but_temporary_files(open_folder: Path) -> None:
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
    assert not [path for path in (open_folder / "temporary").iterdir() if path.name.startswith("spanwise")]

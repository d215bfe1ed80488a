"""Size of the wheels, and installed size with the dependencies: the base, each extra beside it, and all of them.

Every row is a fresh environment that pip fills from the package index with the pinned versions of
``requirements.lock``; counted are the files in its site-packages, compiled bytecode left out. Python itself and pip are
not counted.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

from tools.wheels import ELF_MACHINES, LIMIT_MB, build, copy_sources

ROOT = Path(__file__).resolve().parents[2]
EXTRAS = ("", "report", "oak", "all")
_MB = 1e6
_BASE_LIMIT_MB = 480.0  # what fits beside a 64-bit system on a 4 GB card, twice over; a convention
_INSTALL_S = 3600


def pins(lock: Path) -> list[str]:
    """Requirement lines ``name==version ; marker`` of a lock file, without hashes and continuation marks."""
    lines = (line.rstrip(" \\") for line in lock.read_text(encoding="utf-8").splitlines())
    return [line for line in lines if re.match(r"[A-Za-z0-9]", line)]


def installed_mb(extra: str, folder: Path) -> float:
    """Size of site-packages, MB, once ``spanwise[extra]`` is installed in a fresh environment inside ``folder``."""
    place = folder / (extra or "base")
    venv.create(place, with_pip=True)
    constraints = folder / "constraints.txt"
    constraints.write_text("\n".join(pins(ROOT / "requirements.lock")) + "\n", encoding="utf-8")
    site = Path(subprocess.check_output([place / "bin/python", "-c", "import site; print(site.getsitepackages()[0])"],
                                        text=True).strip())  # fmt: skip
    before = _bytes(site)
    pip = (place / "bin/python", "-m", "pip", "--disable-pip-version-check", "install", "--quiet", "--no-compile")
    wanted = f"{folder / 'checkout'}[{extra}]" if extra else str(folder / "checkout")
    subprocess.run([*pip, "-c", constraints, wanted], check=True, timeout=_INSTALL_S)
    grown = _bytes(site) - before
    shutil.rmtree(place)
    return grown / _MB


def _bytes(site: Path) -> int:
    return sum(path.stat().st_size for path in site.rglob("*") if path.is_file() and path.suffix != ".pyc")


def main(arguments: list[str]) -> int:
    """Print a table; 1 where the base is above its limit."""
    parser = argparse.ArgumentParser(prog="size", description=__doc__)
    parser.add_argument("--extras", nargs="*", default=list(EXTRAS), help="which rows ('' is the base)")
    options = parser.parse_args(arguments)
    sizes_mb = {}
    with tempfile.TemporaryDirectory(prefix="spanwise-size-") as folder:
        copy_sources(Path(folder))
        wheels_mb = {machine: build(machine, Path(folder)).stat().st_size / _MB for machine in ELF_MACHINES}
        for machine, size_mb in wheels_mb.items():
            print(f"{f'wheel, {machine}':20s} {size_mb:7.2f} MB", flush=True)
        for extra in options.extras:
            sizes_mb[extra] = installed_mb(extra, Path(folder))
            name = f"spanwise[{extra}]" if extra else "base (spanwise)"
            print(f"{name:20s} {sizes_mb[extra]:7.0f} MB", flush=True)
    missed = sizes_mb.get("", 0.0) > _BASE_LIMIT_MB
    if missed:
        print(f"base above {_BASE_LIMIT_MB:g} MB", file=sys.stderr)
    return int(missed or max(wheels_mb.values()) > LIMIT_MB)

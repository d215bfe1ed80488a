"""The installation: one package, complete without the checkout that it was built from."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from companion.params.files import shipped_airframes
from companion.params.shipped import shipped
from tools.wheels import copy_sources

ROOT = Path(__file__).resolve().parents[2]
_LOOK = """
import companion
from companion.params.files import shipped_airframes, load_airframe
from companion.adapters.recordings.tables.mapping import shipped_mappings, load_mapping
import companion.adapters.mavlink.decode.bulk
print(companion.__file__)
print(*(load_airframe(name).name for name in shipped_airframes()))
print(len([load_mapping(name) for name in shipped_mappings()]))
"""


@pytest.fixture(scope="module")
def quick_compiler(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Surroundings of a build whose compiler does not optimise: a wheel is looked into here, not timed."""
    compiler = os.environ.get("CC") or next(filter(shutil.which, ("cc", "gcc", "clang")), None)
    if compiler is None:  # the build brings one
        return dict(os.environ)
    script = tmp_path_factory.mktemp("compiler") / "cc"
    script.write_text(f'#!/bin/sh\nexec {compiler} "$@" -O0\n', encoding="utf-8")
    script.chmod(0o755)
    return {**os.environ, "CC": str(script)}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory, quick_compiler: dict[str, str]) -> Path:
    pytest.importorskip("setuptools")
    checkout, out = copy_sources(tmp_path_factory.mktemp("checkout")), tmp_path_factory.mktemp("wheel")
    options = ("--no-deps", "--no-build-isolation", "--disable-pip-version-check", "-q", "-w", str(out))
    command = [sys.executable, "-m", "pip", "wheel", *options, str(checkout)]
    subprocess.run(command, env=quick_compiler, check=True, timeout=480)
    (built,) = out.glob("*.whl")
    return built


@pytest.mark.slow
def test_the_wheel_installs_one_package_with_its_configuration_inside(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == {"companion"}
    ours = {str(path.relative_to(ROOT)) for path in (ROOT / "companion").rglob("*.py")}
    assert ours <= set(names)
    assert "companion/native/kernels.so" in names
    assert wheel.name.split("-")[2:4] == ["py3", "none"], "it serves every Python 3"
    assert not wheel.name.endswith("any.whl"), "of this platform"
    templates = {str(path.relative_to(ROOT)) for path in (ROOT / "companion/reporting/templates").iterdir()}
    assert "companion/reporting/templates/page.html.j2" in templates
    assert templates <= set(names)
    shipped_files = [*(ROOT / "config").rglob("*.toml"), *(ROOT / "config" / "system").iterdir()]
    files = {f"companion/{path.relative_to(ROOT)}" for path in shipped_files}
    assert len(files) > 9
    assert files <= set(names)


@pytest.mark.slow
def test_airframes_and_mappings_are_read_from_the_wheel_alone(wheel: Path, tmp_path: Path) -> None:
    zipfile.ZipFile(wheel).extractall(tmp_path / "site")
    surroundings = {**os.environ, "PYTHONPATH": str(tmp_path / "site"), "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        [sys.executable, "-P", "-c", _LOOK],
        cwd=tmp_path, env=surroundings, capture_output=True, text=True, timeout=60, check=True,
    )  # fmt: skip
    where, names, mappings = done.stdout.splitlines()
    assert Path(where).is_relative_to(tmp_path / "site")
    assert names.split() == shipped_airframes()
    assert int(mappings) >= 3


def test_a_checkout_reads_what_lies_in_its_config_folder() -> None:
    here = {entry.name for entry in shipped("airframes").iterdir()}
    assert here == {path.name for path in (ROOT / "config" / "airframes").iterdir()}

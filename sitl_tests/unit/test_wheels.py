"""``make wheels``: what the cross-compiled wheels hold, and that one starts in an environment of its own."""

from __future__ import annotations

import importlib.util
import platform
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest

from companion.native import library
from tools.bench.__main__ import main as bench
from tools.wheels import ELF_MACHINES, ROOT, build, elf_machine, faults, libraries, newest_glibc

_LOADED = "from companion.native import library; print(library.__file__, library.library_variant(), sep='\\n')"


def test_the_processor_of_a_library_is_read_from_its_header() -> None:
    """This Python is a program for this machine; what begins otherwise is for none."""
    expected = ELF_MACHINES.get(platform.machine())
    if expected is None:
        pytest.skip(f"{platform.machine()} is not built for")
    assert elf_machine(Path(sys.executable).resolve().read_bytes()[:64]) == expected
    assert elf_machine(b"MZ" + bytes(62)) == 0


def test_the_newest_glibc_is_the_largest_number_and_not_the_last_in_the_alphabet() -> None:
    assert newest_glibc(b"\0GLIBC_2.9\0GLIBC_2.17\0GLIBC_2.2.5\0") == (2, 17)
    assert newest_glibc(b"no symbols") == (0, 0)


@pytest.mark.parametrize(
    ("name", "machine", "glibc", "said"),
    [
        ("spanwise-0.2.0-py3-none-manylinux_2_28_aarch64.whl", 183, b"GLIBC_2.17", ""),
        ("spanwise-0.2.0-py3-none-manylinux_2_28_aarch64.whl", 62, b"GLIBC_2.17", "not for aarch64"),
        ("spanwise-0.2.0-py3-none-manylinux_2_28_aarch64.whl", 183, b"GLIBC_2.29", "asks for glibc 2.29"),
        ("spanwise-0.2.0-py3-none-linux_aarch64.whl", 183, b"GLIBC_2.17", "names another tag"),
    ],
)
def test_a_wheel_that_is_not_what_its_name_says_is_refused(
    tmp_path: Path, name: str, machine: int, glibc: bytes, said: str
) -> None:
    header = b"\x7fELF" + bytes(14) + machine.to_bytes(2, "little") + b"\0" + glibc + b"\0"
    with zipfile.ZipFile(tmp_path / name, "w") as archive:
        archive.writestr("companion/native/kernels.so", header)
    sentences = faults(tmp_path / name, "aarch64")
    assert len(sentences) == bool(said)
    assert said in "".join(sentences)


def test_a_wheel_too_large_or_without_library_is_refused(tmp_path: Path) -> None:
    wheel = tmp_path / "spanwise-0.2.0-py3-none-manylinux_2_28_x86_64.whl"
    with zipfile.ZipFile(wheel, "w") as archive:
        archive.writestr("data", np.random.default_rng(1).bytes(4_000_000))
    said = " ".join(faults(wheel, "x86_64"))
    assert "no compiled library" in said
    assert "4.0 MB, 3 are allowed" in said


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    pytest.importorskip("setuptools")
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("the ziglang package is not installed: `make wheels` brings it")
    out = tmp_path_factory.mktemp("dist")
    return {machine: build(machine, out) for machine in ELF_MACHINES}


def test_without_the_compiler_it_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    assert bench(["size"]) == 1
    assert capsys.readouterr().err == (
        "size: the wheels are compiled by ziglang, which is not installed: run make wheels once\n"
    )


@pytest.mark.long
@pytest.mark.parametrize("machine", ELF_MACHINES)
def test_a_wheel_is_small_complete_and_for_its_processor(wheels: dict[str, Path], machine: str) -> None:
    wheel = wheels[machine]
    assert faults(wheel, machine) == []
    names = set(zipfile.ZipFile(wheel).namelist())
    assert {str(path.relative_to(ROOT)) for path in (ROOT / "companion").rglob("*.py")} <= names
    expected = {"companion/native/kernels.so"}
    expected |= {"companion/native/kernels-avx2.so"} if machine == "x86_64" else set()
    assert set(libraries(wheel)) == expected
    assert not [name for name in names if name.endswith((".c", ".h"))]
    metadata = next(name for name in names if name.endswith(".dist-info/WHEEL"))
    assert f"Tag: py3-none-manylinux_2_28_{machine}\n" in zipfile.ZipFile(wheel).read(metadata).decode()


@pytest.mark.long
def test_the_wheel_of_this_machine_starts_in_an_environment_of_its_own(wheels: dict[str, Path], tmp_path: Path) -> None:
    """pip takes its tag; what it depends on is borrowed from this environment, the package itself is not."""
    wheel = wheels.get(platform.machine())
    if wheel is None:
        pytest.skip(f"there is no wheel for {platform.machine()}")
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    install = (python, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--disable-pip-version-check", wheel)
    subprocess.run(install, check=True, timeout=120)
    ours = Path(subprocess.check_output([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
                                        text=True).strip())  # fmt: skip
    (ours / "zz_borrowed.pth").write_text(borrowed())
    helped = subprocess.run([python.parent / "spanwise", "--help"], cwd=tmp_path, capture_output=True, text=True)
    assert helped.returncode == 0, helped.stderr
    assert "the live service beside an autopilot" in helped.stdout
    loaded = subprocess.run([python, "-P", "-c", _LOADED], cwd=tmp_path, capture_output=True, text=True)
    assert loaded.returncode == 0, loaded.stderr
    where, variant = loaded.stdout.splitlines()
    assert Path(where).is_relative_to(ours)
    assert variant.split()[0] == library.library_variant().split()[0], "the widest that this processor runs"


def borrowed() -> str:
    """Folders of this environment's packages, behind the new one's own."""
    folders = {sysconfig.get_path("purelib"), str(Path(np.__file__).parents[1])}
    return "".join(f"{folder}\n" for folder in sorted(folders))

"""A recording's word on the machine that made it."""

from __future__ import annotations

import platform
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.mcap.machine import machine, processor_features
from companion.native import library

ARM = """processor\t: 0
BogoMIPS\t: 108.00
Features\t: fp asimd evtstrm aes pmull sha1 sha2 crc32 atomics fphp asimdhp cpuid asimdrdm lrcpc dcpop asimddp
CPU implementer\t: 0x41
"""


def test_it_names_processor_library_and_packages() -> None:
    said = machine()
    assert said.startswith(platform.machine())
    assert library.library_variant() in said
    assert f"numpy {np.__version__}" in said
    assert f"python {platform.python_version()}" in said
    assert machine() == said


def test_the_library_is_named_with_what_compiled_it() -> None:
    name, _, compiler = library.library_variant().partition(" by ")
    assert (Path(library.__file__).parent / f"{name}.so").exists()
    assert compiler.startswith(("gcc ", "clang "))
    assert compiler.split()[1][0].isdigit()


def test_features_of_an_arm_processor_are_read(tmp_path: Path) -> None:
    (tmp_path / "cpuinfo").write_text(ARM)
    assert processor_features("aarch64", tmp_path / "cpuinfo") == ["asimd"]


def test_features_of_an_emulator_s_host_are_left_out(tmp_path: Path) -> None:
    (tmp_path / "cpuinfo").write_text("processor : 0\nflags : fpu sse2 fma avx2\n")
    assert processor_features("aarch64", tmp_path / "cpuinfo") == []
    assert processor_features("x86_64", tmp_path / "cpuinfo") == ["avx2", "fma"]


def test_a_system_without_such_a_table_has_none(tmp_path: Path) -> None:
    assert processor_features("x86_64", tmp_path / "absent") == []
    (tmp_path / "cpuinfo").write_bytes(b"\xff\xfe")
    assert processor_features("x86_64", tmp_path / "cpuinfo") == []


def test_a_choice_of_linear_algebra_makes_another_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENBLAS_CORETYPE", raising=False)
    plain = machine()
    monkeypatch.setenv("OPENBLAS_CORETYPE", "Haswell")
    assert machine() == f"{plain}, OpenBLAS Haswell"

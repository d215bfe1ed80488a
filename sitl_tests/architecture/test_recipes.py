"""Recipes of CONTRIBUTING.md, walked in a copy of the tree: as many files as the recipe says, and the thing works."""

from __future__ import annotations

import csv
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]

_EFFECT = '''"""A wing whose damping grows with the square of its speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import Effect, Group, ModalMotion, on_halves, parameter
from companion.records import Floats


@dataclass(frozen=True, slots=True)
class CubicDamping(Effect):
    """Each wing half is slowed by -beta |v|^2 v, v its tip speed in the first modes."""

    name: ClassVar[str] = "cubic-damping"
    group: ClassVar[Group] = Group.STRUCTURE
    one_way: ClassVar[bool] = True

    beta_spm2: float = parameter("s/m^2", 10.0, "damping acceleration per cubed speed")

    def force(self, motion: ModalMotion) -> Floats:
        """Modal acceleration of the drag, m/s^2."""
        return on_halves(motion, lambda _w, v: -self.beta_spm2 * np.abs(v) ** 2 * v)
'''


_FLY_WITH_AND_WITHOUT = """
from companion.cli.main import main
for out, effect in (("free", []), ("slowed", ["--effect", "cubic-damping=400"])):
    flown = main(["simulate", "--exact", "--duration", "3", "--out", out, *effect])
    assert flown == 0, "found by being in its folder"
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A copy of what is installed: the package and its configuration."""
    for folder in ("companion", "config"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def _run(tree: Path, *words: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(tree)}
    ran = subprocess.run(
        [sys.executable, *words], cwd=tree, env=environment, capture_output=True, text=True, timeout=240, check=False
    )
    assert ran.returncode == 0, ran.stdout[-2000:] + ran.stderr[-2000:]
    return ran.stdout


def _write_effect(tree: Path) -> Path:
    file = tree / "companion/core/wing/effects/damping/cubic_damping.py"
    file.write_text(_EFFECT)
    return file


@pytest.mark.slow
def test_an_effect_is_one_class_in_one_file(tree: Path) -> None:
    _write_effect(tree)
    _run(tree, "-c", _FLY_WITH_AND_WITHOUT)
    assert _swing_mps2(tree / "slowed") < 0.9 * _swing_mps2(tree / "free"), "drag takes energy from the swing"


def _swing_mps2(folder: Path) -> float:
    """Standard deviation of the left tip's vertical acceleration against the root's, m/s^2."""
    with (folder / "accel.csv").open(encoding="utf-8") as lines:
        names = next(csv.reader(lines))
        table = np.loadtxt(lines, delimiter=",", usecols=[names.index(name) for name in ("left_z_mps2", "root_z_mps2")])
    return float(np.std(table[:, 0] - table[:, 1]))


_DIALECT = "from companion.adapters.mavlink.link.dialect import mavlink\n"

_BEFORE_IMPORT = "from companion.params.settings import Settings\n"

_ENCODER = """
def mode_vector(record: ModeState, time_boot_ms: int) -> list[Any | None]:
    return [
        mavlink.MAVLink_debug_vect_message(b"bend", 1000 * time_boot_ms, *(float(q) for q in record.q_m), 0.0)
    ]


"""

_ROW = "    MessageOutput(ModeState, mode_vector, lambda _: 10.0),\n"

_PUBLISH_ONE = """
import numpy as np
from companion.adapters.mavlink.component.message_outputs import OutputPublisher
from companion.params.settings import Settings
from companion.records import ModeState
state = ModeState.__new__(ModeState)
for name, value in {"t_host_ns": 2 * 10**9, "q_m": np.array([0.01, -0.002])}.items():
    object.__setattr__(state, name, value)
sent = list(OutputPublisher().messages(state, Settings(debug_rate_hz=0.0), 10**9))
print(*(f"{message.get_type()} {message.time_usec} {message.x:g} {message.y:g}" for message in sent))
"""


def _write_message_output(tree: Path) -> Path:
    file = tree / "companion/adapters/mavlink/component/message_outputs.py"
    imports, before, code = file.read_text().partition(_BEFORE_IMPORT)
    head, table, rows = code.partition("OUTPUTS: tuple[MessageOutput, ...] = (\n")
    assert before
    assert table
    file.write_text(imports + _DIALECT + before + head + _ENCODER + table + _ROW + rows)
    return file


@pytest.mark.slow
def test_what_the_recipes_write_passes_mypy(tree: Path) -> None:
    files = [str(_write_effect(tree)), str(_write_message_output(tree))]
    cache = str(tree / "cache")
    said = _run(tree, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", cache, *files)
    assert "in 2 source files" in said


@pytest.mark.slow
def test_a_message_output_is_an_encoder_and_a_row_in_one_file(tree: Path) -> None:
    _write_message_output(tree)
    assert _run(tree, "-c", _PUBLISH_ONE).strip() == "DEBUG_VECT 3000000 0.01 -0.002"

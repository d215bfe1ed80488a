"""Recipes of CONTRIBUTING.md, walked in a copy of the tree: as many files as the recipe says, and the thing works."""

from __future__ import annotations

import csv
import json
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
    files = [str(path) for path in (_write_effect(tree), _write_message_output(tree), *_write_kind(tree))]
    cache = str(tree / "cache")
    said = _run(tree, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", cache, *files)
    assert "in 4 source files" in said


@pytest.mark.slow
def test_a_message_output_is_an_encoder_and_a_row_in_one_file(tree: Path) -> None:
    _write_message_output(tree)
    assert _run(tree, "-c", _PUBLISH_ONE).strip() == "DEBUG_VECT 3000000 0.01 -0.002"


_WEIGHTS = '''"""Weights hung on a wing: force over deflection, linear or with a cube."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from companion.diagnosis.json_rows import adequacy, cause_head, failures, held_out_gain, quantity
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.diagnosis.selection.diagnosis import diagnose
from companion.diagnosis.selection.regression import Coefficient, RegressionResponse, Regressions, RegressionTerm
from companion.records import Floats


def diagnose_weights(name: str, force: Floats, q: Floats, progress: Callable[[str, float], None]) -> dict[str, Any]:
    """Findings on one series of forces and deflections, (n,) each."""
    size = float(np.std(force) / np.std(q))
    cube = float(np.std(force) / np.std(q**3))
    fifths = (np.arange(len(q)) * 5 // len(q)).astype(np.float64)
    response = RegressionResponse(
        "force", force, np.ones(len(q)), np.zeros(len(q), np.int64), fifths, q, 0.0, size, 0.1 * float(np.std(force)),
        (Coefficient("stiffness", "force", q, 10.0 * size, "N/m", "linear spring"),),
    )
    law = Coefficient("cube", "force", q**3, 10.0 * cube, "N/m^3", "force per cubed deflection")
    outcome = diagnose(Regressions([response], [RegressionTerm("cubic spring", "", (law,))]), 2, progress)
    wrong = outcome.verdict is DiagnosisVerdict.UNEXPLAINED
    gain = outcome.gain and held_out_gain(outcome.gain.before, outcome.gain.after, "N", "force")
    causes = [
        cause_head(cause, "")
        | {"parameters": {"cube": quantity(cause.values[0], cause.sigmas[0], law.unit, law.meaning)}}
        | {"gain": gain and gain["error"], "advice": "load it further"}
        for cause in outcome.causes
    ]
    return {
        "format": 1,
        "recordings": [name],
        "airframe": None,
        "verdict": str(outcome.verdict),
        "reason": outcome.reason or "the spring",
        "causes": causes,
        "nearest": None,
        "gain": gain,
        "adequacy": adequacy(outcome.before, outcome.after),
        "residual": {"description": outcome.reason, "failed": failures(outcome.after)} if wrong else None,
        "airframe_parameters": [],
        "notes": [],
    }
'''

_READER = """
def _weights(
    tables: Sequence[MappedTable], mapping: TableMapping, options: argparse.Namespace, progress: Progress
) -> _Diagnosed:
    (table,) = tables
    plain = diagnose_weights(table.path.name, table.channels[_FORCE], table.channels["response_tip_m"], progress)
    return plain, lambda: findings_page(plain, mapping.description)


"""

_MAPPING = """
description = "weights on a wing"
test = "weights"
files = "loads.csv"
[columns]
"t" = { channel = "t_s", unit = "s" }
"F" = { channel = "input_n", unit = "N" }
"q" = { channel = "response_tip_m", unit = "m" }
"""


def _write_kind(tree: Path) -> list[Path]:
    kind = tree / "companion/diagnosis/weights.py"
    kind.write_text(_WEIGHTS)
    reader = tree / "companion/evaluation/measured_structures.py"
    code = reader.read_text()
    assert _ERRORS in code
    assert _TABLE in code
    code = code.replace(_ERRORS, "from companion.diagnosis.weights import diagnose_weights\n" + _ERRORS)
    reader.write_text(code.replace(_TABLE, _READER + _TABLE + '"weights": _weights, '))
    return [kind, reader]


_ERRORS = "from companion.errors import NOTHING_TO_ESTIMATE"
_TABLE = "_DIAGNOSED = {"


@pytest.mark.slow
def test_a_kind_of_recording_is_a_class_and_a_row(tree: Path) -> None:
    """A spring of 40 N/m with a cube of 8,000 N/m^3 comes back within four of its sigmas."""
    _write_kind(tree)
    q = np.repeat(np.linspace(-0.05, 0.05, 21), 5)
    force = 40.0 * q + 8000.0 * q**3 + 0.02 * np.random.default_rng(1).standard_normal(len(q))
    rows = "".join(f"{k},{f:.6f},{d:.6f}\n" for k, (f, d) in enumerate(zip(force, q, strict=True)))
    (tree / "loads.csv").write_text("t,F,q\n" + rows)
    (tree / "loads.toml").write_text(_MAPPING)
    words = ["diagnose", "loads.csv", "--mapping", "loads.toml", "--json", "found.json", "--html", "found.html"]
    _run(tree, "-m", "companion.cli", *words)
    (cause,) = json.loads((tree / "found.json").read_text())["causes"]
    cube = cause["parameters"]["cube"]
    assert cube["value"] == pytest.approx(8000.0, abs=4.0 * cube["sigma"])
    assert cube["sigma"] < 400.0
    assert "cubic spring" in (tree / "found.html").read_text()

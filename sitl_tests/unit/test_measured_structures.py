"""Bench recordings through a mapping, as the command reads them: stamps, clipped channels, beliefs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.tables.mapping import parse_mapping
from companion.cli.main import main
from companion.evaluation.measured_structures import tables_of
from companion.records import Floats

RATE_HZ, HZ, ZETA = 400.0, 8.0, 0.01
MAPPING = """
test = "ringing"
band_hz = [4.0, 14.0]
[table]
delimiter = "comma"
header_line = 1
[columns]
"t" = { channel = "t_s", unit = "s" }
"a" = { channel = "left_z_mps2", unit = "m/s^2" }
[belief]
frequency_hz = { value = BELIEVED, sigma = 1.0 }
damping = { value = 0.01, sigma = 0.005 }
"""


def _knocked() -> tuple[Floats, Floats]:
    """Stamps and accelerations of a mode that is struck every five seconds."""
    t_s = np.arange(0.0, 20.0, 1.0 / RATE_HZ)
    since_s = np.mod(t_s, 5.0)
    swing = np.exp(-ZETA * 2.0 * np.pi * HZ * since_s) * np.cos(2.0 * np.pi * HZ * since_s)
    return t_s, swing + 1e-3 * np.random.default_rng(1).standard_normal(len(t_s))


def _written(folder: Path, t_s: Floats, values: Floats, believed_hz: float = 8.0) -> tuple[str, str]:
    table, mapping = folder / "ring.csv", folder / "ring.toml"
    rows = "\n".join(f"{t:.9g},{a:.7g}" for t, a in zip(t_s.tolist(), values.tolist(), strict=True))
    table.write_text(f"t,a\n{rows}\n")
    mapping.write_text(MAPPING.replace("BELIEVED", f"{believed_hz:g}"))
    return str(table), str(mapping)


def test_rounded_stamps_of_a_bench_recording_are_put_back(tmp_path: Path) -> None:
    t_s = np.arange(8000) / 610.0
    table, mapping = _written(tmp_path, np.round(t_s, 3), np.sin(t_s))
    (read,) = tables_of([table], parse_mapping(Path(mapping).read_text(), mapping))
    assert np.ptp(np.diff(read.t_s)) < 1e-6
    np.testing.assert_allclose(read.t_s, t_s, atol=6e-4)
    assert "rounded to 1 ms" in read.notes[-1]


@pytest.mark.parametrize("clipped", [False, True])
def test_a_clipped_decay_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str], clipped: bool) -> None:
    t_s, values = _knocked()
    table, mapping = _written(tmp_path, t_s, np.clip(values, -0.5, 0.5) if clipped else values)
    assert main(["diagnose", table, "--mapping", mapping]) == 0
    assert ("ring.csv: left_z_mps2 piles up" in capsys.readouterr().out) is clipped


def test_a_belief_outside_the_band_is_refused_with_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table, mapping = _written(tmp_path, *_knocked(), believed_hz=30.0)
    assert main(["diagnose", table, "--mapping", mapping]) == 1
    said = capsys.readouterr().err
    assert "band_hz, 4 to 14 Hz" in said
    assert "frequency_hz, 30 Hz" in said

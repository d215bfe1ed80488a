"""Bench recordings through a mapping, as the command reads them: stamps, clipped channels, beliefs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.tables.mapped_table import MappedTable
from companion.adapters.recordings.tables.mapping import parse_mapping
from companion.cli.main import main
from companion.errors import RecordingError
from companion.evaluation import measured_structures
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


def test_a_copy_of_a_recording_is_refused(tmp_path: Path) -> None:
    """Twice the same vibration run ended in a traceback, and any other kind was surer of its verdict."""
    table, mapping = _written(tmp_path, *_knocked())
    with pytest.raises(RecordingError, match=r"has the samples of .*ring\.csv: give each recording once"):
        tables_of([table, table], parse_mapping(Path(mapping).read_text(), mapping))


def _table(t_s: Floats, **constants: float) -> MappedTable:
    tone = np.sin(2.0 * np.pi * HZ * t_s)
    return MappedTable(Path("run.csv"), t_s, {"input_n": tone, "left_z_mps2": tone}, constants)


def test_lost_rows_of_a_vibration_run_are_put_back_and_a_gap_is_refused() -> None:
    """Its rows counted as even: a gap of 1.5 % was a frequency that changed between runs."""
    notes: list[str] = []
    t_s = np.arange(4000) / RATE_HZ
    lost = measured_structures._without_losses(_table(np.delete(t_s, [500, 2000, 2001])), 14.0, notes)
    np.testing.assert_allclose(lost.t_s, t_s, atol=1e-9)
    np.testing.assert_allclose(lost.channels["input_n"], _table(t_s).channels["input_n"], atol=1e-3)
    assert notes == ["run.csv: rows are lost at 2 places, which splines bridge"]
    with pytest.raises(RecordingError, match=r"the longest 0\.15"):
        measured_structures._without_losses(_table(np.delete(t_s, range(500, 560))), 14.0, notes)


def test_a_pause_is_no_wrong_unit_of_the_time() -> None:
    """Rows a second were counted over the pause: a decay after it was refused, its time column doubted."""
    notes: list[str] = []
    t_s = np.arange(4000) / RATE_HZ
    paused = _table(np.where(t_s > 7.0, t_s + 1000.0, t_s))
    measured_structures._check_rows(paused, (4.0, 14.0), ["left_z_mps2"])
    assert np.ptp(measured_structures._unbroken(paused, 14.0, notes).t_s) == pytest.approx(7.0, abs=0.01)
    assert notes == ["run.csv: gaps: 1; judged is the longest stretch without one, 7.0 s"]


def test_a_decay_may_follow_what_the_mapping_states_for_its_file() -> None:
    """Values under [[recordings]] were read and left aside; the order of runs is no cause."""
    raw = measured_structures._raw_ringing(_table(np.arange(100) / RATE_HZ, temperature_degc=21.0, run_order=2.0))
    assert set(raw.channels) == {"input_n", "temperature_degc"}
    assert set(raw.channels["temperature_degc"]) == {21.0}

"""A real flexible flying wing on the shaker (mAEWing1): repeatable modes, shapes, an established library.

The data lie in ``$SPANWISE_DATA`` or in ``shared`` beside the repository.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.tables.matlab_file import read_matlab
from companion.calibration.modes import IdentifiedMode, assurance, identify_runs
from companion.calibration.vibration import VibrationTest, read_vibration_test
from companion.calibration.wing_modes import bending_modes, symmetry
from companion.cli import identify
from companion.errors import ConfigError, RecordingError
from companion.params.files import load_airframe

DATA = Path(os.environ.get("SPANWISE_DATA", Path(__file__).resolve().parents[3] / "shared"))
GVT = DATA / "measured" / "maewing1-gvt"
LAYOUT = Path(__file__).parent / "maewing1.toml"
here = pytest.mark.skipif(not GVT.exists(), reason="measured/maewing1-gvt is not here (SPANWISE_DATA)")
WELL_EXCITED_HZ = (9.3, 19.1, 30.9, 33.4)


@pytest.fixture(scope="module")
def test() -> VibrationTest:
    return read_vibration_test(LAYOUT, GVT, read_matlab)


@pytest.fixture(scope="module")
def modes(test: VibrationTest) -> list[IdentifiedMode]:
    return identify_runs(test.runs, len(test.points))


def _near(modes: list[IdentifiedMode], frequency_hz: float) -> IdentifiedMode:
    return min(modes, key=lambda mode: abs(mode.frequency_hz - frequency_hz))


@here
@pytest.mark.long
def test_the_well_excited_modes_come_back_in_every_run(modes: list[IdentifiedMode]) -> None:
    """Run to run they stay within 2 % in frequency (the accelerometers' mass travels) and 20 % in damping."""
    for frequency in WELL_EXCITED_HZ:
        mode = _near(modes, frequency)
        assert mode.runs == 10
        assert mode.frequency_sigma_hz < 0.02 * mode.frequency_hz
        assert mode.damping_sigma < 0.2 * mode.damping


@here
@pytest.mark.long
def test_independent_halves_of_the_data_give_the_same_shapes(modes: list[IdentifiedMode]) -> None:
    """Halves share neither noise nor poles; an assurance above 0.9 is commonly called the same mode."""
    assert all(_near(modes, frequency).assurance > 0.9 for frequency in WELL_EXCITED_HZ)
    assert all(_near(modes, frequency).assurance > 0.99 for frequency in WELL_EXCITED_HZ[:3])


@here
@pytest.mark.long
def test_halves_tell_bending_modes_apart(modes: list[IdentifiedMode]) -> None:
    """Even lines of one mode against odd lines of the other: the first two share nothing."""
    first, second = _near(modes, 9.3), _near(modes, 19.1)
    assert assurance(first.halves[0], second.halves[1]) < 0.1
    assert assurance(second.halves[0], first.halves[1]) < 0.1


@here
@pytest.mark.long
def test_lines_narrower_than_the_record_resolves_are_named_and_left_out(
    test: VibrationTest, modes: list[IdentifiedMode]
) -> None:
    """7.8, 15.9, 23.8 Hz: one or two lines wide, and they never shift as the accelerometers travel; wing modes do."""
    narrow = [mode for mode in modes if not mode.resolved]
    assert all(mode.frequency_sigma_hz < 0.002 * mode.frequency_hz for mode in narrow)
    assert all(_near(modes, frequency).resolved for frequency in WELL_EXCITED_HZ)
    assert all(each.mode.resolved for each in bending_modes(modes, test.points))


@here
@pytest.mark.long
def test_first_symmetric_and_antisymmetric_bending_move_as_such(
    test: VibrationTest, modes: list[IdentifiedMode]
) -> None:
    assert symmetry(_near(modes, 9.3), test.points) > 0.95
    assert symmetry(_near(modes, 19.1), test.points) < -0.95
    for each in bending_modes(modes, test.points)[:2]:
        assert each.mode.phase_scatter_rad < np.radians(3)
        sigma = np.sqrt(np.diag(each.factors.covariance))
        assert each.factors.slope_factor_radpm > 5 * sigma[1]


@here
@pytest.mark.long
def test_the_command_writes_an_airframe_that_reads_back(tmp_path: Path) -> None:
    parser = argparse.ArgumentParser()
    identify.add_arguments(parser)
    assert identify.execute(parser.parse_args(["gvt", str(GVT), "--layout", str(LAYOUT), "--out", str(tmp_path)])) == 0
    airframe = load_airframe(str(tmp_path / "airframe.toml"))
    assert airframe.wing.symmetric.frequency_hz.value == pytest.approx(9.27, abs=0.2)
    assert all(
        (tmp_path / name).stat().st_size > 10_000 for name in ("responses.png", "repeatability.png", "shapes.png")
    )


@here
@pytest.mark.long
@pytest.mark.parametrize("run", [4, 9])  # right tip, left tip
def test_an_established_library_finds_the_same_modes_in_the_same_run(test: VibrationTest, run: int) -> None:
    """sdypy-EMA (LSCF) on one run's responses: its pole nearest to ours, at its highest order."""
    ema = pytest.importorskip("sdypy.EMA", reason="sdypy-EMA is not installed")
    ours = identify_runs([test.runs[run]], len(test.points))
    wanted = [_near(ours, frequency) for frequency in WELL_EXCITED_HZ[:3]]
    shaken_run = test.runs[run]
    spacing = shaken_run.frequency_hz[1] - shaken_run.frequency_hz[0]
    frequency = np.arange(0.0, shaken_run.frequency_hz[-1] + spacing / 2, spacing)
    response = np.zeros((len(shaken_run.points), len(frequency)), dtype=complex)
    response[:, -len(shaken_run.frequency_hz) :] = shaken_run.response
    band = {"lower": shaken_run.frequency_hz[0], "upper": frequency[-1]}
    model = ema.Model(frf=response, freq=frequency, pol_order_high=60, **band)
    model.get_poles(show_progress=False)
    theirs = np.column_stack([model.pole_freq[-1], model.pole_xi[-1]])
    theirs = theirs[theirs[:, 1] > 0.0]
    for mode in wanted:
        nearest = theirs[np.argmin(np.abs(theirs[:, 0] - mode.frequency_hz))]
        assert mode.frequency_hz == pytest.approx(nearest[0], rel=0.005)
        if mode.frequency_hz < 25.0:  # beyond, neighbours overlap, and either side's damping follows the model's order
            assert mode.damping == pytest.approx(nearest[1], rel=0.15)


def test_a_layout_or_a_run_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml"):
        read_vibration_test(tmp_path / "none.toml", tmp_path, read_matlab)
    with pytest.raises(RecordingError, match=r"run_Run1\.mat"):
        read_vibration_test(LAYOUT, tmp_path, read_matlab)
    broken = tmp_path / "broken.toml"
    broken.write_text("rate_hz = 1.0\n")
    with pytest.raises(ConfigError, match="points"):
        read_vibration_test(broken, tmp_path, read_matlab)

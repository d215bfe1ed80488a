"""A replay against what was published: bits, rounding, differences."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.cli.main import main
from companion.evaluation.replay_comparison import ROUNDING_RATIO, ReplayComparison
from companion.records import CorrectedRange, ImuBatch, Record, Reject
from sitl_tests.unit.test_flight_report import mode

S = 1_000_000_000

RANGE = CorrectedRange(1, 1, 5_000_000_000, 25, 60.0, 0.6, 4e-3, 1e-4, 50.0, 40, True, None)


def compared(*pairs: tuple[CorrectedRange | None, CorrectedRange | None]) -> ReplayComparison:
    comparison = ReplayComparison()
    for recorded, replayed in pairs:
        comparison.compare(recorded, replayed)
    return comparison


def test_equal_records_are_identical() -> None:
    comparison = compared((RANGE, RANGE), (RANGE, dataclasses.replace(RANGE)))
    assert comparison.identical
    assert comparison.compared == 2
    assert comparison.sentence() == "identical to what was published"


@given(st.floats(1e-15, 0.1))
def test_a_ratio_is_rounding_up_to_the_limit(ratio: float) -> None:
    comparison = compared((RANGE, dataclasses.replace(RANGE, sigma_m=RANGE.sigma_m * (1.0 + ratio))))
    assert not comparison.identical or ratio < 1e-14
    assert (comparison.difference is None) is (ratio / (1.0 + ratio) <= ROUNDING_RATIO * (1.0 + 1e-9))


def test_what_is_small_now_is_judged_by_the_fields_largest_value() -> None:
    small, moved = (dataclasses.replace(RANGE, toe_rad=value) for value in (1e-12, 3e-12))
    assert compared((small, moved)).difference is not None
    assert compared((RANGE, RANGE), (small, moved)).difference is None


def test_a_covariance_is_judged_by_what_its_variances_allow() -> None:
    """Two quantities that hardly hang together: their covariance is rounding beside the product of their sigmas."""
    comparison = ReplayComparison()
    rows = {f"Deflection.covariance[{i}][{i}]": variance for i, variance in enumerate((4.0, 9.0))}
    for name, variance in rows.items():
        comparison._hold(name, variance, variance, 0.0)
    comparison._hold("Deflection.covariance[0][1]", 1e-9, 2e-9, 0.0)
    assert comparison.difference is None
    assert comparison.largest_ratio == pytest.approx(1e-9 / 6.0)
    comparison._hold("Deflection.covariance[0][1]", 1e-9, 6e-5, 0.0)
    assert comparison.difference is not None


@pytest.mark.parametrize(
    ("change", "differs"),
    [
        ({"t_host_ns": 5_000_000_900}, False),
        ({"t_host_ns": 5_000_002_000}, True),
        ({"matches": 41}, True),
        ({"trusted": False}, True),
        ({"reject": Reject.NO_MATCHES}, True),
        ({"range_m": float("inf")}, True),
    ],
)
def test_stamps_may_differ_by_a_microsecond_and_counts_and_words_not_at_all(
    change: dict[str, object], differs: bool
) -> None:
    comparison = compared((RANGE, dataclasses.replace(RANGE, **change)))  # type: ignore[arg-type]
    assert (comparison.difference is not None) is differs
    if differs:
        assert f"CorrectedRange.{next(iter(change))}" in str(comparison.difference)


def test_a_record_too_many_is_a_difference_and_behind_a_loss_it_is_not() -> None:
    assert compared((None, RANGE)).difference is not None
    lossy = ReplayComparison()
    lossy.compare(None, RANGE, lossy=True)
    lossy.compare(None, RANGE, lossy=True)
    assert lossy.identical
    assert lossy.behind_loss
    assert lossy.compared == 0


def test_the_wing_is_printed_as_it_was_at_the_last_sample(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once the sensors have stopped, the state is a forecast whose sigma grows until it is no longer tracked."""
    rows = "".join(f"{i / 500},-9.81,-9.80\n" for i in range(600))
    (tmp_path / "accel.csv").write_text("t_s,left_z_mps2,right_z_mps2\n" + rows)

    def driven(inputs: Iterator[Record], *_: object) -> Iterator[Record]:
        yield from (mode(record.received_host_ns) for record in inputs if isinstance(record, ImuBatch))
        last = mode(2 * S)
        yield dataclasses.replace(last, symmetric=dataclasses.replace(last.symmetric, rms_m=9e-3))

    monkeypatch.setattr("companion.cli.replay.drive", driven)
    assert main(["replay", str(tmp_path), "--airframe", "nadir-2m"]) == 0
    screen = capsys.readouterr().out
    assert "wing   symmetric 5.000 ±0.020 Hz, rms 3.00 ±0.20 mm" in screen


def test_tables_that_begin_before_0_are_replayed_as_those_that_begin_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t_s = np.arange(1200) / 200.0
    results = []
    for begins_s in (0.0, -3.0):
        rows = [f"{t:.3f},-9.8,{z:.4f},{z:.4f}" for t, z in zip(t_s + begins_s, -9.8 + np.sin(30.0 * t_s), strict=True)]
        (tmp_path / "accel.csv").write_text("\n".join(["t_s,root_z_mps2,left_z_mps2,right_z_mps2", *rows, ""]))
        main(["replay", str(tmp_path), "--airframe", "nadir-2m", "--json"])
        results.append(json.loads(capsys.readouterr().out))
    assert results[0]["outputs"]["ModeState"] > 10
    assert results[1]["outputs_sha256"] == results[0]["outputs_sha256"]
    assert any("t_s begins at -3 s" in text for text in results[1]["notices"])


def test_the_file_that_a_replay_wrote_is_no_recording_to_replay(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "accel.csv").write_text("t_s,left_z_mps2\n" + "".join(f"{k / 200:.3f},-9.8\n" for k in range(400)))
    out = tmp_path / "out.mcap"
    main(["replay", str(tmp_path), "--airframe", "nadir-2m", "--out", str(out)])
    assert main(["replay", str(out)]) == 1
    assert "replay the recording that it was made from" in capsys.readouterr().err

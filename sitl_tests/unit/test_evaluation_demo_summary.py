"""The tables of the demo: rows that judge different shots say so; the same shots are compared shot by shot."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from companion.cli.terminal.demo_tables import print_summary
from companion.evaluation.flight_evaluation import shot_requests
from companion.evaluation.metrics import Scored, range_summary, toe_summary
from companion.evaluation.shot_scores import Shots, paired
from companion.reporting.numbers import finite

BASELINE_M = 2.0


def shots(t_s: list[float], toe_error_rad: list[float]) -> Shots:
    """Shots at 60 m with stated errors."""
    true_m = np.full(len(t_s), 60.0)
    inverse = 1.0 / true_m + np.array(toe_error_rad) / BASELINE_M
    scored = Scored(BASELINE_M, np.array(t_s), true_m, inverse)
    return Shots(list(range(len(t_s))), scored.t_s, {"corrected": scored})


def test_two_runs_are_compared_on_the_shots_that_both_judge_and_on_no_others() -> None:
    ours = shots([11.0, 12.0, 13.0, 14.0], [1e-4, -2e-4, 1e-4, 5e-3])
    other = shots([11.0, 12.0, 13.0], [-2e-4, 1e-4, 3e-4])
    comparison = paired(ours, other)
    assert (comparison["n"], comparison["same"]) == (3, False)
    assert comparison["nearer"] == pytest.approx(1 / 3)
    assert comparison["rms_mrad"]["corrected"] == pytest.approx(np.sqrt((1 + 4 + 1) / 3) * 0.1)
    assert comparison["rms_mrad"]["other"] == pytest.approx(np.sqrt((4 + 1 + 9) / 3) * 0.1)
    assert paired(ours, ours)["same"]
    assert paired(ours, shots([11.1, 12.1], [0.0, 0.0])) == {"n": 0, "same": False}, "ids are equal, exposures are not"


def summary(ours: Shots, others: dict[str, Shots]) -> dict[str, Any]:
    """Arguments of print_summary, with nothing in it but the tables."""
    ways = {"corrected": ours.ways["corrected"], "oracle": ours.ways["corrected"]}
    ways |= {name: other.ways["corrected"] for name, other in others.items()}
    met = {"value": 0.0, "limit": 1.0, "met": True}
    return {
        "toe_error_mrad": {name: toe_summary(way) for name, way in ways.items()},
        "range_error_m": {name: range_summary(way) for name, way in ways.items()},
        "against_corrected": {name: paired(ours, other) for name, other in others.items()},
        "targets": {"share_of_error_removed": {"of_rigid": 1.0, "of_rigid_calibrated_in_trim": 1.0},
                    "fast_excess_mrad2": met, "oracle_median_at_60_m": met},
        "sigma": {"slow_error_over_sigma_rms": 1.0, "published_beyond_5_sigma": 0, "published_off_axis": 0},
        "trigger": {"aimed": {"shots": 0}, "blur_px": {}},
        "world": "ideal",
        "shots": {
            **dict.fromkeys(("fired", "pairs", "corrected", "trusted"), 0), "judged": len(ours.ids),
            "settled": {"from_s": 15.0, "pairs": 2, "trusted": 1},
            **{name: {} for name in ("planned", "fates", "not_trusted", "no_range")},
        },
        "published": {"received": {}},
    }  # fmt: skip


def test_a_row_of_other_shots_says_so_and_how_many(capsys: pytest.CaptureFixture[str]) -> None:
    t_s = [11.0 + k for k in range(20)]
    ours = shots(t_s, [1e-4] * 20)
    same = shots(t_s, [2e-4] * 20)
    random = shots([11.5 + k for k in range(7)], [1e-4] * 7)
    print_summary(summary(ours, {"vertical_only": same, "random_instants": random}))
    printed = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "at 60 m (20)" in printed
    assert "of 7" in printed
    assert "instants *" in printed
    assert "axes alone *" not in printed
    assert "other shots than the rows above" in printed
    assert "on the same 20 shots: 0.20 against 0.10 mrad rms, nearer the truth in 0 % of them" in printed


def test_without_comparisons_nothing_is_marked(capsys: pytest.CaptureFixture[str]) -> None:
    print_summary(summary(shots([11.0, 12.0], [1e-4, 1e-4]), {}))
    printed = capsys.readouterr().out
    assert "*" not in printed
    assert "other shots" not in printed


def test_a_flight_without_a_shot_to_judge_ends_in_a_sentence_and_not_in_tables_of_nan(
    capsys: pytest.CaptureFixture[str],
) -> None:
    print_summary(finite(summary(shots([], []), {})))
    printed = " ".join(capsys.readouterr().out.split())
    assert printed.startswith("no shot to judge: 0 fired")
    assert "nan" not in printed
    assert "\u2503" not in printed, "no table"


def test_what_json_does_not_have_is_none() -> None:
    assert finite({"a": [float("nan"), 1.5], "b": {"c": float("inf")}, "d": 3}) == {
        "a": [None, 1.5], "b": {"c": None}, "d": 3,
    }  # fmt: skip


def test_a_flight_that_ends_before_any_random_instant_asks_for_no_shot() -> None:
    assert shot_requests(np.empty(0), 10) == []
    first, second = shot_requests(np.array([1.0, 2.0]), 10)
    assert (first.earlier_edge_host_ns, second.earlier_edge_host_ns) == (None, 1_000_000_010)

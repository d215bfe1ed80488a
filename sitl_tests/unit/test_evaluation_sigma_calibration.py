"""Sigmas in a flight's summary: an error that every range names is one sigma, whatever caused it."""

from __future__ import annotations

import numpy as np
import pytest

from companion.evaluation.accuracy_targets import sigma_calibration
from companion.evaluation.metrics import Scored
from companion.evaluation.shot_scores import PipelineOutputs, Shots
from companion.records import CorrectedRange

BASELINE_M = 2.0


def _range(pair_id: int, range_m: float, sigma_m: float) -> CorrectedRange:
    return CorrectedRange(pair_id, 0, 0, 0, range_m, sigma_m, 0.0, 1e-5, 0.0, 100, True, None)


def test_a_range_that_is_off_by_its_own_sigma_counts_as_one_though_the_toe_is_known_better() -> None:
    """Focal lengths: the same share of every range, and no toe at all."""
    true_m, scale_error = np.linspace(5.0, 60.0, 200), 0.001
    measured_m = true_m * (1.0 + scale_error)
    scored = Scored(BASELINE_M, np.arange(200) * 0.1, true_m, 1.0 / measured_m)
    flown = PipelineOutputs(ranges={i: _range(i, measured_m[i], scale_error * true_m[i]) for i in range(200)})
    calibration = sigma_calibration(Shots(list(range(200)), scored.t_s, {"corrected": scored}), flown)
    assert calibration["slow_error_over_sigma_rms"] == pytest.approx(1.0, abs=0.01)
    assert calibration["published_error_over_sigma"]["rms"] == pytest.approx(1.0, abs=1e-6)


def test_what_says_that_it_knows_nothing_is_not_judged_by_a_sigma_that_was_cut_off() -> None:
    true_m = np.full(100, 50.0)
    inverse = np.full(100, 1.0 / 51.0)
    inverse[::2] = 1e-4
    scored = Scored(BASELINE_M, np.arange(100.0), true_m, inverse)
    ranges = {i: _range(i, 51.0, 1.0) if i % 2 else _range(i, 200.0, 200.0) for i in range(100)}
    calibration = sigma_calibration(
        Shots(list(range(100)), scored.t_s, {"corrected": scored}), PipelineOutputs(ranges=ranges)
    )
    assert calibration["slow_error_over_sigma_rms"] == pytest.approx(1.02, abs=0.05)

"""The slow part of the toe through the whole pipeline: tilt alone, matches alone, both; each says how good it is.

``python -m tools.bench slow`` prints the table over more seeds.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from companion.sim.flight.flight import build_flight
from tools.bench.slow import METHODS, SETTLED_S, Scored, TrueEyes, run, score_flight, wide_airframe

pytestmark = pytest.mark.long


FLIGHTS = 10


@pytest.fixture(scope="module")
def flown() -> dict[str, list[Scored]]:
    rows = run(seeds=range(1, FLIGHTS + 1), duration_s=40.0)
    return {method: [row for row in rows if row.method == method] for method in METHODS}


def _rms(rows: list[Scored], name: str) -> float:
    return float(np.sqrt(np.mean([getattr(row, name) ** 2 for row in rows])))


def test_both_together_hold_the_toe_that_tilt_alone_cannot(flown: dict[str, list[Scored]]) -> None:
    tilt, epipolar, both = (_rms(flown[method], "rms_mrad") for method in METHODS)
    assert both < 1.05 * epipolar < 0.3 * tilt
    assert both < 0.3  # 0.5 m at 60 m


@pytest.mark.parametrize(("method", "draws"), [(METHODS[0], 1), (METHODS[1], 3), (METHODS[2], 3)])
def test_the_sigma_of_each_is_honest(flown: dict[str, list[Scored]], method: str, draws: int) -> None:
    """All flights together, within 99 % of chi-square by as many independent errors as there are.

    Tilt's error is trim's, one draw of a flight; the matches' are remembered for some ten seconds of the thirty.
    """
    count = FLIGHTS * draws
    low, high = np.sqrt(chi2.ppf([0.005, 0.995], count) / count)
    assert low < _rms(flown[method], "whole_over_sigma") < high
    assert _rms(flown[method], "over_sigma") < high  # what lies above 0.5 Hz is in the sigma and not in the error


def test_tips_without_a_lateral_axis_do_not_claim_to_know_their_trim() -> None:
    """A sensor that is mounted askew and one that bends away lean alike: what the vertical axis shows is both."""
    base, count = wide_airframe(), 6
    left, right = (dataclasses.replace(tip, sends="xzpqr") for tip in (base.left, base.right))
    airframe = dataclasses.replace(base, left=left, right=right)
    rows = [score_flight(seed, 40.0, airframe)[METHODS.index("tilt only")] for seed in range(1, count + 1)]
    assert _rms(rows, "whole_over_sigma") < np.sqrt(chi2.ppf(0.995, count) / count)


def test_the_truth_has_what_no_inertial_sensor_sees() -> None:
    """Thermal set and mounting: they move the toe during the flight, by what the airframe says."""
    flight = build_flight(wide_airframe(), 1, SETTLED_S)
    eyes = TrueEyes(flight)
    slow_toe_rad = []
    for t_ns in range(0, 9_000_000_000, 500_000_000):
        bend = flight.truth.at(t_ns).slope_rad.sum()
        slow_toe_rad.append(eyes.toe_rad(t_ns) - bend)
    assert 1e-4 < np.abs(slow_toe_rad).max() < 5e-3
    assert np.ptp(slow_toe_rad) > 2e-5

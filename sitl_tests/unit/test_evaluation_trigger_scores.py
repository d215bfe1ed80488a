"""Peaks, limit and chance of the trigger's scores, on flights whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest

from companion.evaluation.trigger_scores import dominating, trigger_scores, true_peaks_s
from companion.params.files import load_airframe
from companion.records import ClockName, Firing, MatchSet, TriggerPlan
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.gust import GustKind
from companion.sim.flight.truth import MODAL
from sitl_tests.still_plan import still_plan

START_NS = 7_000_000_000


@pytest.fixture(scope="module")
def flight() -> Flight:
    airframe = load_airframe("nadir-2m")
    return build_flight(airframe, 3, plan=still_plan(40.0), gust=GustKind.WHITE, perturbed=False)


def aimed(instants_s: np.ndarray, ahead_s: float) -> tuple[list[TriggerPlan], list[MatchSet]]:
    nothing = np.zeros((0, 2))
    plans, matches = [], []
    for number, t_s in enumerate(instants_s.tolist()):
        at_ns, made_ns = START_NS + round(t_s * 1e9), START_NS + round((t_s - ahead_s) * 1e9)
        plans.append(TriggerPlan(number, Firing.PEAK, made_ns, at_ns, 0, 0.0, at_ns, made_ns))
        matches.append(MatchSet(number, number, (ClockName.HOST, ClockName.HOST), np.full(2, at_ns), 2_000_000, 0,
                                nothing, nothing, np.zeros(0), at_ns))  # fmt: skip
    return plans, matches


def test_random_instants_score_as_chance_has_it(flight: Flight) -> None:
    scores = trigger_scores(flight, *aimed(np.arange(12.0, 38.0, 0.37), 0.05), START_NS)
    # half a period between extremes: distances are uniform from 0 to a quarter period
    quarter_ms = 1e3 / float(flight.model.omega_radps[dominating(flight)]) * np.pi / 2.0
    # 2,000 and 71 draws of a uniform distance: the median is known to 1.1 and 6 % of the range; three sigma
    for way, allowed in (("at_random", 0.04), ("at_plan", 0.18)):
        median_ms = scores["deflection_peak_ms"][way]["median"]
        assert median_ms == pytest.approx(quarter_ms / 2.0, abs=allowed * quarter_ms)
    assert abs(scores["share_of_gain"]) < 0.5


def test_shots_at_the_peaks_score_zero_and_gain_what_there_is(flight: Flight) -> None:
    peaks = true_peaks_s(flight)
    wanted = peaks["deflection"][(peaks["deflection"] > 12.0) & (peaks["deflection"] < 38.0)][::5]
    scores = trigger_scores(flight, *aimed(wanted, 0.01), START_NS)
    assert scores["shots"] == len(wanted)
    assert scores["deflection_peak_ms"]["at_plan"]["p95"] < 1.0
    # 10 ms ahead free swing misses by no more than the gust moves a peak in that time
    assert scores["deflection_peak_ms"]["limit"]["median"] < 6.0
    assert scores["blur_px"]["limit"]["rms"] < scores["blur_px"]["at_random"]["rms"]


def test_the_symmetric_mode_dominates_and_its_peaks_are_where_the_rate_turns(flight: Flight) -> None:
    column = dominating(flight)
    peaks = true_peaks_s(flight)
    modal = flight.model.present(flight.truth.derivatives[:, MODAL])
    assert np.std(modal[:, column]) == np.max(np.std(modal, axis=0))
    frequency_hz = float(flight.model.omega_radps[column]) / (2 * np.pi)
    assert np.mean(np.diff(peaks["deflection"])) == pytest.approx(0.5 / frequency_hz, rel=0.1)
    toe_rate = flight.truth.derivatives[:, MODAL] @ flight.truth.shape.slope_radpm.sum(axis=0)
    still = int(np.sum(toe_rate[:-1] * toe_rate[1:] < 0.0))
    assert len(peaks["toe"]) < 0.9 * still, "a moment of stillness on the way is no peak"


def test_no_aimed_shot_is_no_score(flight: Flight) -> None:
    scores = trigger_scores(flight, [], [], START_NS)
    assert scores["shots"] == 0
    assert scores["toe_peak_ms"]["at_plan"] == {"n": 0}


@pytest.mark.parametrize("duration_s", [0.2, 1.0, 5.0, 10.5])
def test_a_flight_that_ends_before_the_tracker_settles_is_scored_over_its_length(duration_s: float) -> None:
    short = build_flight(load_airframe("nadir-2m"), 3, plan=still_plan(duration_s), gust=GustKind.WHITE)
    scores = trigger_scores(short, *aimed(np.array([0.6 * duration_s]), 0.01), START_NS)
    assert scores["shots"] == 1
    assert scores["blur_px"]["at_random"]["n"] == 2000
    assert scores["blur_px"]["at_random"]["rms"] > 0.0

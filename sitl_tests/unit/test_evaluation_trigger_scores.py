"""Peaks, limit and chance of the trigger's scores, on flights whose truth is known."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from companion.evaluation.trigger_scores import AimedShot, aimed_shots, dominating, trigger_scores, true_peaks_s
from companion.params.files import load_airframe
from companion.records import ClockName, Firing, MatchSet, TriggerPlan
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.gust import GustKind
from companion.sim.flight.truth import MODAL, STEP_NS, FlightTruth
from sitl_tests.still_plan import still_plan

START_NS = 7_000_000_000


def _with_antisymmetric(flight: Flight, of: Callable[[np.ndarray], np.ndarray]) -> Flight:
    """Copy whose first antisymmetric coordinate is a function of the symmetric one."""
    knots, derivatives = flight.truth.knots.copy(), flight.truth.derivatives.copy()
    for values in (knots, derivatives):
        values[:, MODAL.start + 1] = of(values[:, MODAL.start])
    return dataclasses.replace(flight, truth=FlightTruth(knots, derivatives, flight.truth.shape))


@pytest.fixture(scope="module")
def flight() -> Flight:
    """A flight in which the antisymmetric mode stands still."""
    airframe = load_airframe("nadir-2m")
    both = build_flight(airframe, 3, plan=still_plan(40.0), gust=GustKind.WHITE, perturbed=False)
    return _with_antisymmetric(both, np.zeros_like)


def aimed(instants_s: np.ndarray, ahead_s: float) -> list[AimedShot]:
    return [AimedShot(t_s, t_s - ahead_s) for t_s in instants_s.tolist()]


def test_random_instants_score_as_chance_has_it(flight: Flight) -> None:
    scores = trigger_scores(flight, aimed(np.arange(12.0, 38.0, 0.37), 0.05))
    # half a period between extremes: distances are uniform from 0 to a quarter period
    quarter_ms = 1e3 / float(flight.model.omega_radps[0]) * np.pi / 2.0
    # 2,000 and 71 draws of a uniform distance: the median is known to 1.1 and 6 % of the range; three sigma
    for way, allowed in (("at_random", 0.04), ("at_plan", 0.18)):
        median_ms = scores["deflection_peak_ms"][way]["median"]
        assert median_ms == pytest.approx(quarter_ms / 2.0, abs=allowed * quarter_ms)
    assert abs(scores["share_of_gain"]) < 0.5


def test_shots_at_the_peaks_score_zero_and_gain_what_there_is(flight: Flight) -> None:
    peaks = true_peaks_s(flight)
    wanted = peaks["deflection"][(peaks["deflection"] > 12.0) & (peaks["deflection"] < 38.0)][::5]
    scores = trigger_scores(flight, aimed(wanted, 0.01))
    assert scores["shots"] == len(wanted)
    assert scores["deflection_peak_ms"]["at_plan"]["p95"] < 1.0
    # 10 ms ahead free swing misses by no more than the gust moves a peak in that time
    assert scores["deflection_peak_ms"]["limit"]["median"] < 6.0
    assert scores["blur_px"]["limit"]["rms"] < scores["blur_px"]["at_random"]["rms"]


def test_the_symmetric_mode_dominates_and_its_peaks_are_where_the_rate_turns(flight: Flight) -> None:
    column, peaks = 0, true_peaks_s(flight)
    assert dominating(flight)[12_000:, column].all()
    modal = flight.model.present(flight.truth.derivatives[:, MODAL])
    assert np.std(modal[:, column]) == np.max(np.std(modal, axis=0))
    frequency_hz = float(flight.model.omega_radps[column]) / (2 * np.pi)
    assert np.mean(np.diff(peaks["deflection"])) == pytest.approx(0.5 / frequency_hz, rel=0.1)
    toe_rate = flight.truth.derivatives[:, MODAL] @ flight.truth.shape.slope_radpm.sum(axis=0)
    still = int(np.sum(toe_rate[:-1] * toe_rate[1:] < 0.0))
    assert len(peaks["toe"]) < 0.9 * still, "a moment of stillness on the way is no peak"


def test_of_two_modes_that_move_alike_the_peaks_of_both_count(flight: Flight) -> None:
    """In a copy the antisymmetric coordinate is the symmetric one, a quarter of its period later."""
    later = round(0.25 * 2e9 * np.pi / float(flight.model.omega_radps[0]) / STEP_NS)
    alike = _with_antisymmetric(flight, lambda symmetric: np.roll(symmetric, later))
    assert dominating(alike)[12_000:].mean() > 0.9
    count, twice = (len(true_peaks_s(each)["deflection"]) for each in (flight, alike))
    assert twice == pytest.approx(2 * count, rel=0.2)


def test_a_pair_belongs_to_the_plan_that_aimed_at_it() -> None:
    nothing = np.zeros((0, 2))
    planned_ns = [START_NS + 1_000_000_000, START_NS + 1_200_000_000]
    plans = [TriggerPlan(k, Firing.PEAK, 0, at, 0, 0.0, at, at - 50_000_000) for k, at in enumerate(planned_ns)]
    taken_ns = [planned_ns[1] + 2_000_000, planned_ns[0] + 90_000_000]  # and one between both
    clocks, none = (ClockName.HOST, ClockName.HOST), np.zeros(0)
    pairs = [
        MatchSet(k, k, clocks, np.full(2, at), 2_000_000, 0, nothing, nothing, none, at)
        for k, at in enumerate(taken_ns)
    ]
    ((exposed_s, planned_s),) = aimed_shots(plans, pairs, START_NS)
    assert (exposed_s, planned_s) == pytest.approx((1.202, 1.15))
    assert aimed_shots([], pairs, START_NS) == []


def test_no_aimed_shot_is_no_score(flight: Flight) -> None:
    scores = trigger_scores(flight, [])
    assert scores["shots"] == 0
    assert scores["toe_peak_ms"]["at_plan"] == {"n": 0}


@pytest.mark.parametrize("duration_s", [0.2, 1.0, 5.0, 10.5])
def test_a_flight_that_ends_before_the_tracker_settles_is_scored_over_its_length(duration_s: float) -> None:
    short = build_flight(load_airframe("nadir-2m"), 3, plan=still_plan(duration_s), gust=GustKind.WHITE)
    scores = trigger_scores(short, aimed(np.array([0.6 * duration_s]), 0.01))
    assert scores["shots"] == 1
    assert scores["blur_px"]["at_random"]["n"] == 2000
    assert scores["blur_px"]["at_random"]["rms"] > 0.0

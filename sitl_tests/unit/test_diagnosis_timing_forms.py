"""Clocks and exposures that wander in other forms: of the left node, set in mid-flight, each camera by itself."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.wing.effect import CameraView, viewed
from companion.core.wing.effects import catalogue
from companion.diagnosis.flights.proposals import candidates_of
from companion.diagnosis.flights.recordings import Flights, diagnose
from companion.diagnosis.flights.screen import screen
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.generic_effects import generic_effects
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.records import Side, Station
from sitl_tests.unit.test_diagnosis_generic_effects import flown
from tools.trial_generators import STRANGER
from tools.trial_judge import model_of
from tools.trial_truths.stranger.cases import fly_all, hide

T_S = np.linspace(0.0, 60.0, 7)


def test_a_left_clock_that_was_right_in_mid_flight() -> None:
    """6 ms a minute of the left node alone: the right one's rate is both and skew together, nothing."""
    kind = catalogue()["clock-skew"]
    effect = kind.from_values({"skew_s_per_min": -0.006, "both_s_per_min": 0.006, "set_at_s": 30.0})
    assert effect.sample_time(Station.RIGHT, T_S) == pytest.approx(T_S)
    assert effect.sample_time(Station.LEFT, T_S) - T_S == pytest.approx(-1e-4 * (T_S - 30.0))


@pytest.mark.slow
def test_each_parameter_of_a_clock_shifts_time_by_its_own_amount() -> None:
    model = flown()
    effect = catalogue()["clock-skew"].from_values({"skew_s_per_min": 0.006})
    t_s = model.observations.t_s
    zero = np.zeros_like(t_s)
    expected = [[zero, -t_s / 60.0], [-t_s / 60.0, -t_s / 60.0], [zero, zero + 1e-4]]
    for which, shift in enumerate(expected):
        assert model.time_shift(effect, which) == pytest.approx(np.array(shift), abs=1e-6)


@pytest.mark.slow
def test_cameras_that_wander_by_themselves_add_less_than_a_trigger_that_wanders() -> None:
    """Where both stations turn alike: (2 r)^2 together, 2 r^2 by themselves."""
    kind = catalogue()["exposure-jitter"]
    views = [
        viewed([kind.from_values({"jitter2_us2": 4e6, "together": together})], Side.LEFT, 0.0)
        for together in (0.0, 1.0)
    ]
    assert [view.jitter_s for view in views] == pytest.approx([0.002, 0.002])
    model = flown()
    motion = model.expect(np.zeros(len(model.belief.nuisances))).motion
    rows = np.zeros((2, motion.modal.shape[0], 1), dtype=np.complex128)
    rows[:, 0] = 1.0
    squared_rates = model._toe._squared_rates  # type: ignore[union-attr]
    separate, shared = (squared_rates(motion, rows, 0.0, view.jitter_shared) for view in views)
    assert separate == pytest.approx(0.5 * shared)


def test_exposures_that_wander_miss_a_fast_motion_on_average() -> None:
    """The mean of cos(omega (t + d)) over normal d is exp(-omega^2 sigma^2 / 2) cos(omega t)."""
    sigma_s, omega = 0.003, 2.0 * np.pi * np.array([5.0, 20.0, 40.0])
    wandered_s = sigma_s * np.random.default_rng(5).standard_normal(400_000)
    mean = np.array([np.mean(np.cos(each * wandered_s)) for each in omega])
    assert CameraView(jitter_s=sigma_s).follows(omega).real == pytest.approx(mean, abs=0.004)


@pytest.mark.slow
def test_a_clock_is_screened_as_right_at_the_start_in_the_middle_and_at_the_end_of_a_minute() -> None:
    kind = catalogue()["clock-skew"]
    terms = candidates_of([kind], [])
    assert [term.effect.set_at_s for term in terms] == [0.0, 30.0, 60.0]
    model = flown()
    for term in terms:
        (candidate,) = screen([model], Flights([model], [kind]).null(), [term]).candidates
        assert np.diag(candidate.information)[:2].min() > 0.0, "skew and what both have in common are told"


def test_a_clock_that_was_set_is_told_apart_from_one_that_drifts() -> None:
    step = next(kind for kind in generic_effects() if kind.name == "right clock set after 1/2 of the recording")()
    late_s = T_S - step.from_values({"late_s": 0.004}).sample_time(Station.RIGHT, T_S)
    assert late_s == pytest.approx(np.where(T_S > 30.0, 0.004, 0.0))
    assert step.from_values({"late_s": 0.004}).sample_time(Station.LEFT, T_S) == pytest.approx(T_S)


def _stranger(effects: dict[str, float], **extra: float) -> FlightModel:
    """A minute by the other hand, without manoeuvres."""
    label = hide([], (8.0, 8.0), np.random.default_rng(6))
    label.effects.update(effects)
    label.extra.update({"manoeuvres": 0.0} | extra)
    (tables,) = fly_all([label], [20.0], 41)
    return model_of(tables, STRANGER.airframe(20.0, 0.0), STRANGER.top_hz)


@pytest.mark.long
def test_a_left_clock_that_was_right_in_mid_flight_is_named_and_no_law_is_ahead() -> None:
    drifts = _stranger({"clock-skew": -0.009}, **{"clock-skew.set_at": 0.5, "clock-skew.node": 0.0})
    diagnosis = diagnose([drifts], [catalogue()[name] for name in ("clock-skew", "stream-delay", "torsion-coupling")])
    assert diagnosis.verdict is DiagnosisVerdict.EXPLAINED
    (cause,) = diagnosis.causes
    assert cause.term.effect.name == "clock-skew"
    skew, both, _ = cause.values
    assert skew == pytest.approx(-0.009, abs=4.0 * cause.sigmas[0])
    assert both == pytest.approx(0.009, abs=4.0 * cause.sigmas[1])


@pytest.mark.slow
def test_a_clock_that_was_set_shows_as_such_and_not_as_one_that_drifts() -> None:
    flight = Flights([_stranger({"clock-step": 0.004})])  # of the right node, after two fifths
    strength = {entry.name: abs(entry.z) for entry in flight.checks(flight.null())}
    set_clock = max((name for name in strength if "clock set" in name), key=lambda name: strength[name])
    assert set_clock in ("right clock set after 1/3 of the recording", "right clock set after 1/2 of the recording")
    assert strength[set_clock] > max(strength["right side ever later"], 5.0)

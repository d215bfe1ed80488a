"""The refit of a flight with one effect more."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from companion.core.wing.effects import catalogue
from companion.diagnosis.flights import recordings
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightFit, fit
from companion.evaluation.flight_models import models_of
from companion.params.airframe import NamedEffect
from companion.params.files import load_airframe
from companion.sim.flight.aircraft import demo_plan
from companion.sim.flight.flight import build_flight
from companion.sim.flight.tables import write_csv

STEPS = 2
"""Steps of a first fit here; with several recordings the nuisances are further away than the usual number leads."""


@pytest.mark.slow
def test_a_refit_goes_on_while_it_is_worse_than_the_model_that_it_extends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A scale of 15 % stands in nuisances with a prior of 0.5 %, and none moves more than three sigmas a step."""
    airframe, hidden = load_airframe("nadir-2m"), (NamedEffect("accel-scale", {"right": 0.15}),)
    write_csv(build_flight(airframe, 7, 30.0, effects=hidden, plan=demo_plan(30.0)), tmp_path)
    flights = recordings.Flights(models_of([tmp_path], airframe), [catalogue()["accel-scale"]])
    null = flights.null()
    (candidate,) = flights.screen(null, lambda _what, _ratio: None).candidates

    def hasty(models: Sequence[FlightModel], terms: Any, near: Any, rounds: int = STEPS, **options: Any) -> FlightFit:
        return fit(models, terms, near, STEPS if rounds == recordings._AT_FIRST else rounds, **options)

    monkeypatch.setattr(recordings, "fit", hasty)
    refitted = flights.refit(null, candidate)
    assert refitted is not None
    assert refitted[1].log_evidence > null.log_evidence
    assert refitted[1].terms[-1].effect.right == pytest.approx(0.15, abs=0.03)


@pytest.mark.slow
def test_an_effect_far_beyond_its_prior_is_fitted_under_a_wide_one(tmp_path: Path) -> None:
    """A baseline of 2 m that is 0.2 m wrong, ten prior sigmas: under its own prior it reads two thirds of that."""
    airframe, hidden = load_airframe("nadir-2m"), (NamedEffect("baseline-error", {"error_m": 0.2}),)
    write_csv(build_flight(airframe, 427, 60.0, effects=hidden, plan=demo_plan(60.0)), tmp_path)
    kind = catalogue()["baseline-error"]
    models = models_of([tmp_path], airframe)
    flights = recordings.Flights(models, [kind])
    null = flights.null()
    (candidate,) = flights.screen(null, lambda _what, _ratio: None).candidates
    refitted = flights.refit(null, candidate)
    assert refitted is not None
    wide, narrow = refitted[1], fit(models, (EffectTerm(kind.from_values({"error_m": 0.1})),), null)
    assert wide.value("error_m")[0] == pytest.approx(0.2, abs=3.0 * wide.value("error_m")[1])
    assert wide.log_evidence > narrow.log_evidence + 5.0
    assert narrow.value("error_m")[0] < 0.15

"""Forces with memory: the filter that they are on average acts in the model, and what no filter makes is a load."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.wing.effects import catalogue
from companion.core.wing.structure import structure_of
from companion.diagnosis.flights.lack_of_fit_tests import lack_of_fit_tests
from companion.diagnosis.flights.recordings import Flights
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flights import fit
from companion.diagnosis.model.linear_spectra import Spectra
from companion.params.files import parse_airframe
from companion.records import Side
from tools.trial_generators import STRANGER
from tools.trial_judge import model_of
from tools.trial_truths.belief import airframe_text
from tools.trial_truths.cases import Hidden, fly, noise_density
from tools.trial_truths.stranger.cases import fly_all, hide


def test_a_filter_of_the_motion_acts_like_the_stiffness_and_damping_that_it_is() -> None:
    airframe = parse_airframe(airframe_text(0.15), "trial")
    f_hz = np.linspace(0.0, 20.0, 400)
    spectra, structure = Spectra(airframe, (Side.LEFT, Side.RIGHT), f_hz), structure_of(airframe.wing)
    scale, softer, drag = np.ones(2), 0.1 * structure.stiffness_radps2, 0.5 * structure.damping_radps
    changed = dataclasses.replace(
        structure, stiffness_radps2=structure.stiffness_radps2 - softer, damping_radps=structure.damping_radps + drag
    )
    filtered = softer[..., None] - 2j * np.pi * f_hz * drag[..., None]
    expected = spectra.linear(changed, scale, (), {}).receptance
    receptance = spectra.linear(structure, scale, (), {}, filtered).receptance
    assert receptance[0, 0] == pytest.approx(expected[0], rel=1e-9)
    assert receptance[1, 1] == pytest.approx(expected[1], rel=1e-9)


@pytest.mark.slow
def test_a_spring_that_slips_comes_out_with_its_damping() -> None:
    """A quarter of the damping that slipping makes was in neither the spectra nor the data, and passed for another."""
    hidden = Hidden({"hysteresis": 0.28}, extra={"hysteresis.yield_m": 0.003})
    (tables,) = fly([hidden], [20.0], 92)
    model = model_of(tables, parse_airframe(airframe_text(noise_density(20.0)), "trial"))
    null = fit([model], ())
    fitted = fit([model], (EffectTerm(catalogue()["hysteresis"](0.2, 0.0025)),), null.values, 24, 5.0)
    assert fitted.values[-2] == pytest.approx(0.28, rel=0.2)
    tests = lack_of_fit_tests([model], fitted)
    assert abs(tests["force with speed"]) < 3.5
    assert abs(tests["force with speed times its amount"]) < 3.5


@pytest.mark.long
def test_a_spring_that_yields_bit_by_bit_is_fitted_on_the_higher_of_its_hills(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four springs that slip from 1.1 to 4.3 mm: from the yield whose score is best a fit ends at 0.5 mm."""
    label = hide([], (8.0, 8.0), np.random.default_rng(6))
    label.effects.update({"hysteresis": 0.27})
    label.extra.update({"manoeuvres": 0.0, "loudness": 0.84, "hysteresis.yield_m": 0.0027})
    (tables,) = fly_all([label], [20.0], 42)
    kind = catalogue()["hysteresis"]
    flights = Flights([model_of(tables, STRANGER.airframe(20.0, 0.0), STRANGER.top_hz)], [kind])
    null = flights.null()
    (candidate,) = flights.screen(null, lambda _what, _ratio: None).candidates
    refits = [flights.refit(null, candidate)]
    monkeypatch.setattr(kind, "multimodal", False)
    refits.append(flights.refit(null, candidate))
    everywhere, from_one = (entry[1] for entry in refits if entry is not None)
    assert 0.002 < everywhere.terms[0].values[1] < 0.005
    assert everywhere.log_evidence > from_one.log_evidence + 10.0

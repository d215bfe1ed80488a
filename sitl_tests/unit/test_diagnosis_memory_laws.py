"""Forces with memory: the filter that they are on average acts in the model, and what no filter makes is a load."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.wing.effect import ModalMotion
from companion.core.wing.effects import catalogue
from companion.core.wing.effects.damping.hysteresis import Hysteresis
from companion.core.wing.structure import structure_of
from companion.diagnosis.flights.lack_of_fit_tests import lack_of_fit_tests
from companion.diagnosis.flights.recordings import Flights
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flights import fit
from companion.diagnosis.model.linear_spectra import Spectra
from companion.diagnosis.spectral_matrices import full
from companion.params.files import parse_airframe
from companion.records import Floats, Side
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


def test_the_mean_derivative_of_a_force_is_what_small_bumps_of_the_motion_make() -> None:
    """Summed over lags, in (rad/s)^2; a sample in which a spring begins to slip counts in part, hence the tolerance."""
    structure = structure_of(parse_airframe(airframe_text(0.15), "trial").wing)
    t_s = np.arange(400) / 400.0
    q_m = np.stack([0.006 * np.sin(2.0 * np.pi * 5.0 * t_s), 0.001 * np.sin(2.0 * np.pi * 6.4 * t_s)])

    def force(deflection_m: Floats) -> Floats:
        still = np.zeros((2, 1))
        return law.force(ModalMotion(0.0, deflection_m, np.zeros_like(q_m), still, 1.0, structure))

    law, bump = Hysteresis(0.2, 0.0031), 1e-9
    motion = ModalMotion(0.0, q_m, np.zeros_like(q_m), np.zeros((2, 1)), 1.0, structure)
    weight = np.ones(len(t_s))
    left, right = law.mean_derivative(motion, weight)
    summed = np.zeros(len(t_s))
    for at in range(len(t_s)):
        bumped = q_m.copy()
        bumped[0, at] += bump
        summed[: len(t_s) - at] += (force(bumped) - force(q_m))[0, at:] / bump
    assert np.cumsum(0.5 * (left + right)) == pytest.approx(np.cumsum(summed / len(t_s)), abs=4.0)  # of 197


@pytest.mark.parametrize(("slipping_ratio", "yield_m"), [(0.1, 0.003), (0.3, 0.003), (0.2, 0.0015)])
def test_a_spring_that_slips_is_no_worth_in_itself(slipping_ratio: float, yield_m: float) -> None:
    """No force follows the speed, so that ln det S over all frequencies is that of a wing without it.

    A filter regressed band by band is not causal, and gave 10 nat for a share of 0.1.
    """
    (tables,) = fly([Hidden({"hysteresis": slipping_ratio}, extra={"hysteresis.yield_m": yield_m})], [40.0], 92)
    model = model_of(tables, parse_airframe(airframe_text(noise_density(40.0)), "trial"))
    level = []
    for terms in ((), (EffectTerm(Hysteresis(slipping_ratio, yield_m)),)):
        receptance = full(model.expect(np.zeros(len(model.belief.nuisances)), terms).motion.linear.receptance)
        level.append(2.0 * np.log(np.abs(np.linalg.det(np.moveaxis(receptance, -1, 0)))))
    change = level[1] - level[0]
    top = np.arange(len(change) - 400, len(change))
    beyond = np.mean(top**2 * change[-400:]) / len(change)  # it falls with the squared frequency
    assert np.sum(change) + beyond == pytest.approx(0.0, abs=1.5)


@pytest.mark.slow
def test_four_springs_that_slip_have_their_share() -> None:
    """The second truth's joint: the first share came out 0.25, 12 sigmas high.

    The likelier of two fits counts: by the rounding of a processor one may end where a wide yield explains as much.
    """
    labels = []
    for slipping_ratio, yield_m in ((0.13, 0.003), (0.2, 0.0021), (0.3, 0.0026)):
        label = hide([], (8.0, 8.0), np.random.default_rng(6))
        label.effects.update({"hysteresis": slipping_ratio})
        label.extra.update({"manoeuvres": 0.0, "loudness": 1.0, "hysteresis.yield_m": yield_m})
        labels.append(label)
    for label, tables in zip(labels, fly_all(labels, [20.0] * 3, 43), strict=True):
        model = model_of(tables, STRANGER.airframe(20.0, 0.0), STRANGER.top_hz)
        terms = [(EffectTerm(Hysteresis(*begun_at)),) for begun_at in ((0.2, 0.0025), (0.1, 0.004))]
        fits = (fit([model], term, None, 24, 5.0) for term in terms)
        fitted = max(fits, key=lambda each: each.log_likelihood)
        slipping_ratio, sigma = fitted.values[-2], np.sqrt(fitted.covariance[-2, -2])
        assert abs(slipping_ratio - label.effects["hysteresis"]) < 2.6 * sigma


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
def test_a_spring_that_yields_bit_by_bit_has_one_hill(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four springs that slip from 1.1 to 4.3 mm: a filter regressed band by band made a second hill at 0.5 mm."""
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
    assert everywhere.log_evidence == pytest.approx(from_one.log_evidence, abs=1.0)

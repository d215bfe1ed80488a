"""Laws without a name that compete with names: clocks that were set, leaks between channels, play, lines."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from companion.core.wing.effect import ModalMotion
from companion.core.wing.effects import catalogue
from companion.core.wing.model import WingModel
from companion.diagnosis.flights.outcome import FlightDiagnosis
from companion.diagnosis.flights.recordings import Flights, diagnose
from companion.diagnosis.flights.rival_models import _at_nothing, _clocks, _held_alike
from companion.diagnosis.flights.screen import screen
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.expectation import ToeErrors
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import expect, fit
from companion.diagnosis.model.generic_effects import PLAY, generic_effects
from companion.diagnosis.model.toe_regressors import taken_up
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.params.files import parse_airframe
from companion.records import Station
from tools.trial_generators import FIRST, STRANGER
from tools.trial_judge import model_of
from tools.trial_truths.belief import airframe_text
from tools.trial_truths.cases import Hidden, noise_density
from tools.trial_truths.cases import fly as fly_first
from tools.trial_truths.stranger.cases import StrangerHidden, fly_all, hide


def flown(**effects: float) -> FlightModel:
    (tables,) = fly_first([Hidden(effects)], 20.0, 78)
    return model_of(tables, parse_airframe(airframe_text(noise_density(20.0)), "trial"))


def diagnosed(seed: int, **effects: float) -> FlightDiagnosis:
    """A flight of the second truth, judged without what is hidden in it."""
    label = hide([], (8.0, 14.0), np.random.default_rng(seed))
    hidden = StrangerHidden(dict(effects), 1, label.salt, label.extra)
    (tables,) = fly_all([hidden], [20.0], seed)
    model = model_of(tables, STRANGER.airframe(20.0, 0.0), STRANGER.top_hz)
    return diagnose([model], [kind for name, kind in catalogue().items() if name not in effects])


def of_title(title: str) -> EffectTerm:
    (kind,) = [kind for kind in generic_effects() if kind.name == title]
    return EffectTerm(kind())


def term_of(name: str, **values: float) -> EffectTerm:
    return EffectTerm(catalogue()[name].from_values(values))


@pytest.mark.slow
def test_a_law_and_a_name_are_held_against_one_toe_covariance() -> None:
    """Where only the covariance differs that each fit took for the toe, neither explains more."""
    model = flown()
    named = fit([model], ())
    (expectation,) = named.state.expectations
    errors = expectation.toe_errors
    wider = dataclasses.replace(expectation, toe_errors=ToeErrors(1.5 * errors.posterior, errors.variance))
    rival = dataclasses.replace(
        named, log_likelihood=model.log_likelihood(wider), state=dataclasses.replace(named.state, expectations=(wider,))
    )
    assert abs(rival.log_likelihood - named.log_likelihood) > 2.0
    assert _held_alike([model], rival, named).log_likelihood == pytest.approx(named.log_likelihood, abs=1e-6)


@pytest.mark.slow
def test_a_drift_of_clocks_imitates_one_side_that_is_ever_later() -> None:
    model = flown()
    null = fit([model], ())
    skew = term_of("clock-skew", set_at_s=0.0)
    later = of_title("right side ever later")
    imitations = []
    for shapes in (False, True):
        screening = screen([model], null, [later, skew], shapes=shapes)
        names = [candidate.name for candidate in screening.candidates]
        imitations.append(screening.imitation[names.index(skew.name), names.index(later.name)])
    assert imitations[1] > 0.99 > imitations[0]


def test_names_at_nothing_stay_at_the_frequency_and_the_instants_of_their_fit() -> None:
    tone = _at_nothing(term_of("tone", frequency_hz=21.5, left_sine_mps2=0.3))
    assert tone.values == [0.0, 0.0, 0.0, 0.0, 21.5]
    assert _at_nothing(term_of("clock-skew", set_at_s=12.0, skew_s_per_min=0.004)).values == [0.0, 0.0, 12.0]


@pytest.mark.slow
def test_clocks_that_were_set_compete_with_names_that_shift_stamps_only() -> None:
    model = flown()
    assert not _clocks([model], [term_of("exposure-delay", delay_s=0.002)])
    beside_a_delay = _clocks([model], [term_of("stream-delay", delay_s=0.002)])
    beside_a_drift = _clocks([model], [term_of("clock-skew", skew_s_per_min=0.002)])
    assert all(term.log_trials == pytest.approx(np.log(len(beside_a_delay))) for term in beside_a_delay)
    assert all(term.log_trials == 0.0 for term in beside_a_drift)


@pytest.mark.slow
def test_a_leak_adds_the_share_of_the_other_side_s_spectrum() -> None:
    model = flown()
    null = fit([model], ())
    leak = of_title("left side showing the other side too")
    leaking = leak.with_values({"leaked_ratio": 0.1})
    values = np.append(null.values, 0.1)
    before, after = null.state.expectations[0], expect([model], values, (leaking,))[0]
    noise = before.motion.linear.noise[..., -before.spectrum.shape[-1] :]
    motion = before.spectrum - noise
    mix = np.array([[1.0, 0.1], [0.0, 1.0]])
    assert after.spectrum == pytest.approx(np.einsum("ij,jkf,lk->ilf", mix, motion, mix) + noise, rel=1e-9)


def test_play_keeps_the_first_part_of_every_reversal_from_the_cameras() -> None:
    t_s = np.linspace(0.0, 2.0, 4001)
    deflection = np.stack([np.sin(2.0 * np.pi * t_s), np.zeros(len(t_s))])
    missing = taken_up(deflection, "play of the mounts")
    reach = PLAY["play of the mounts"] * float(np.std(deflection[0]))
    # both halves move alike, and either camera lags by the play once it moves
    assert np.max(np.abs(missing)) == pytest.approx(2.0 * reach, rel=1e-6)
    moving_up = (t_s > 0.92) & (t_s < 1.2)
    assert missing[moving_up] == pytest.approx(2.0 * reach, rel=1e-6)


def test_a_lag_without_a_name_is_a_delay_to_first_order_and_a_gain_to_second() -> None:
    lag = of_title("both sides lagging").with_values({"lag_s": 0.002}).effect
    omega = 2.0 * np.pi * np.array([1.0, 20.0])
    response = lag.response(Station.LEFT, omega / (2.0 * np.pi))
    assert response is not None
    assert -np.angle(response[0]) == pytest.approx(0.002 * omega[0], rel=1e-4)
    assert np.abs(response) == pytest.approx(1.0 / np.hypot(1.0, 0.002 * omega))
    assert lag.response(Station.ROOT, omega) is None


def test_springs_that_slip_lose_a_larger_share_the_further_they_swing() -> None:
    """Work in a loop over the largest spring energy of it, and force in phase with the deflection."""
    wing = WingModel(parse_airframe(airframe_text(noise_density(20.0)), "trial").wing)
    t_s: Any = np.linspace(0.0, 8.0, 16001)
    swing = np.where(t_s < 4.0, 0.001, 0.004) * np.sin(2.0 * np.pi * t_s)
    q = np.zeros((wing.count, len(t_s)))
    q[0] = swing
    motion = ModalMotion(
        np.asarray(t_s), q, np.gradient(q, t_s, axis=1), np.zeros((wing.count, 1)), 1.0, wing.structure
    )
    force = of_title("springs that slip").with_values({"strength": 0.1}).effect.force(motion)
    assert force is not None
    loss, softening = [], []
    for start_s in (2.0, 6.0):
        loop = (t_s >= start_s) & (t_s < start_s + 1.0)
        size = float(np.max(np.abs(swing[loop])))
        loss.append(-np.trapezoid(force[0][loop], swing[loop]) / size**2)
        softening.append(float(np.sum(force[0][loop] * swing[loop]) / np.sum(swing[loop] ** 2)))
    assert 0.0 < loss[0] < 0.7 * loss[1]
    assert 0.0 < softening[0] < softening[1] < 0.1 * wing.structure.stiffness_radps2[0, 0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "offered"),
    [
        pytest.param("sensor-filter", ("exposure-delay", "coloured-gust"), marks=pytest.mark.long),
        ("hysteresis", ("frequency-shift", "quadratic-damping")),
    ],
)
def test_two_names_do_not_stand_for_one_law_that_has_none(hidden: str, offered: tuple[str, ...]) -> None:
    label = FIRST.hide([hidden], (8.0, 9.0), np.random.default_rng(3), 20.0)
    (tables,) = fly_first([label], 20.0, 78)
    model = model_of(tables, parse_airframe(airframe_text(noise_density(20.0)), "trial"))
    judged = diagnose([model], [catalogue()[name] for name in offered])
    assert judged.verdict is DiagnosisVerdict.UNEXPLAINED


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "size"),
    [
        pytest.param("clock-step", 0.004, marks=pytest.mark.long),
        pytest.param("crosstalk", 0.15, marks=pytest.mark.long),
        pytest.param("mount-play", 0.002, marks=pytest.mark.long),
    ],
)
def test_what_the_catalogue_lacks_gets_no_name(hidden: str, size: float) -> None:
    assert diagnosed(4711, **{hidden: size}).verdict is DiagnosisVerdict.UNEXPLAINED


@pytest.mark.long
@pytest.mark.parametrize(
    ("hidden", "size"),
    [
        ("clock-skew", 0.01),
        pytest.param("mount-lag", 0.0025, marks=pytest.mark.long),
        pytest.param("stream-delay", 0.003, marks=pytest.mark.long),
    ],
)
def test_names_stand_against_their_rivals(hidden: str, size: float) -> None:
    label = hide([], (8.0, 14.0), np.random.default_rng(12))
    (tables,) = fly_all([dataclasses.replace(label, effects={hidden: size})], [20.0], 12)
    model = model_of(tables, STRANGER.airframe(20.0, 0.0), STRANGER.top_hz)
    judged = diagnose([model], list(catalogue().values()))
    assert judged.verdict is DiagnosisVerdict.EXPLAINED
    (cause,) = judged.causes
    assert hidden in {cause.term.name, *cause.group}


@pytest.mark.slow
def test_every_flight_has_a_leak_and_play_among_its_directions() -> None:
    model = flown()
    names = {entry.name for entry in Flights([model]).checks(fit([model], ()))}
    assert {"left side showing the other side too", "range residual against play of the mounts"} <= names


@pytest.mark.long
def test_a_name_s_own_law_is_no_test_of_it() -> None:
    model = flown(**{"coulomb-friction": 0.4})
    named = fit([model], (term_of("coulomb-friction", friction_mps2=0.3),))
    own_law = catalogue()["coulomb-friction"].own_law
    assert own_law in {entry.name for entry in Flights([model]).checks(fit([model], ()))}
    assert own_law not in {entry.name for entry in Flights([model]).checks(named)}

"""Nameless departures: parameters beyond their priors, peaks, growing spread, rival laws; and a mount that rings."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from companion.core.wing.effects import catalogue
from companion.core.wing.structure import structure_of
from companion.diagnosis.data.observations import Observations
from companion.diagnosis.flights.adequacy import outliers
from companion.diagnosis.flights.lack_of_fit_tests import (
    _together,
    lack_of_fit_tests,
    normal_score_of_gamma,
    normal_score_of_products,
    normal_score_of_student,
)
from companion.diagnosis.flights.prior_tension import prior_tension
from companion.diagnosis.flights.proposals import best_trial
from companion.diagnosis.flights.recordings import diagnose
from companion.diagnosis.flights.ringing import neighbours_go_together, with_best_trials
from companion.diagnosis.flights.screen import screen
from companion.diagnosis.model.belief import believe
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import fit
from companion.diagnosis.model.generic_effects import generic_effects
from companion.diagnosis.selection.check import DiagnosisVerdict
from companion.params.files import parse_airframe
from companion.records import Floats, Side
from tools.trial_judge import model_of
from tools.trial_truths.belief import airframe_text
from tools.trial_truths.cases import Hidden, fly, hide, noise_density

RATE_HZ, COUNT = 100.0, 3000
SIDES = (Side.LEFT, Side.RIGHT)
TEXT = airframe_text(0.15)


def seen_by(text: str, up_mps2: Floats) -> FlightModel:
    count = len(up_mps2)
    observations = Observations(RATE_HZ, SIDES, up_mps2, np.zeros(2), False, np.ones(count), {}, None)
    return FlightModel(believe(parse_airframe(text, "trial"), SIDES, False, False), observations, 40.0)


def drawn(text: str, seed: int) -> Floats:
    """Accelerations (m, 2) as an airframe makes them by chance."""
    rng = np.random.default_rng(seed)
    empty = seen_by(text, rng.standard_normal((COUNT, 2)))
    return np.ascontiguousarray(empty.draw(empty.expect(np.zeros(len(empty.belief.nuisances))), rng).T)


def flown(**effects: float) -> FlightModel:
    (tables,) = fly([Hidden(effects)], 20.0, 77)
    return model_of(tables, parse_airframe(airframe_text(noise_density(20.0)), "trial"))


@pytest.mark.slow
@pytest.mark.parametrize("count", [8, 40])
def test_a_sum_of_few_squares_gets_the_strength_that_its_chance_is_worth(count: int) -> None:
    """Exponentials have the skewness 2, their sum that over the root of their number: beyond 3 lies 1 of 741."""
    sums = np.random.default_rng(1).gamma(count, size=200_000)
    z = np.array(
        [normal_score_of_gamma(score, 2.0 / np.sqrt(count)) for score in ((sums - count) / np.sqrt(count))[:4_000]]
    )
    expected = 4_000 * norm.sf(2.5)
    assert np.sum(z > 2.5) == pytest.approx(expected, abs=4.0 * np.sqrt(expected))


def test_a_score_over_a_scatter_from_few_draws_gets_the_strength_that_its_chance_is_worth() -> None:
    """Normal over the root of a mean of 9 squares: beyond 3 lies 1 of 67, and of what it is worth 1 of 370."""
    rng = np.random.default_rng(2)
    raw = rng.standard_normal(20_000) / np.sqrt(rng.chisquare(9, 20_000) / 9.0)
    z = np.array([normal_score_of_student(score, 9) for score in raw[np.abs(raw) > 3.0].tolist()])
    assert normal_score_of_student(-3.5, 9) == -normal_score_of_student(3.5, 9) < 0.0
    expected = 20_000 * 2.0 * norm.sf(3.0)
    assert np.sum(np.abs(z) > 3.0) == pytest.approx(expected, abs=4.0 * np.sqrt(expected))


@pytest.mark.parametrize("count", [8, 30])
def test_a_sum_of_few_products_gets_the_strength_that_its_chance_is_worth(count: int) -> None:
    """Either part of a product of two complex normals is a difference of two exponentials, half of each."""
    rng = np.random.default_rng(6)
    raw = (rng.gamma(count, size=400_000) - rng.gamma(count, size=400_000)) / np.sqrt(2.0 * count)
    z = np.array([normal_score_of_products(score, count) for score in raw[np.abs(raw) > 3.0].tolist()])
    assert normal_score_of_products(-4.0, count) == -normal_score_of_products(4.0, count) > -4.0
    assert normal_score_of_products(4.0, 1e6) == pytest.approx(4.0, abs=1e-3)
    expected = 400_000 * 2.0 * norm.sf(3.2)
    assert np.sum(np.abs(z) > 3.2) == pytest.approx(expected, abs=4.0 * np.sqrt(expected))
    assert np.sum(np.abs(raw) > 3.2) > expected + 4.0 * np.sqrt(expected)


def test_a_family_of_scores_with_long_tails_gets_the_strength_that_its_chance_is_worth() -> None:
    """Twenty sums of five products each: as a whole they scatter more than twenty normals."""
    rng = np.random.default_rng(7)
    scores = (rng.gamma(5, size=(20_000, 20)) - rng.gamma(5, size=(20_000, 20))) / np.sqrt(10.0)
    strongest = scores[np.argsort(-np.sum(scores**2, axis=1))[:700]]
    z = np.array([_together(family, np.eye(20), 20 * 3.0 / 5.0) for family in strongest])
    plain = np.array([_together(family, np.eye(20), 0.0) for family in strongest])
    expected = 20_000 * 2.0 * norm.sf(2.5)
    assert np.sum(z > 2.5) == pytest.approx(expected, rel=0.4)
    assert np.sum(plain > 2.5) > 1.6 * expected


@pytest.mark.slow
def test_outliers_of_noise_get_the_strength_that_their_chance_is_worth() -> None:
    rng = np.random.default_rng(4)
    strengths = np.concatenate([outliers(rng.standard_normal((1000, 600))) for _ in range(100)])
    # 23 of 100,000 by chance; three times as many where a kurtosis counts as the sum of few squares
    assert 10 < int(np.sum(strengths > 3.5)) < 46


@pytest.mark.slow
@pytest.mark.parametrize(("snr_db", "step_mps2"), [(20.0, 8.0), pytest.param(10.0, 14.0, marks=pytest.mark.long)])
def test_what_shows_in_the_samples_is_left_over_where_it_has_no_name(snr_db: float, step_mps2: float) -> None:
    (tables,) = fly([Hidden({"quantisation": step_mps2})], snr_db, 77, 20.0)
    model = model_of(tables, parse_airframe(airframe_text(noise_density(snr_db)), "trial"))
    named = diagnose([model], [catalogue()["quantisation"]])
    assert [cause.term.effect.name for cause in named.causes] == ["quantisation"]
    without = diagnose([model], [])
    assert without.verdict is DiagnosisVerdict.UNEXPLAINED
    assert f"multiples of {step_mps2:g}" in without.reason


@pytest.mark.long
def test_kicks_are_named_though_no_block_foretells_another_ones() -> None:
    label = hide(["impulsive-forcing"], (10.0, 10.0), np.random.default_rng(21))
    (tables,) = fly([label], 20.0, 78)
    model = model_of(tables, parse_airframe(airframe_text(noise_density(20.0)), "trial"))
    diagnosis = diagnose([model], [catalogue()["impulsive-forcing"]])
    assert [cause.term.effect.name for cause in diagnosis.causes] == ["impulsive-forcing"]
    (cause,) = diagnosis.causes
    hidden = label.effects["impulsive-forcing"]  # by ten sigmas, were it known how long a kick lasts
    for value, sigma in zip(cause.values[:9:3], cause.sigmas[:9:3], strict=True):
        assert abs(value - hidden) < 4.0 * sigma < 4.0 * hidden / 6.0


@pytest.mark.slow
def test_a_tone_pays_once_for_the_frequencies_that_it_might_have_had() -> None:
    """The prior of its frequency counts: the Bayes factor is that of the two models."""
    up, t_s = drawn(TEXT, 13), np.arange(COUNT) / RATE_HZ
    up[:, 1] += 1.5 * np.sin(2.0 * np.pi * 17.3 * t_s)
    model = seen_by(TEXT, up)
    diagnosis = diagnose([model], [catalogue()["tone"]])
    assert [cause.term.effect.name for cause in diagnosis.causes] == ["tone"]
    full_fit = fit([model], (diagnosis.causes[0].term,), diagnosis.null.values)
    assert diagnosis.causes[0].log_bayes_factor == pytest.approx(
        full_fit.log_evidence - diagnosis.null.log_evidence, abs=0.5
    )


def test_a_frequency_far_beyond_its_prior_is_told_and_one_within_is_not() -> None:
    """Believed 5.00 +- 0.05 Hz; the wing's is 0.5 Hz higher."""
    faster = TEXT.replace("frequency_hz={value=5.0,", "frequency_hz={value=5.5,")
    assert faster != TEXT
    for text, beyond in ((TEXT, False), (faster, True)):
        model = seen_by(TEXT, drawn(text, 3))
        tensions = prior_tension(model.belief, fit([model], ()))
        assert (tensions["symmetric.frequency beyond its prior"] > 5.0) == beyond
        assert (tensions["all airframe parameters together"] > 5.0) == beyond
        assert abs(tensions["antisymmetric.frequency beyond its prior"]) < 4.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sign", "how"), [(1.0, "both sides together"), pytest.param(-1.0, "side against side", marks=pytest.mark.long)]
)
def test_a_mode_that_nobody_believes_in_is_seen_where_it_is(sign: float, how: str) -> None:
    rng, up = np.random.default_rng(4), drawn(TEXT, 4)
    f_hz = np.fft.rfftfreq(COUNT, 1.0 / RATE_HZ)
    ratio2 = (f_hz / 17.0) ** 2
    gain = ratio2 / np.sqrt((1.0 - ratio2) ** 2 + (2 * 0.02) ** 2 * ratio2)
    rung = np.fft.irfft(np.fft.rfft(rng.standard_normal(COUNT)) * gain, COUNT)
    plain = _strongest_peak(up)
    assert abs(plain[1]) < 4.0
    name, z = _strongest_peak(up + 0.5 * np.std(up) * np.outer(rung / np.std(rung), [sign, 1.0]))
    assert z > 5.0
    assert name.startswith(how)
    assert float(name.split()[-2]) == pytest.approx(17.0, rel=0.06)


def _strongest_peak(up_mps2: Floats) -> tuple[str, float]:
    model = seen_by(TEXT, up_mps2)
    scores = lack_of_fit_tests([model], fit([model], ()))
    ((name, z),) = [entry for entry in scores.items() if entry[0].startswith(("both sides", "side against"))]
    return name, z


@pytest.mark.slow
def test_a_side_that_is_ever_later_is_told_from_one_that_is_late() -> None:
    """Up to 4 ms at the end and as early at the start; in the middle of the recording there is nothing to see."""
    up = drawn(TEXT, 11)
    t_s = np.arange(COUNT) / RATE_HZ
    fine = np.fft.irfft(np.fft.rfft(up[:, 1]), 32 * COUNT) * 32.0
    ever = np.interp(t_s - 0.004 * np.linspace(-1.0, 1.0, COUNT), np.arange(32 * COUNT) / (32 * RATE_HZ), fine)
    turned = np.fft.rfft(up[:, 1]) * np.exp(-2j * np.pi * np.fft.rfftfreq(COUNT, 1.0 / RATE_HZ) * 4e-4)
    late = np.fft.irfft(turned, COUNT)
    for shown, ever_later in ((ever, True), (late, False)):
        model = seen_by(TEXT, np.stack([up[:, 0], shown], 1))
        scores = lack_of_fit_tests([model], fit([model], ()))
        assert (scores["right side ever later"] > 5.0) is ever_later


@pytest.mark.slow
def test_a_filter_is_told_by_what_it_takes_from_either_side() -> None:
    up = drawn(TEXT, 12)
    f_hz = np.fft.rfftfreq(COUNT, 1.0 / RATE_HZ)
    gain = np.exp(-0.25 * (f_hz / 40.0) ** 2)
    for taken, name in (
        ((1.0, 1.0), "gain falling with frequency"),
        ((-1.0, 1.0), "gain falling with frequency, left against right"),
    ):
        both = [np.fft.irfft(np.fft.rfft(up[:, i]) * gain**sign, COUNT) for i, sign in enumerate(taken)]
        model = seen_by(TEXT, np.stack(both, 1))
        scores = lack_of_fit_tests([model], fit([model], ()))
        gain_scores = {key: scores[key] for key in scores if key.startswith("gain falling")}
        assert max(gain_scores, key=lambda key: gain_scores[key]) == name
        assert gain_scores[name] > 5.0
        assert min(gain_scores.values()) < 4.0


@pytest.mark.long
def test_a_second_mode_named_torsion_is_seen_by_the_cameras_that_it_tilts() -> None:
    hidden = Hidden({"second-mode": 0.006}, extra={"second-mode.frequency_hz": 26.0, "loudness": 1.0})
    (tables,) = fly([hidden], 30.0, 79)
    model = model_of(tables, parse_airframe(airframe_text(noise_density(30.0)), "trial"))
    null, named = fit([model], ()), {}
    for name, strength in (("torsion-coupling", "coupling"), ("second-mode", "participation")):
        term = EffectTerm(catalogue()[name].from_values({strength: 0.004, "frequency_hz": 26.0}))
        named[name] = lack_of_fit_tests([model], fit([model], (term,), null.values))
    tilted = "range residual against deflection of a further mode"
    assert named["torsion-coupling"][tilted] > 5.0
    assert abs(named["second-mode"][tilted]) < 4.0


@pytest.mark.long
def test_a_second_mode_in_noise_is_one_group_with_torsion_however_likely_either_is() -> None:
    """At 10 dB nothing but the priors of their strengths ranks the two; the cameras see neither."""
    hidden = Hidden({"second-mode": 0.0042}, extra={"second-mode.frequency_hz": 27.0, "loudness": 1.3})
    (tables,) = fly([hidden], 10.0, 80)
    model = model_of(tables, parse_airframe(airframe_text(noise_density(10.0)), "trial"))
    diagnosis = diagnose([model], [catalogue()[name] for name in ("second-mode", "torsion-coupling")])
    assert len(diagnosis.causes) == 1
    names = {diagnosis.causes[0].term.effect.name, *diagnosis.causes[0].group}
    assert names == {"second-mode", "torsion-coupling"}


@pytest.mark.slow
def test_ranges_that_spread_where_the_wing_is_fast_are_no_better_for_being_believed_coarse() -> None:
    """Exposures that wander by 3 ms; the matching's own noise is free."""
    model = flown(**{"exposure-jitter": 9e6})
    scores = lack_of_fit_tests([model], fit([model], ()))
    assert scores["range residual growing with its rate"] > 5.0
    assert scores["range residual growing with rates of both cameras"] > 5.0
    assert abs(scores["range residual growing with time"]) < 5.0


@pytest.mark.slow
def test_a_mount_that_rings_is_found_where_it_rings() -> None:
    """At 17.8 Hz: seen from a stiff mount the likelihood rises no further than to the next of many small hills."""
    model = flown(**{"mount-resonance": 8e-5})
    null, kind = fit([model], ()), catalogue()["mount-resonance"]
    led = best_trial([model], null, EffectTerm(kind()))
    assert led is not None
    assert led.term.log_trials > 0.0
    fitted = fit([model], (led.term,), null.values)
    softness_s2, damper_s = fitted.values[-2:]
    assert softness_s2 == pytest.approx(8e-5, rel=0.02)
    assert abs(damper_s) < 1e-4, "beside a loss of 4 %, which is 3.6e-4 s at that frequency, nothing damps it"
    assert fitted.log_evidence > null.log_evidence + 50.0


@pytest.mark.slow
def test_a_mount_is_screened_from_where_it_rings_if_exposures_go_together() -> None:
    """At 17.8 Hz its score at nothing, a gain that grows with frequency, says a fifth of what is there."""
    model = flown(**{"mount-resonance": 8e-5})
    null, kind = fit([model], ()), catalogue()["mount-resonance"]
    assert neighbours_go_together(null.state.expectations[0])
    screening = screen([model], null, [EffectTerm(kind())])
    (ringing,) = with_best_trials([model], null, screening).candidates
    assert ringing.z > screening.candidates[0].z + 3.0
    assert ringing.term.values[0] == pytest.approx(8e-5, rel=0.05)
    still = flown()
    assert not neighbours_go_together(fit([still], ()).state.expectations[0])


@pytest.mark.long
def test_a_name_that_comes_near_is_not_said_if_a_law_without_a_name_explains_more() -> None:
    """Ranges that are wrong by a constant share are no focal length, which would stretch the bending, too."""
    model = flown(**{"baseline-error": 0.12})
    both = [catalogue()[name] for name in ("baseline-error", "focal-error")]
    named = diagnose([model], both)
    assert named.verdict is DiagnosisVerdict.EXPLAINED
    assert [cause.term.effect.name for cause in named.causes] == ["baseline-error"]
    without = diagnose([model], both[1:])
    assert without.verdict is DiagnosisVerdict.UNEXPLAINED
    assert without.nearest == "focal-error"
    assert not without.causes


@pytest.mark.long
def test_a_slip_is_not_said_beside_a_spring_that_is_softer_throughout() -> None:
    """A frequency 7 % low is hysteresis as far as tests tell, and likelier a spring force of that ratio."""
    kinds = [catalogue()[name] for name in ("hysteresis", "frequency-shift")]
    named = diagnose([flown(**{"frequency-shift": -0.0727})], kinds, 1)
    assert named.verdict is DiagnosisVerdict.EXPLAINED
    assert [cause.term.effect.name for cause in named.causes] == ["frequency-shift"]


@pytest.mark.long
def test_a_slip_is_not_said_of_a_spring_that_is_softer_throughout() -> None:
    without = diagnose([flown(**{"frequency-shift": -0.09})], [catalogue()["hysteresis"]], 1)
    assert without.verdict is DiagnosisVerdict.UNEXPLAINED
    assert "force" in without.reason


def test_laws_along_with_deflection_and_speed_scale_stiffness_and_damping() -> None:
    """ln k + 0.02 is a frequency 1 % higher; against each other, sides couple both modes."""
    kinds = {kind.name: kind for kind in generic_effects()}
    believed = structure_of(parse_airframe(TEXT, "trial").wing)
    stiff = kinds["force with deflection"].from_values({"strength": 0.02}).structure(believed)
    np.testing.assert_allclose(stiff.stiffness_radps2, np.exp(0.02) * believed.stiffness_radps2)
    uneven = kinds["force with speed, left against right"].from_values({"strength": 0.1}).structure(believed)
    expected = 0.1 * np.sqrt(np.prod(np.diag(believed.damping_radps)[:2]))
    assert uneven.damping_radps[0, 1] == uneven.damping_radps[1, 0] == pytest.approx(expected)
    np.testing.assert_array_equal(np.diag(uneven.damping_radps), np.diag(believed.damping_radps))


def test_an_effect_s_own_law_is_one_of_the_laws_without_a_name() -> None:
    own_laws = {kind.own_law for kind in catalogue().values() if kind.own_law}
    assert own_laws <= {kind.name for kind in generic_effects()}
    assert "force with sign of speed" in own_laws

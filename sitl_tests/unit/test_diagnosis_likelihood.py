"""The super-model's likelihood against closed forms, and its derivatives against themselves."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from companion.core.stereo.geometry import Rig
from companion.core.wing.effects import catalogue
from companion.core.wing.model import WingModel
from companion.diagnosis.data.observations import Observations, RawRanges, RawRecording, RawStream, ToeData
from companion.diagnosis.data.resampling import observe
from companion.diagnosis.model.belief import believe
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import FlightsLikelihood, expect, fit, log_likelihood
from companion.diagnosis.model.linear_spectra import Spectra
from companion.diagnosis.model.motion import SmoothedMotion
from companion.diagnosis.model.nonlinear_correction import SensorLineariser, StatisticalLinearisation
from companion.diagnosis.model.toe import _toe_per_slope
from companion.diagnosis.selection.fisher_scoring import maximise
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import load_airframe, parse_airframe
from companion.records import Complexes, Floats, Side
from tools.trial_truths.belief import airframe_text

TOP_HZ = 40.0
RATE_HZ = 100.0


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return parse_airframe(airframe_text(0.15), "trial")


@pytest.fixture(scope="module")
def drawn(airframe: Airframe) -> FlightModel:
    """A recording drawn from the model's own spectrum."""
    return draw(airframe, {})


def draw(airframe: Airframe, truth: dict[str, float]) -> FlightModel:
    """A recording drawn from the model's own spectrum with some deviations."""
    rng = np.random.default_rng(5)
    m = 3000
    empty = Observations(RATE_HZ, (Side.LEFT, Side.RIGHT), rng.standard_normal((m, 2)), np.zeros(2), False,
                         np.ones(m), {}, None)  # fmt: skip
    model = FlightModel(believe(airframe, empty.sides, False, False), empty, TOP_HZ)
    deviations = np.array([truth.get(entry.key, 0.0) for entry in model.belief.nuisances])
    spectrum = np.moveaxis(model.expect(deviations).spectrum, -1, 0)
    root = np.linalg.cholesky(spectrum)
    noise = rng.standard_normal((len(spectrum), 2, 2)) @ np.array([1.0, 1j]) / np.sqrt(2.0)
    bins = np.zeros((m // 2 + 1, 2), dtype=complex)
    inside = np.isin(np.fft.rfftfreq(m, 1.0 / RATE_HZ), model.band_hz)
    bins[inside] = (root @ noise[..., None])[..., 0] * np.sqrt(m * RATE_HZ)
    up = np.fft.irfft(bins, m, axis=0)
    observations = dataclasses.replace(empty, up_mps2=up)
    return FlightModel(model.belief, observations, TOP_HZ)


def test_the_spectrum_of_one_mode_is_the_oscillators(airframe: Airframe, drawn: FlightModel) -> None:
    """Deflection's variance under the model is what the airframe says, and S_a = w^4 |H|^2 S_g + noise."""
    expectation = drawn.expect(np.zeros(len(drawn.belief.nuisances)))
    symmetric = 0.25 * np.einsum("ijf->f", expectation.spectrum).real  # of the mean of both tips
    f_hz = drawn.band_hz
    omega, w0, zeta = 2 * np.pi * f_hz, 2 * np.pi * 5.0, 0.03
    receptance = 1.0 / np.abs(w0**2 - omega**2 + 2j * zeta * w0 * omega)
    # white two-sided load density (per Hz) that gives 5 mm rms: variance = S/(4 zeta w0^3)
    load = 4 * zeta * w0**3 * 0.005**2
    expected = omega**4 * receptance**2 * load + 0.5 * (0.15**2 / 2.0)
    assert symmetric == pytest.approx(expected, rel=0.02)  # the load's level is a sum over bins


@pytest.mark.parametrize("phase_rad", [0.0, 0.5 * np.pi])
def test_ringing_that_the_recording_cuts_off_leaks_into_no_slow_bend(phase_rad: float) -> None:
    """q = A cos(w t + phi) is smoothed to itself 4 s from either end, though the recording holds no whole periods.

    What leaks to f counts w^2/f^2 times in the deflection, as far as the sensors' noise lets slow bending be told. The
    slow part of the readings is a wrong scale's.
    """
    quiet = draw(parse_airframe(airframe_text(0.005), "trial"), {})
    t_s = np.arange(3000) / RATE_HZ
    omega, amplitude_m = 2.0 * np.pi * 4.817, 0.003
    bend_m = amplitude_m * np.cos(omega * t_s + phase_rad)
    slow_mps2 = 0.01 * np.sin(2.0 * np.pi * 0.11 * t_s + 0.7)
    up = np.repeat((slow_mps2 - omega**2 * bend_m)[:, None], 2, axis=1)
    ringing = FlightModel(quiet.belief, dataclasses.replace(quiet.observations, up_mps2=up - up.mean(0)), TOP_HZ)
    inside = (t_s > 4.0) & (t_s < t_s[-1] - 4.0)
    smoothed_m = ringing.expect(np.zeros(len(quiet.belief.nuisances))).q_m[0]
    assert np.abs(smoothed_m - bend_m)[inside].max() < 0.02 * amplitude_m


@pytest.mark.parametrize(("name", "toe"), [("nadir-2m", 1.0), ("forward-2m", 0.0)])
def test_a_bend_turns_the_cameras_against_each_other_only_where_they_look_down(name: str, toe: float) -> None:
    """Ahead it turns both images about their axes, and no range shows it."""
    np.testing.assert_allclose(_toe_per_slope(Rig.from_airframe(load_airframe(name))), toe, atol=1e-12)


@pytest.mark.parametrize(("rigid", "low_ratio"), [({}, 0.4), ({"p": np.zeros(3000)}, 0.15)])
def test_an_aircraft_whose_roll_was_not_recorded_is_judged_above_its_rolls(
    drawn: FlightModel, rigid: dict[str, Any], low_ratio: float
) -> None:
    flown = dataclasses.replace(drawn.observations, has_root=True, rigid=rigid)
    lowest_hz = FlightModel(drawn.belief, flown, TOP_HZ).band_hz[0]
    assert lowest_hz == pytest.approx(low_ratio * 5.0, abs=RATE_HZ / 3000)


@pytest.mark.parametrize(("corner_hz", "share_at_corner"), [(10.0, 0.5), (40.0, 0.0)])
def test_noise_ahead_of_a_low_pass_is_shaped_by_it_where_that_can_be_told(
    airframe: Airframe, corner_hz: float, share_at_corner: float
) -> None:
    """White noise falls to half its density at a Butterworth corner; of noise behind it a little is left here."""
    left = dataclasses.replace(airframe.left, rate_hz=200.0, lowpass_accel_hz=corner_hz)
    belief = believe(dataclasses.replace(airframe, left=left), (Side.LEFT,), False, False)
    behind = {"left.noise": -20.0}
    deviation = belief.named([behind.get(entry.key, 0.0) for entry in belief.nuisances])
    spectra = Spectra(belief.airframe, (Side.LEFT,), np.array([0.0, corner_hz]))
    structure = WingModel(airframe.wing).structure
    noise = spectra.linear(structure, np.ones(1), (), deviation).noise[0, 0]
    believed = 0.5 * airframe.left.accel_noise_mps2_rthz**2
    assert noise[1] == pytest.approx(share_at_corner * believed, abs=1e-12 * believed)


@pytest.mark.parametrize("has_reference", [True, False])
def test_the_mean_bend_of_a_recording_is_as_uncertain_as_its_slowest_sway(
    airframe: Airframe, drawn: FlightModel, has_reference: bool
) -> None:
    """A load that is flat to zero frequency has a mean over the recording that is not known to be zero.

    The mean's variance is S(0) / T, that of the mean product with a cosine of one period S(1/T) / 2T. Where the mean is
    taken out of the toe, as without reference distances, it has none.
    """
    recorded = drawn.observations
    t_s = np.arange(0.05, recorded.duration_s, 0.1)
    toe = ToeData(t_s, np.zeros(len(t_s)), np.full(len(t_s), 0.02), has_reference)
    model = FlightModel(
        believe(airframe, recorded.sides, False, has_reference), dataclasses.replace(recorded, toe=toe), TOP_HZ
    )
    covariance = model.expect(np.zeros(len(model.belief.nuisances))).toe_errors.posterior
    weights = np.stack([np.ones(len(t_s)), np.cos(2.0 * np.pi * t_s / recorded.duration_s)]) / len(t_s)
    mean, sway = np.einsum("ik,kl,il->i", weights, covariance, weights)
    assert sway > 0.0
    assert mean == pytest.approx(2.0 * sway if has_reference else 0.0, rel=0.05, abs=0.05 * sway)


def test_a_wing_that_is_softer_one_way_sags_that_way_and_gets_softer(drawn: FlightModel) -> None:
    """Mean force -k kappa <w^2> of either half: it rests at -kappa <w^2>, with k (1 - 2 kappa^2 <w^2>)."""
    kappa, nothing = 14.0, np.zeros(len(drawn.belief.nuisances))
    straight = drawn.expect(nothing)
    bent = drawn.expect(nothing, [EffectTerm(catalogue()["quadratic-stiffness"].from_values({"kappa_per_m": kappa}))])
    moved = bent.motion.in_time[0]
    middle = moved[:, len(moved[0]) // 4 : -len(moved[0]) // 4]
    square = float(np.sum(np.var(middle, axis=1)))  # of a half: both modes'
    assert float(np.mean(middle[0])) == pytest.approx(-kappa * square, rel=0.15)
    softer = abs(straight.motion.linear.receptance[0, 0]) / abs(bent.motion.linear.receptance[..., 0].ravel()[0])
    full_square = float(np.sum(np.var(moved, axis=1)))
    assert 1.0 - softer == pytest.approx(2.0 * kappa**2 * full_square, rel=0.25)


def test_the_gradient_is_the_slope_of_the_likelihood(drawn: FlightModel) -> None:
    terms = (EffectTerm(catalogue()["stream-delay"](0.0004)), EffectTerm(catalogue()["frequency-shift"](0.01)))
    likelihood = FlightsLikelihood([drawn], terms)
    values = likelihood.start()
    scores = likelihood.scores(values)
    for i, entry in enumerate(likelihood.parameters):
        step = np.zeros(len(values))
        step[i] = 1e-3 * entry.sigma
        up, down = (log_likelihood([drawn], expect([drawn], values + sign * step, terms)) for sign in (1.0, -1.0))
        slope = (up - down) / (2.0 * step[i])
        tolerance = 0.02 * np.sqrt(scores.information[i, i]) + 0.02 / entry.sigma
        assert slope == pytest.approx(scores.gradient[i], abs=tolerance)


def test_a_fit_of_the_models_own_draw_stays_at_the_truth(drawn: FlightModel) -> None:
    fitted = fit([drawn], ())
    assert fitted.converged
    away = fitted.values / np.sqrt(np.diag(fitted.covariance))
    assert np.abs(away).max() < 4.0


def test_a_third_mode_of_the_file_is_fitted_like_the_others(airframe: Airframe) -> None:
    """A frequency 8 % off comes back: 30 s of a mode of 30 Hz tell it to sqrt(0.03 / (2 pi 30 x 30)), 0.23 %."""
    modes = [
        dataclasses.replace(airframe.wing.symmetric, frequency_hz=Uncertain(f_hz, 0.05 * f_hz)) for f_hz in (14.0, 30.0)
    ]
    wing = dataclasses.replace(airframe.wing, second_symmetric=modes[0], further_symmetric=(modes[1],))
    fitted = fit([draw(dataclasses.replace(airframe, wing=wing), {"further_symmetric.0.frequency": 0.08})], ())
    value, sigma = fitted.value("further_symmetric.0.frequency")
    assert 0.0015 < sigma < 0.006
    assert value == pytest.approx(0.08, abs=4.0 * sigma)


def test_three_modes_share_one_gust(airframe: Airframe) -> None:
    """No coherences with the first mode, however large, make a load of negative power; fully coherent ones make one."""
    modes = [dataclasses.replace(airframe.wing.symmetric, frequency_hz=Uncertain(f_hz, 0.1)) for f_hz in (14.0, 30.0)]
    wing = dataclasses.replace(airframe.wing, second_symmetric=modes[0], further_symmetric=(modes[1],))
    spectra = Spectra(dataclasses.replace(airframe, wing=wing), (Side.LEFT, Side.RIGHT), np.linspace(0.0, 40.0, 5))
    structure = WingModel(wing).structure

    def gust(second: float, third: float) -> Complexes:
        shared = {"second_symmetric.coherence": second, "further_symmetric.0.coherence": third}
        load = spectra.linear(structure, np.ones(2), (), shared).load
        symmetric = np.flatnonzero(np.array(structure.slots) % 2 == 0)
        return np.moveaxis(load[np.ix_(symmetric, symmetric)], -1, 0)

    for second, third in ((1.0, 1.0), (1.5, -1.5), (-5.0, 0.7)):
        power = np.linalg.eigvalsh(gust(second, third))
        assert np.all(power >= -1e-12 * power.max())
    together = np.linalg.eigvalsh(gust(5.0, 5.0))
    assert np.all(together[:, :-1] <= 1e-12 * together[:, -1:])


def _raw(t_s: Floats, force: Floats) -> RawRecording:
    return RawRecording({Side.LEFT: RawStream(t_s, force), Side.RIGHT: RawStream(t_s, force)})


def test_the_grid_keeps_a_sine_and_its_mean(airframe: Airframe) -> None:
    t_s = np.arange(20_001) / 1000.0  # a hundred whole periods
    force = -9.80665 + 0.3 - 2.0 * np.sin(2 * np.pi * 5.0 * t_s)
    (observations,) = observe(_raw(t_s, force), airframe, TOP_HZ)
    middle = slice(200, -200)
    assert observations.up_mps2[middle, 0] == pytest.approx(
        2.0 * np.sin(2 * np.pi * 5.0 * observations.t_s)[middle], abs=5e-3
    )
    assert observations.mean_force_mps2 == pytest.approx([0.3, 0.3], abs=1e-6)


def test_toe_is_measured_against_the_reference(airframe: Airframe) -> None:
    """4.5 mrad of divergence turns 60 m into 52.8 m."""
    t_s = np.arange(20_000) / 1000.0
    at = np.arange(2.0, 18.0, 0.1)
    raw = dataclasses.replace(
        _raw(t_s, np.sin(t_s)), ranges=RawRanges(at, np.full(len(at), 52.8), np.full(len(at), 60.0))
    )
    toe = observe(raw, airframe, TOP_HZ)[0].toe
    assert toe is not None
    assert toe.toe_rad == pytest.approx(np.full(len(toe.t_s), 1.98 * (1 / 52.8 - 1 / 60.0)))
    assert toe.toe_rad[0] == pytest.approx(4.5e-3, abs=5e-5)


def test_the_gradient_is_the_slope_where_a_spring_slips(drawn: FlightModel) -> None:
    """Nuisances are moved on the motion that is there; what the law's own parameters do to the motion counts."""
    terms = (EffectTerm(catalogue()["hysteresis"].from_values({"share": 0.15, "yield_m": 0.003})),)
    likelihood = FlightsLikelihood([drawn], terms)
    values = likelihood.start()
    scores = likelihood.scores(values)
    for i, entry in enumerate(likelihood.parameters):
        step = np.zeros(len(values))
        step[i] = 1e-3 * entry.sigma
        up, down = (log_likelihood([drawn], expect([drawn], values + sign * step, terms)) for sign in (1.0, -1.0))
        slope = (up - down) / (2.0 * step[i])
        # what a nuisance does to the motion, and so to the law's filter, is of second order: 0.21 for the noise
        tolerance = 0.25 * np.sqrt(scores.information[i, i]) + 0.02 / entry.sigma
        assert slope == pytest.approx(scores.gradient[i], abs=tolerance)


def test_a_step_beside_a_model_with_forces_smooths_no_motion_again(
    drawn: FlightModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    passes: list[object] = []
    linearise_forces = SensorLineariser.linearise_forces

    def counted(*args: Any) -> StatisticalLinearisation:
        passes.append(args)
        return linearise_forces(*args)

    monkeypatch.setattr(SensorLineariser, "linearise_forces", counted)
    terms = [EffectTerm(catalogue()["cubic-stiffness"](50.0))]
    nuisances = np.zeros(len(drawn.belief.nuisances))
    here = drawn.expect(nuisances, terms)
    assert len(passes) == 2
    louder = nuisances + np.array([1e-4 * (entry.key == "symmetric.level") for entry in drawn.belief.nuisances])
    assert drawn.expect(louder, terms, here, small_step=True).motion.modal is not here.motion.modal
    assert len(passes) == 2
    stiffer = [EffectTerm(catalogue()["cubic-stiffness"](50.01))]
    beside, from_scratch = drawn.expect(nuisances, stiffer, here, small_step=True), drawn.expect(nuisances, stiffer)
    np.testing.assert_array_equal(beside.spectrum, from_scratch.spectrum)


def test_a_height_that_is_scored_next_is_reached_once(drawn: FlightModel, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, expected = [0], FlightModel.expect

    def counted(model: FlightModel, *rest: Any) -> Any:
        asked[0] += 1
        return expected(model, *rest)

    likelihood, fresh = (FlightsLikelihood([drawn], [EffectTerm(catalogue()["tone"]())]) for _ in range(2))
    at = likelihood.start() + 0.1 * np.array([entry.sigma for entry in likelihood.parameters])
    state = likelihood.scores(likelihood.start()).state
    monkeypatch.setattr(FlightModel, "expect", counted)
    height = likelihood.log_likelihood(at, state)
    scores = likelihood.neighbour_scores(at, state)
    assert asked == [1]
    assert scores.log_likelihood == height
    assert np.array_equal(scores.gradient, fresh.neighbour_scores(at, state).gradient)


def test_derivatives_of_a_neighbour_lead_to_the_same_top(drawn: FlightModel) -> None:
    likelihood = FlightsLikelihood([drawn], ())
    start = likelihood.start() + 0.5 * np.array([entry.sigma for entry in likelihood.parameters])
    alone = maximise(likelihood, start, 24)
    led = maximise(likelihood, start, 24, likelihood.neighbour_scores)
    assert led.converged
    assert led.log_evidence == pytest.approx(alone.log_evidence, abs=0.02)
    assert np.abs((led.values - alone.values) / np.sqrt(np.diag(alone.covariance))).max() < 0.1


@pytest.mark.parametrize("wider", [1.0, 5.0])
def test_intervals_of_a_tone_s_amplitudes_are_those_of_its_phase(drawn: FlightModel, wider: float) -> None:
    """In 30 s a frequency is known to a thousandth of its prior: a step as large as that bends its difference.

    With amplitude A at phase 0 the frequency's error turns into a sine, of twice the sigma of the cosine's; the taper
    makes it 2.1.
    """
    tone = catalogue()["tone"].from_values({"left_cosine_mps2": 2.0, "frequency_hz": 30.0})
    likelihood = FlightsLikelihood([drawn], (EffectTerm(tone),), wider)
    information = likelihood.scores(likelihood.start()).information
    count = len(drawn.belief.nuisances)
    sigmas = np.sqrt(np.diag(np.linalg.inv(information[count:, count:][np.ix_([0, 1, 4], [0, 1, 4])])))
    assert sigmas[1] / sigmas[0] == pytest.approx(2.1, rel=0.02)


def test_a_kick_is_as_likely_at_the_end_of_a_recording_as_at_its_start(drawn: FlightModel) -> None:
    """The recording of 30 s is the last piece of one that began 210 s before it."""
    late = FlightModel(drawn.belief, dataclasses.replace(drawn.observations, start_s=210.0), TOP_HZ)
    kick = catalogue()["impulsive-forcing"].from_values({"at1_s": 211.0, "at2_s": 225.0, "at3_s": 239.0})
    likelihood = FlightsLikelihood([late], (EffectTerm(kick),), 5.0)
    start = likelihood.start()
    cost = [-0.5 * ((start[i] - entry.centre) / entry.sigma) ** 2 for i, entry in enumerate(likelihood.parameters)]
    by_key = {entry.key: worth for entry, worth in zip(likelihood.parameters, cost, strict=True)}
    assert by_key["at1_s"] == pytest.approx(by_key["at3_s"])
    assert -1.5 < by_key["at1_s"] < by_key["at2_s"] == 0.0
    sigma = {entry.key: entry.sigma for entry in likelihood.parameters}
    assert sigma["at1_s"] == pytest.approx(30.0 / np.sqrt(12.0))
    assert sigma["width_s"] == pytest.approx(0.01)


@pytest.mark.parametrize("name", ["impulsive-forcing", "periodic-forcing"])
def test_a_law_that_follows_no_motion_needs_none(
    drawn: FlightModel, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    smoothed: list[object] = []
    monkeypatch.setattr(SmoothedMotion, "_smoothed", lambda *args: smoothed.append(args))
    strength = catalogue()[name].parameters()[0].name
    term = EffectTerm(catalogue()[name].from_values({strength: 0.3}))
    nuisances = np.zeros(len(drawn.belief.nuisances))
    here = drawn.expect(nuisances, [term])
    stronger = EffectTerm(catalogue()[name].from_values({strength: 0.4}))
    assert np.any(drawn.expect(nuisances, [stronger], here, small_step=True).residual != here.residual)
    assert not smoothed

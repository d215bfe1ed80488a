"""Statistics of a diagnosis are what they say: standard normal where nothing is wrong, from wherever the fit begins."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.wing.effects import catalogue
from companion.diagnosis.data.observations import Observations
from companion.diagnosis.data.sample_defects import find_sample_defects, interpolate_clipped
from companion.diagnosis.flights.adequacy import check
from companion.diagnosis.flights.initial_values import regressed_start
from companion.diagnosis.flights.lack_of_fit_tests import lack_of_fit_tests
from companion.diagnosis.flights.proposals import Line, candidates_of, strongest_line
from companion.diagnosis.flights.screen import screen
from companion.diagnosis.flights.simulated_scores import is_sample_nonlinearity, score_scatter
from companion.diagnosis.model.belief import believe
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.flight_model import FlightModel
from companion.diagnosis.model.flights import fit
from companion.diagnosis.model.generic_effects import generic_effects
from companion.params.files import load_airframe, parse_airframe
from companion.records import Floats, Side
from tools.trial_truths.belief import airframe_text

TOP_HZ, RATE_HZ, COUNT = 40.0, 100.0, 3000
SIDES = (Side.LEFT, Side.RIGHT)
AIRFRAME = parse_airframe(airframe_text(0.15), "trial")


def model_of(up_mps2: Floats, airframe: object = AIRFRAME) -> FlightModel:
    count = len(up_mps2)
    observations = Observations(RATE_HZ, SIDES, up_mps2, np.zeros(2), False, np.ones(count), {}, None)
    return FlightModel(believe(airframe, SIDES, False, False), observations, TOP_HZ)  # type: ignore[arg-type]


def drawn(seed: int, times: Floats | float = 1.0, count: int = COUNT) -> FlightModel:
    """A recording as the belief makes it by chance, each sample ``times`` as large."""
    rng = np.random.default_rng(seed)
    empty = model_of(rng.standard_normal((count, 2)))
    believed = empty.expect(np.zeros(len(empty.belief.nuisances)))
    return model_of(np.ascontiguousarray((empty.draw(believed, rng) * times).T))


def test_a_draw_has_the_power_of_the_spectrum() -> None:
    model = drawn(1)
    expectation = model.expect(np.zeros(len(model.belief.nuisances)))
    misfit = np.einsum("if,ijf,jf->f", expectation.residual.conj(), expectation.inverse, expectation.residual).real
    assert np.mean(misfit) == pytest.approx(2.0, abs=0.15)  # two channels; 1100 bins of exponentials


@pytest.mark.parametrize("name", ["drifting in time", "bowed in time"])
def test_a_swelling_reading_scatters_by_the_root_of_two(name: str) -> None:
    """Score sum d |x|^2: of variance sum d^2, and the product of its column says half of that."""
    model = drawn(2)
    fitted = fit([model], ())
    law = next(kind() for kind in generic_effects() if kind.name == f"sensors with acceleration, {name}")
    unit = dataclasses.replace(law, strength=1e-3)  # type: ignore[call-arg]
    # 40 draws tell a standard deviation to 11 %
    assert score_scatter([model], fitted.state.expectations, [unit])[0] == pytest.approx(np.sqrt(2.0), rel=0.35)


@pytest.mark.slow
def test_scores_of_crooked_sensors_and_skewed_clocks_are_standard_normal_by_chance() -> None:
    names = ("accel-cubic", "clock-skew")
    strengths = {name: [] for name in names}  # type: ignore[var-annotated]
    for seed in range(8):
        model = drawn(10 + seed)
        screening = screen([model], fit([model], ()), [EffectTerm(catalogue()[name]()) for name in names])
        for candidate in screening.candidates:
            strengths[candidate.name].append(candidate.z)
    for name, z in strengths.items():
        # |z| of 8: a mean square of 1 with standard deviation 0.5
        assert np.mean(np.square(z)) < 3.0, name
        assert np.isfinite(z).all()


@pytest.mark.long
def test_a_drifting_clock_beside_strong_kicks_is_standard_normal_by_chance() -> None:
    """Three kicks are no matter of chance: what they tell of a clock adds to what a minute of gust tells."""
    kicks = {"at1_s": 4.0, "at2_s": 15.0, "at3_s": 26.0} | {
        f"{what}{k}_mps": size for what, size in (("symmetric", 3.3), ("antisymmetric", 1.3)) for k in (1, 2, 3)
    }
    term = EffectTerm(catalogue()["impulsive-forcing"].from_values(kicks))
    later = next(kind() for kind in generic_effects() if kind.name == "right side ever later")
    strengths, information = [], []
    for seed in range(40, 48):
        calm = drawn(seed)
        forced = calm.expect(np.zeros(len(calm.belief.nuisances)), (term,)).motion.forced_mps2
        assert forced is not None
        model = model_of(calm.observations.up_mps2 + calm.transforms.in_time(forced).T)
        screened = [
            screen([each], fit([each], terms), [EffectTerm(later)]) for each, terms in ((model, [term]), (calm, []))
        ]
        strengths.append(screened[0].candidates[0].z)
        information.append([float(entry.candidates[0].information[0, 0]) for entry in screened])
    # z^2 of 8: a mean square of 1 with standard deviation 0.5
    assert np.mean(np.square(strengths)) < 2.5
    kicked, unkicked = np.mean(information, axis=0)
    assert kicked > 2.0 * unkicked


def line_of(model: FlightModel) -> Line:
    return strongest_line(model, fit([model], ()).state.expectations[0])


def test_a_line_between_two_bins_is_as_strong_as_one_on_a_bin() -> None:
    """The nearest bins show 0.4 of it each; where it lies is told to a quarter of a bin."""
    calm, bin_hz = drawn(50), RATE_HZ / COUNT
    t_s = np.arange(COUNT) / RATE_HZ
    tails = []
    for place_hz in (600.0 * bin_hz, 600.5 * bin_hz):
        up = calm.observations.up_mps2.copy()
        up[:, 1] += 2.0 * np.sin(2.0 * np.pi * place_hz * t_s)
        line = line_of(model_of(up))
        assert line.frequency_hz == pytest.approx(place_hz, abs=0.3 * bin_hz)
        tails.append(line.log_tail)
    assert tails[0] < -15.0
    assert tails[1] == pytest.approx(tails[0], rel=0.25)


@pytest.mark.slow
def test_the_strongest_line_of_noise_has_the_chance_that_it_says() -> None:
    """A chance below e^-1 in a third of all recordings at most: of 30, 9.2 +- 2.5."""
    assert 2 <= sum(line_of(drawn(100 + seed)).log_tail < -1.0 for seed in range(30)) <= 16


@pytest.mark.parametrize("late", [Side.LEFT, Side.RIGHT])
def test_a_late_stream_is_screened_from_its_own_side(late: Side) -> None:
    """The first step leads to the side that is late, by as much; the other side's half of the effect counts nothing."""
    delay_s, model = 0.003, drawn(20)
    up = model.observations.up_mps2.copy()
    turned = np.fft.rfft(up[:, late]) * np.exp(-2j * np.pi * np.fft.rfftfreq(len(up), 1.0 / RATE_HZ) * delay_s)
    up[:, late] = np.fft.irfft(turned, len(up))
    shown = model_of(up)
    term = EffectTerm(catalogue()["stream-delay"]())
    assert len(candidates_of([type(term.effect)], ())) == 1
    candidates = screen([shown], fit([shown], ()), [term]).candidates
    assert len(candidates) == 1
    step_s = 0.005 * float(candidates[0].score[0] / (candidates[0].information[0, 0] + 1.0))
    assert candidates[0].z > 5.0
    assert step_s == pytest.approx(delay_s if late is Side.RIGHT else -delay_s, rel=0.25)


def test_a_clock_that_runs_away_is_told_with_its_sigma() -> None:
    """Skew of the right stream, at a signal ten times the noise only."""
    skew, rng = 0.009, np.random.default_rng(3)
    plain = drawn(30)
    t_s = np.arange(COUNT) / RATE_HZ
    up = plain.observations.up_mps2.copy()
    fine = np.fft.irfft(np.fft.rfft(up[:, 1]), 32 * COUNT) * 32.0
    up[:, 1] = np.interp(t_s - skew / 60.0 * t_s, np.arange(32 * COUNT) / (32 * RATE_HZ), fine)
    up += 0.5 * rng.standard_normal(up.shape)
    model = model_of(up)
    kind = catalogue()["clock-skew"]
    fitted = fit([model], [EffectTerm(kind())], fit([model], ()).values)
    value, sigma = fitted.value("skew_s_per_min")
    assert value > 3.0 * sigma
    assert abs(value - skew) < 3.0 * sigma


@pytest.mark.slow
def test_a_clock_that_was_named_leaves_no_warp_and_no_crooked_sensor() -> None:
    """Other laws of the samples are held against the stream as the named one has set it right."""
    skew, plain = 0.02, drawn(31)
    t_s = np.arange(COUNT) / RATE_HZ
    up = plain.observations.up_mps2.copy()
    fine = np.fft.irfft(np.fft.rfft(up[:, 1]), 32 * COUNT) * 32.0
    up[:, 1] = np.interp(t_s - skew / 60.0 * t_s, np.arange(32 * COUNT) / (32 * RATE_HZ), fine)
    model = model_of(up)
    term = EffectTerm(catalogue()["clock-skew"].from_values({"skew_s_per_min": skew}))
    scores = lack_of_fit_tests([model], fit([model], [term], fit([model], ()).values))
    for name in ("right side ever later", "all sensors together"):
        assert abs(scores[name]) < 4.2


def test_a_fit_begins_anywhere() -> None:
    """Sensors two hundred times noisier than the file says, a gust ten times as strong: the same answer."""
    quiet = parse_airframe(airframe_text(0.15 / 200.0), "quiet")
    near, far = drawn(4, 3.0), model_of(drawn(4, 3.0).observations.up_mps2, quiet)
    right = fit([near], (), regressed_start([near], np.zeros(len(near.belief.nuisances))))
    from_far = fit([far], (), regressed_start([far], np.zeros(len(far.belief.nuisances))))
    names = [entry.key for entry in near.belief.nuisances]
    shift = np.zeros(len(names))
    shift[[names.index("left.noise"), names.index("right.noise")]] = np.log(200.0)
    sigma = np.sqrt(np.diag(right.covariance))
    # the prior on the noise pulls a little: log 200 is 1.8 prior sigmas
    assert from_far.converged
    assert (np.abs(from_far.values - right.values - shift) < 0.3 * sigma + 0.01).all()


@pytest.mark.slow
def test_two_lines_that_were_never_there_together_are_no_two_modes() -> None:
    """The lower part of the spectrum in the first half, the upper in the second: on average as the model says."""
    count = 2 * COUNT  # at a minute's length the change is beyond doubt
    plain = drawn(5, count=count)
    still = {statistic.name: statistic.z for statistic in check([plain], fit([plain], ()))}
    assert max(abs(still[name]) for name in still if "changing in time" in name) < 4.0
    spectrum = np.fft.rfft(plain.observations.up_mps2, axis=0)
    below = np.fft.rfftfreq(count, 1.0 / RATE_HZ) < 5.6
    low, high = (np.fft.irfft(spectrum * band[:, None], count, axis=0) for band in (below, ~below))
    first = np.sqrt(1.0 + 0.95 * np.sin(2.0 * np.pi * np.arange(count) / count))[:, None]
    jumped = model_of(low * first + high * np.sqrt(2.0 - first**2))
    changed = {statistic.name: statistic.z for statistic in check([jumped], fit([jumped], ()))}
    assert changed["spectra changing in time"] > 5.0
    assert changed["first modes changing in time"] > 5.0


@pytest.mark.parametrize("low", [-np.inf, -14.0])
def test_a_range_that_is_cut_on_one_side_of_gravity_is_bridged_there(low: float) -> None:
    t_s = np.arange(4000) / 1000.0
    uncut = -9.8 + 12.0 * np.sin(2 * np.pi * 5.0 * t_s) + 1e-3 * np.sin(2 * np.pi * 0.61 * t_s)
    cut = np.clip(uncut, low, 1.7)
    sensor = load_airframe("nadir-2m").left
    mended = interpolate_clipped(t_s, cut, find_sample_defects(t_s, cut, sensor))
    assert np.abs(mended - uncut).max() < 0.2 * np.abs(cut - uncut).max()


def test_only_effects_of_the_samples_are_simulated() -> None:
    assert is_sample_nonlinearity(catalogue()["accel-cubic"]())
    assert not is_sample_nonlinearity(catalogue()["accel-scale"]())
    assert not is_sample_nonlinearity(catalogue()["cubic-stiffness"]())


def test_a_piece_of_some_seconds_is_checked_by_what_it_can_show() -> None:
    model = drawn(9, count=300)
    names = [entry.name for entry in check([model], fit([model], ()))]
    assert "left outliers" in names
    assert not any("changing in time" in name for name in names)


def test_recordings_with_different_sides_are_judged_together() -> None:
    both = drawn(10, count=1000)
    recorded = both.observations
    one_side = dataclasses.replace(
        recorded, sides=SIDES[:1], up_mps2=recorded.up_mps2[:, :1], mean_force_mps2=np.zeros(1)
    )
    for order in (1, -1):
        models = [FlightModel(both.belief, entry, TOP_HZ, 0) for entry in (recorded, one_side)[::order]]
        scores = lack_of_fit_tests(models, fit(models, ()))
        assert any(name.startswith("left with right near") for name in scores)

"""Stamps that repeat, go back, wander or are coarse, and recordings with gaps, are data."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from companion.core.wing.effects import catalogue
from companion.diagnosis.data.imputation import impute_missing
from companion.diagnosis.data.observations import RawRanges, RawRecording, RawStream
from companion.diagnosis.data.resampling import observe
from companion.diagnosis.data.sample_defects import find_sample_defects
from companion.diagnosis.data.segments import segments_of
from companion.diagnosis.data.stamps import in_order
from companion.errors import RecordingError
from companion.params.airframe import Airframe
from companion.params.files import parse_airframe
from companion.records import Bools, Floats, Side
from tools.trial_truths.belief import airframe_text

RATE_HZ, COUNT, TOP_HZ = 1000.0, 20_000, 40.0
T_S = np.arange(COUNT) / RATE_HZ
VALUES = np.random.default_rng(0).standard_normal(COUNT)


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    return parse_airframe(airframe_text(0.15), "trial")


def raw_of(t_s: Floats, force: Floats) -> RawRecording:
    return RawRecording({side: RawStream(t_s, force) for side in Side})


def shuffled(rng: np.random.Generator) -> np.ndarray:
    """Rows delivered up to 20 samples late."""
    return np.argsort(np.arange(COUNT) + 20.0 * rng.uniform(size=COUNT), kind="stable")


def test_good_stamps_stay_as_they_are() -> None:
    ordered = in_order(T_S, VALUES)
    assert ordered.t_s is T_S
    assert ordered.note == ""


def test_rows_out_of_order_and_twice_get_back_to_their_places() -> None:
    rng = np.random.default_rng(1)
    rows = shuffled(rng)
    rows = np.insert(rows, np.arange(100, COUNT, 50), rows[np.arange(100, COUNT, 50)])
    ordered = in_order(T_S[rows], VALUES[rows])
    assert np.array_equal(ordered.t_s, T_S)
    assert np.array_equal(VALUES[rows][ordered.rows], VALUES)


@pytest.mark.parametrize(
    ("spoil", "worst_s"),
    [
        (lambda rng: T_S + 0.001 * rng.standard_normal(COUNT), 0.001),  # wander by a period
        (lambda rng: np.round(T_S + 0.0007 * rng.standard_normal(COUNT), 3), 0.001),
        (lambda _: 0.004 * (np.arange(COUNT) // 4) + 0.0015, 0.001),  # four samples share a stamp
        (lambda _: np.round(T_S, 2), 0.002),
    ],
    ids=["wander", "wander, whole ms", "four to a stamp", "ten to a stamp"],
)
def test_samples_get_their_time_from_the_stamps_about_them(spoil: object, worst_s: float) -> None:
    assert callable(spoil)
    stamps = spoil(np.random.default_rng(2))
    ordered = in_order(stamps, VALUES)
    assert np.array_equal(ordered.rows, np.arange(COUNT))
    assert np.diff(ordered.t_s).min() > 0.0
    assert np.abs(ordered.t_s - T_S)[100:-100].max() < worst_s  # that of a single stamp's error, at most
    assert np.sqrt(np.mean((ordered.t_s - T_S) ** 2)) < 0.4 * np.sqrt(np.mean((stamps - T_S) ** 2))


def test_of_a_logger_that_started_anew_the_longest_run_counts() -> None:
    stamps = np.concatenate([T_S[:5000], T_S[:15_000]])
    ordered = in_order(stamps, VALUES)
    assert np.array_equal(ordered.rows, np.arange(5000, COUNT))
    late = np.insert(T_S, 10_000, 1.0)  # one late row is no new beginning
    assert len(in_order(late, np.insert(VALUES, 10_000, 7.0)).t_s) == COUNT


def test_stamps_that_all_are_the_same_are_no_recording(airframe: Airframe) -> None:
    with pytest.raises(RecordingError, match="record at least 8 s"):
        observe(raw_of(np.full(COUNT, 5.0), VALUES), airframe, TOP_HZ)


@pytest.mark.parametrize("factor", [1000.0, 300.0])
def test_stamps_that_are_no_seconds_are_refused_with_rate_and_frequency(airframe: Airframe, factor: float) -> None:
    first_hz = airframe.wing.symmetric.frequency_hz.value
    complaint = rf"sampled at {RATE_HZ / factor:.3g} Hz, .* mode of {first_hz:.3g} Hz.*\(t_s\) in seconds"
    with pytest.raises(RecordingError, match=complaint):
        observe(raw_of(factor * T_S, VALUES), airframe, TOP_HZ)


@pytest.mark.parametrize("how", ["wander", "lost", "held", "wander, whole ms"])
def test_dropout_jitter_is_seen_whatever_its_stamps_look_like(airframe: Airframe, how: str) -> None:
    rng = np.random.default_rng(3)
    t_s, values = T_S, VALUES
    gone = rng.uniform(size=COUNT) < 0.03
    if how.startswith("wander"):
        t_s = T_S + 0.001 * rng.standard_normal(COUNT)
        t_s = np.round(t_s, 3) if "ms" in how else t_s
    elif how == "lost":
        rows = shuffled(rng)
        t_s, values = T_S[rows][~gone[rows]], VALUES[rows][~gone[rows]]
    else:
        values = VALUES[np.maximum.accumulate(np.where(gone, 0, np.arange(COUNT)))]
    (defect,) = find_sample_defects(t_s, values, airframe.left)
    assert defect.name == "dropout-jitter"
    name, truth = ("jitter_s", 0.001) if how.startswith("wander") else ("lost", np.mean(gone))
    assert defect.values[name] == pytest.approx(truth, rel=0.1)


def test_rows_that_only_came_late_or_share_a_coarse_stamp_are_no_effect(airframe: Airframe) -> None:
    rows = shuffled(np.random.default_rng(4))
    assert find_sample_defects(T_S[rows], VALUES[rows], airframe.left) == []
    assert find_sample_defects(0.004 * (np.arange(COUNT) // 4), VALUES, airframe.left) == []


@pytest.mark.parametrize("rate_hz", [400.0, 610.0, 800.0, 990.0])
def test_stamps_in_whole_milliseconds_lose_no_samples_at_any_rate(airframe: Airframe, rate_hz: float) -> None:
    t_s = np.round(np.arange(COUNT) / rate_hz, 3)
    assert find_sample_defects(t_s, VALUES, airframe.left) == []
    shown = np.random.default_rng(8).uniform(size=COUNT) > 0.05
    (lost,) = find_sample_defects(t_s[shown], VALUES[shown], airframe.left)
    assert lost.name == "dropout-jitter"


def test_a_simulated_dropout_is_seen_in_what_it_writes(airframe: Airframe) -> None:
    """The effect's own stream: stamps are even, and a lost sample is the one before."""
    from companion.records import Station

    effect = catalogue()["dropout-jitter"].from_values({"jitter_s": 0.0, "lost": 0.05})
    smooth = np.interp(effect.sample_time(Station.LEFT, T_S), T_S, VALUES)
    (defect,) = find_sample_defects(T_S, smooth, airframe.left)
    assert defect.name == "dropout-jitter"
    assert defect.values["lost"] == pytest.approx(0.05, rel=0.2)


def ringing(rng: np.random.Generator, hz: float) -> Floats:
    pole = np.exp((-0.03 + 1j) * 2.0 * np.pi * hz / RATE_HZ)
    wave = lfilter([1.0, -2.0, 1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal(3 * COUNT))
    return np.asarray(wave / wave.std())


@pytest.mark.slow
@pytest.mark.parametrize("gap_ratio", [0.05, 0.35])
def test_what_was_drawn_in_gaps_has_the_power_and_the_coherence_of_the_rest(gap_ratio: float) -> None:
    rng = np.random.default_rng(5)
    alike, against = ringing(rng, 5.0), ringing(rng, 6.4)
    complete = np.stack([alike - against, alike + against]) + 0.1 * rng.standard_normal((2, 3 * COUNT))
    missing = np.zeros(complete.shape, dtype=np.bool_)
    for start in range(500, 3 * COUNT - 1500, 2000):
        missing[:, start : start + round(2000 * gap_ratio)] = True
    imputed = impute_missing(np.where(missing, 0.0, complete), missing)
    assert np.array_equal(imputed[~missing], complete[~missing])
    f_hz = np.fft.rfftfreq(3 * COUNT, 1.0 / RATE_HZ)
    for low_hz, top_hz in ((4.0, 5.7), (5.7, 8.0), (20.0, 400.0)):
        band = (f_hz > low_hz) & (f_hz < top_hz)
        (l0, r0), (l1, r1) = (np.fft.rfft(values)[:, band] for values in (complete, imputed))
        # of N resonant periods about N/2 are told apart: 60 s hold 50 bandwidths, a third of them drawn anew
        assert np.mean(abs(l1) ** 2) == pytest.approx(np.mean(abs(l0) ** 2), rel=0.25)
        shared0, shared1 = np.mean(l0 * r0.conj()), np.mean(l1 * r1.conj())
        assert abs(shared1 - shared0) < 0.25 * np.mean(abs(l0) ** 2)


def span_mask(*spans: tuple[float, float]) -> Bools:
    return np.any([(start <= T_S) & (stop > T_S) for start, stop in spans], axis=0)


def test_short_gaps_are_bridged_and_long_ones_part_a_recording(airframe: Airframe) -> None:
    inside = span_mask((0.0, 6.0), (6.5, 10.0), (11.9, 20.0))
    segments = observe(raw_of(T_S[inside], VALUES[inside]), airframe, TOP_HZ)
    assert [round(segment.duration_s) for segment in segments] == [10, 8]
    assert [segment.start_s for segment in segments] == pytest.approx([0.0, 11.9], abs=0.01)
    assert [segment.recorded_ratio for segment in segments] == pytest.approx([0.95, 1.0], abs=0.001)
    assert "2 gaps, the longest 1901 ms; 17.6 s in 2 segments are judged, 1 gap in them bridged" in segments[0].notes[0]


def test_the_mean_at_rest_is_that_of_what_was_recorded(airframe: Airframe) -> None:
    """Gaps from crest to crest of a swing: straight lines across them put the mean 2.4 m/s^2 off."""
    swing = 10.0 * np.cos(2.0 * np.pi * 5.0 * T_S) + VALUES
    inside = ~span_mask(*((start, start + 0.8) for start in np.arange(2.0, 18.0, 3.0)))
    tips = {side: RawStream(T_S[inside], swing[inside]) for side in Side}
    root = RawStream(T_S, np.random.default_rng(7).standard_normal(COUNT))
    (got,) = observe(RawRecording(tips, root), airframe, TOP_HZ)
    np.testing.assert_allclose(got.mean_force_mps2, 0.0, atol=0.3)


def test_eight_seconds_may_be_pieced_together_and_no_fewer(airframe: Airframe) -> None:
    pieces = [(2.5 * k + 0.0, 2.5 * k + 1.3) for k in range(8)]  # no stretch of 2 s
    inside = span_mask(*pieces)
    with pytest.raises(RecordingError, match=r"longest stretch without a gap is 1\.3 s; record at least 8 s in all"):
        observe(raw_of(T_S[inside], VALUES[inside]), airframe, TOP_HZ)
    inside = span_mask((0.0, 2.5), (4.0, 6.5), (8.0, 10.5), (12.0, 14.5))
    segments = observe(raw_of(T_S[inside], VALUES[inside]), airframe, TOP_HZ)
    assert len(segments) == 4
    assert sum(segment.recorded_s for segment in segments_of([T_S[inside]])) == pytest.approx(10.0, abs=0.01)


def test_no_range_is_used_where_the_wing_was_not_seen(airframe: Airframe) -> None:
    inside = span_mask((0.0, 8.0), (8.6, 20.0))
    at = np.arange(0.05, 20.0, 0.1)
    rng = np.random.default_rng(6)
    far = np.full(len(at), 50.0)
    shown = rng.permutation(len(at))  # rows of the ranges may come in any order, too
    tips = {side: RawStream(T_S[inside], VALUES[inside]) for side in Side}
    (observations,) = observe(RawRecording(tips, None, RawRanges(at[shown], 40.0 + at[shown], far)), airframe, TOP_HZ)
    assert observations.toe is not None
    assert np.diff(observations.toe.t_s).min() > 0.05
    assert not ((observations.toe.t_s > 7.4) & (observations.toe.t_s < 9.2)).any()
    assert np.diff(observations.toe.toe_rad).max() < 0.0


@pytest.mark.parametrize("piece_s", [9.0, 12.0])
def test_no_range_within_three_seconds_of_an_end_is_used(airframe: Airframe, piece_s: float) -> None:
    """A short piece fades over less, and the motion is not known there for all that."""
    inside = span_mask((0.0, piece_s))
    at_s = np.arange(0.05, piece_s, 0.02)
    tips = {side: RawStream(T_S[inside], VALUES[inside]) for side in Side}
    (got,) = observe(RawRecording(tips, None, RawRanges(at_s, np.full(len(at_s), 40.0))), airframe, TOP_HZ)
    assert got.toe is not None
    assert 3.0 <= got.toe.t_s.min() < got.toe.t_s.max() <= piece_s - 3.0


def test_samples_that_are_no_numbers_count_as_lost(airframe: Airframe) -> None:
    holed = VALUES.copy()
    holed[5000:5030], holed[12_000] = np.nan, np.inf
    tips = {Side.LEFT: RawStream(T_S, holed), Side.RIGHT: RawStream(T_S, VALUES)}
    lost = np.isfinite(holed)
    expected = {Side.LEFT: RawStream(T_S[lost], VALUES[lost]), Side.RIGHT: RawStream(T_S, VALUES)}
    (got,), (as_lost,) = (observe(RawRecording(each), airframe, TOP_HZ) for each in (tips, expected))
    np.testing.assert_array_equal(got.up_mps2, as_lost.up_mps2)
    assert got.notes[0] == "left: 31 of 20000 samples are no numbers and count as lost"


def test_what_was_recorded_with_the_root_stays_beside_it(airframe: Airframe) -> None:
    rate = np.sin(T_S)
    rate[7000:7010] = np.nan
    channel = np.where(np.arange(COUNT) % 1000, T_S, np.nan)
    raw = RawRecording(
        {side: RawStream(T_S, VALUES) for side in Side},
        RawStream(T_S, VALUES - 9.8),
        covariates={"airspeed_mps": (T_S, channel)},
        rigid={"p": (T_S, rate)},
    )
    (got,) = observe(raw, airframe, TOP_HZ)
    assert "root: 10 of 20000 samples are no numbers and count as lost" in got.notes
    assert all(np.isfinite(values).all() for values in (got.up_mps2, *got.covariates.values(), *got.rigid.values()))


def test_a_stream_without_numbers_is_told(airframe: Airframe) -> None:
    with pytest.raises(RecordingError, match="left: none of its 20000 samples is a number"):
        observe(raw_of(T_S, np.full(COUNT, np.nan)), airframe, TOP_HZ)


def test_a_range_that_is_no_number_is_left_out_and_an_infinite_one_is_not(airframe: Airframe) -> None:
    at_s = np.arange(4.0, 16.0, 0.1)  # clear of the ends, where the smoothed wing is not known
    range_m = 40.0 + np.zeros(len(at_s))
    range_m[50], range_m[70] = np.nan, np.inf
    tips = {side: RawStream(T_S, VALUES) for side in Side}
    (got,) = observe(RawRecording(tips, None, RawRanges(at_s, range_m, np.full(len(at_s), 40.0))), airframe, TOP_HZ)
    assert got.toe is not None
    np.testing.assert_array_equal(got.toe.t_s, np.delete(at_s, 50))
    assert np.isfinite(got.toe.toe_rad).all()


def test_a_dead_channel_is_named(airframe: Airframe) -> None:
    tips = {Side.LEFT: RawStream(T_S, np.zeros(COUNT)), Side.RIGHT: RawStream(T_S, VALUES)}
    with pytest.raises(RecordingError, match="left_z never changes: check its sensor"):
        observe(RawRecording(tips), airframe, TOP_HZ)


def test_drop_outs_to_zero_end_no_range(airframe: Airframe) -> None:
    force = np.where(np.arange(COUNT) % 500 < 2, 0.0, VALUES - 9.8)
    assert "saturation" not in [entry.name for entry in find_sample_defects(T_S, force, airframe.left)]


@pytest.mark.parametrize(("climb_m", "judged"), [(0.0, True), (15.0, False)])
def test_ranges_over_a_distance_that_changes_are_left_out_without_a_reference(
    airframe: Airframe, climb_m: float, judged: bool
) -> None:
    at_s = np.arange(0.05, 20.0, 0.1)
    range_m = 40.0 + climb_m * at_s / 20.0 + np.random.default_rng(9).standard_normal(len(at_s))
    tips = {side: RawStream(T_S, VALUES) for side in Side}
    (got,) = observe(RawRecording(tips, None, RawRanges(at_s, range_m)), airframe, TOP_HZ)
    assert (got.toe is not None) == judged
    assert any("no reference_m" in note for note in got.notes) != judged
    with_reference = RawRanges(at_s, range_m, 40.0 + climb_m * at_s / 20.0)
    (measured,) = observe(RawRecording(tips, None, with_reference), airframe, TOP_HZ)
    assert measured.toe is not None

"""The tracker as its callers see it: order of arrival, spacing of calls, refusals, validity."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.kernels.arrays import Epochs
from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.tracker import WingTracker
from companion.params.settings import Settings
from companion.records import Axis, ClockName, Deflection, ImuBatch, ModeState, Reject, Station, Validity
from sitl_tests.unit.tracking_samples import EPOCH_NS, MS, G, batch, plain_airframe, swinging


def _run(
    t: np.ndarray,
    values: dict[Station, np.ndarray],
    every_ms: int = 40,
    until_ms: dict[Station, int] | None = None,
    adapt: int = 1,
) -> tuple[WingTracker, list[ModeState]]:
    tracker, states = WingTracker(plain_airframe(), Settings(adapt=adapt)), []
    for first in range(0, len(t), every_ms):
        for station, v in values.items():
            chunk = slice(first, min(first + every_ms, (until_ms or {}).get(station, len(t))))
            if chunk.stop > chunk.start:
                tracker.add(batch(station, t[chunk], v[chunk]))
        state = tracker.advance(EPOCH_NS + (first + every_ms) * MS)
        if state is not None:
            states.append(state)
    return tracker, states


@pytest.fixture(scope="module")
def moving() -> tuple[np.ndarray, dict[Station, np.ndarray]]:
    return swinging(4.0, 0.005)


def test_there_is_no_state_before_root_and_a_tip_are_heard() -> None:
    t, values = swinging(0.4, 0.005)
    for missing in (Station.ROOT, None):
        tracker = WingTracker(plain_airframe(), Settings())
        for station in (Station.LEFT, Station.RIGHT) if missing is Station.ROOT else (Station.ROOT,):
            tracker.add(batch(station, t, values[station]))
        assert tracker.advance(int(t[-1])) is None
        assert tracker.smooth(int(t[200])) is Reject.NOT_SETTLED
        assert tracker.forecast(100 * MS, MS) is Reject.NOT_SETTLED


def test_how_calls_are_spaced_does_not_change_the_answer(moving: tuple[np.ndarray, dict[Station, np.ndarray]]) -> None:
    t, values = moving
    answers = [_run(t, values, every, adapt=0)[0].smooth(EPOCH_NS + 3300 * MS) for every in (20, 400)]
    first, second = answers
    assert isinstance(first, Deflection)
    assert isinstance(second, Deflection)
    sigma = np.sqrt(np.diag(first.covariance))
    assert (np.abs(first.q_m - second.q_m) < 1e-6 * sigma[:2]).all()
    np.testing.assert_allclose(np.sqrt(np.diag(second.covariance)), sigma, rtol=1e-6)


@pytest.mark.slow
def test_the_turns_in_which_spread_work_is_done_do_not_change_the_answer() -> None:
    """Stages that run between epochs, and stages that all run when their result is due: equal to the last bit."""
    t, values = swinging(12.6, 0.005)
    line = 3.0 * np.cos(2.0 * np.pi * 83.0 * (t - t[0]) * 1e-9)
    shaken = {station: v + line[:, None] * (np.arange(6) == 2) for station, v in values.items()}
    idle, busy = WingTracker(plain_airframe(), Settings()), WingTracker(plain_airframe(), Settings())
    for first in range(0, len(t), 40):
        for tracker in (idle, busy):
            for station, v in shaken.items():
                tracker.add(batch(station, t[first : first + 40], v[first : first + 40]))
        states = [tracker.advance(EPOCH_NS + (first + 40) * MS) for tracker in (idle, busy)]
        for _ in range(first // 40 % 4):
            busy.work()
        if states[0] is not None and states[1] is not None:
            np.testing.assert_array_equal(states[0].q_m, states[1].q_m)
            np.testing.assert_array_equal(states[0].q_sigma_m, states[1].q_sigma_m)
            assert states[0].symmetric == states[1].symmetric
    assert isinstance(states[0], ModeState)
    assert states[0].validity is Validity.TRACKING


def test_late_samples_inside_the_window_are_as_good_as_punctual_ones(
    moving: tuple[np.ndarray, dict[Station, np.ndarray]],
) -> None:
    t, values = (moving[0][:2000], {s: v[:2000] for s, v in moving[1].items()})
    _, punctual = _run(t, values)
    tracker, states = WingTracker(plain_airframe(), Settings()), []
    for first in range(0, 2000, 40):
        for station, v in values.items():
            chunks = [slice(first, first + 20), slice(first + 20, first + 40)]
            for chunk in chunks[::-1]:
                assert tracker.add(batch(station, t[chunk], v[chunk])) == []
        states.append(tracker.advance(EPOCH_NS + (first + 40) * MS))
    assert states[-1] is not None
    np.testing.assert_array_equal(states[-1].q_m, punctual[-1].q_m)


def test_a_sample_older_than_the_window_is_refused_and_told(
    moving: tuple[np.ndarray, dict[Station, np.ndarray]],
) -> None:
    t, values = (moving[0][:1000], {s: v[:1000] for s, v in moving[1].items()})
    tracker, _ = _run(t, values)
    (refused,) = tracker.add(batch(Station.LEFT, t[100:110], values[Station.LEFT][100:110]))
    assert (refused.reason, refused.count) == (Reject.TOO_LATE, 10)


def test_smoothing_and_its_window(moving: tuple[np.ndarray, dict[Station, np.ndarray]]) -> None:
    tracker, states = _run(*moving)
    newest = states[-1].t_host_ns
    assert tracker.smooth(newest + MS) is Reject.OUT_OF_WINDOW
    assert tracker.smooth(newest - 1251 * MS) is Reject.OUT_OF_WINDOW
    causal, lagged = tracker.smooth(newest), tracker.smooth(newest - 500 * MS)
    assert isinstance(causal, Deflection)
    assert isinstance(lagged, Deflection)
    np.testing.assert_allclose(causal.q_m, states[-1].q_m, rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(causal.covariance)[:2]), states[-1].q_sigma_m, rtol=1e-6)
    # what the stamps' offsets, 0.2 ms and considered, may make of the swing is not less half a second ago
    per_deflection = np.array([1.0, 1.0, 2.0 * np.pi * 5.0, 2.0 * np.pi * 5.0, 1.39, 1.39])
    by_stamps = (0.0002 * np.abs(lagged.qdot_mps).max() * per_deflection) ** 2
    assert (np.diag(lagged.covariance) < np.diag(causal.covariance) + by_stamps).all()
    assert lagged.lag_ns == 500 * MS
    assert np.linalg.eigvalsh(lagged.covariance / np.sqrt(np.outer(*[np.diag(lagged.covariance)] * 2))).min() > -1e-9


def test_a_quiet_wing_is_calm() -> None:
    _, states = _run(*swinging(4.0, 0.0))
    assert states[-1].validity is Validity.CALM
    assert states[10].validity is Validity.SETTLING


def test_a_root_that_stops_makes_everything_stale(moving: tuple[np.ndarray, dict[Station, np.ndarray]]) -> None:
    tracker, states = _run(*moving, until_ms={Station.ROOT: 3000})
    assert states[70].validity is Validity.TRACKING
    assert states[-1].validity is Validity.STALE
    assert Station.ROOT not in states[-1].stations
    assert tracker.forecast(100 * MS, MS) is Reject.STALE


def test_a_tip_that_stops_is_missed_in_the_sigma_only(moving: tuple[np.ndarray, dict[Station, np.ndarray]]) -> None:
    _, both = _run(*moving, adapt=0)
    _, half = _run(*moving, until_ms={Station.RIGHT: 2500}, adapt=0)
    assert half[-1].validity is Validity.TRACKING
    assert half[-1].stations == (Station.ROOT, Station.LEFT)
    assert (half[-1].q_sigma_m > 1.05 * both[-1].q_sigma_m).all()
    assert (np.abs(half[-1].q_m - both[-1].q_m) < 4 * half[-1].q_sigma_m).all()


def test_a_saturated_sensor_is_told_and_forgotten(moving: tuple[np.ndarray, dict[Station, np.ndarray]]) -> None:
    t, values = moving
    values = values | {Station.LEFT: values[Station.LEFT].copy()}
    values[Station.LEFT][2500:2504, 2] = 157.0
    _, states = _run(t, values)
    validities = {(s.t_host_ns - EPOCH_NS) // MS: s.validity for s in states}
    assert any(v is Validity.SATURATED for ms, v in validities.items() if 2500 <= ms < 2700)
    assert states[-1].validity is Validity.TRACKING


@pytest.mark.slow
@pytest.mark.parametrize(("until_ms", "distrust"), [(14_000, Reject.SATURATED), (15_000, None)])
def test_a_tip_that_fell_silent_at_its_limit_blinds_the_others_no_more(until_ms: int, distrust: Reject | None) -> None:
    t, values = swinging(15.0, 0.005)
    values[Station.LEFT][12_000:, 2] = 157.0
    tracker, _ = _run(t[:until_ms], values, until_ms={Station.LEFT: 14_000})
    assert tracker.distrust is distrust


@pytest.mark.parametrize("gap_ms", [50, 180])
def test_a_gap_of_the_root_in_a_steep_turn_unloads_no_wing(gap_ms: int) -> None:
    """Tips without gyros at 2 g: a wing taken to hang at 1 g there was 9 sigma off, and stood still in a roll."""
    airframe, seconds, gap = plain_airframe(), 6.0, slice(5500, 5500 + gap_ms)
    wing, rng = airframe.wing, np.random.default_rng(3)
    slope = wing.symmetric.slope_factor_radpm.value * (wing.trim_bend_m.value + wing.bend_per_g_m.value)
    t = EPOCH_NS + np.arange(round(seconds * 1000)) * MS
    tracker = WingTracker(airframe, Settings(adapt=0))
    for first in range(0, len(t), 20):
        stamps = t[first : first + 20]
        for station, across in ((Station.ROOT, 0.0), (Station.LEFT, -slope), (Station.RIGHT, slope)):
            values = rng.normal(size=(20, 6)) * np.repeat([0.016, 0.0011], 3)
            values[:, 1] += 2.0 * G * np.sin(across)
            values[:, 2] -= 2.0 * G * np.cos(across)
            axes = Axis.ALL if station is Station.ROOT else Axis.ACCEL
            present = ~((stamps >= t[gap.start]) & (stamps < t[gap.stop])) | (station is not Station.ROOT)
            if present.any():
                sent = ImuBatch(station, ClockName.HOST, stamps[present], values[present], axes, int(stamps[-1]))
                tracker.add(sent)
        tracker.process_until(int(stamps[-1]) + MS)
    assert tracker.smooth(int(t[gap.start]) + gap_ms * MS // 2) is Reject.STALE
    for after_ms in (20, 60, 150):
        estimate = tracker.smooth(int(t[gap.stop]) + after_ms * MS)
        assert isinstance(estimate, Deflection)
        assert (np.abs(estimate.slope_rad - slope) < 4.0 * np.sqrt(np.diag(estimate.covariance)[4:])).all()


@pytest.mark.parametrize("stations", [("root", "left", "right"), ("left", "right")])
@pytest.mark.parametrize("bias", ["accel_bias_sigma_mps2", "gyro_bias_sigma_radps"])
def test_biases_that_are_known_exactly_are_those_that_hardly_may_be_wrong(bias: str, stations: tuple[str, ...]) -> None:
    """Without a sigma, or with the root's alone, the biases' covariance is singular."""
    t, values = swinging(1.5, 0.005)
    sigmas = []
    for sigma in (0.0, 1e-7):
        airframe = plain_airframe()
        sensors = {name: dataclasses.replace(getattr(airframe, name), **{bias: sigma}) for name in stations}
        tracker = WingTracker(dataclasses.replace(airframe, **sensors), Settings())
        for station, v in values.items():
            tracker.add(batch(station, t, v))
        assert tracker.advance(int(t[-1])) is not None
        smoothed = tracker.smooth(EPOCH_NS + 1000 * MS)
        assert isinstance(smoothed, Deflection)
        sigmas.append([*np.sqrt(np.diag(smoothed.covariance)), smoothed.slow_slope_sigma_rad])
    np.testing.assert_allclose(sigmas[0], sigmas[1], rtol=1e-3)


def test_without_adaptation_a_tips_clock_restarts_without_the_tracker() -> None:
    t, values = swinging(10.6, 0.005)
    tracker, _ = _run(t, values, every_ms=200, adapt=0)
    assert tracker.distrust is None
    tracker.clock_restarted([Station.LEFT])
    assert tracker.distrust is None


def test_adaptation_that_is_switched_off_in_flight_cuts_runs_no_more(
    moving: tuple[np.ndarray, dict[Station, np.ndarray]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """40 ms before a fit is due: each run was cut every 40 ms from then on."""
    t, values = moving
    tracker, _ = _run(t[:3000], {station: v[:3000] for station, v in values.items()})
    tracker.adopt(Settings(adapt=0))
    runs: list[int] = []
    filtered = SeparatedBiasFilter.run

    def counted(kalman: SeparatedBiasFilter, epochs: Epochs) -> None:
        runs.append(epochs.length)
        filtered(kalman, epochs)

    monkeypatch.setattr(SeparatedBiasFilter, "run", counted)
    for station, v in values.items():
        tracker.add(batch(station, t[3000:], v[3000:]))
    tracker.advance(EPOCH_NS + 4000 * MS)
    assert max(runs) > 200


def test_a_batch_of_the_wrong_shape_is_a_defect_of_the_caller() -> None:
    tracker = WingTracker(plain_airframe(), Settings())
    with pytest.raises(ValueError, match="ImuBatch"):
        tracker.add(ImuBatch(Station.LEFT, ClockName.HOST, np.arange(3), np.zeros((3, 3)), Axis.ALL, 0))


@pytest.mark.slow
def test_what_was_learned_on_the_ground_is_forgotten_at_lift_off() -> None:
    """On its wheels a wing does not bend by its load factor: what that taught the constants does not fly."""
    t, values = swinging(13.0, 0.005)
    rolling = {station: v.copy() for station, v in values.items()}
    rolling[Station.LEFT][:, 1] += 3.0
    tracker, _ = _run(t, rolling)
    learned = np.abs(tracker._kalman.bias_parameters / tracker._layout.bias_parameter_sigma).max()
    assert learned > 3.0, "a lateral force that no flight has"
    assert tracker.distrust is not Reject.NOT_SETTLED
    tracker.lifted_off()
    assert not tracker._kalman.bias_parameters.any()
    assert tracker.distrust is Reject.NOT_SETTLED
    for first in range(0, 4520, 40):
        if first == 2000:
            tracker.lifted_off()  # as the pipeline does: without the jump of the force
        for station, v in values.items():
            tracker.add(batch(station, t[first : first + 40] + 13000 * MS, v[first : first + 40]))
        tracker.advance(EPOCH_NS + (13000 + first + 40) * MS)
    assert tracker.distrust is None, "trusted once the filter has settled, without another ten seconds"


def test_nothing_is_trusted_before_a_fit_was_taken_and_what_was_learned_without_is_forgotten() -> None:
    """A stopwatch trusted constants that a gust of the airframe file had taught: 4 sigma of toe by a lossy tip."""
    t, values = swinging(27.0, 0.004)
    tracker = WingTracker(plain_airframe(), Settings())
    for first in range(0, len(t), 40):
        now_ms = first + 40
        for station, v in values.items():
            lost = station is not Station.ROOT and now_ms <= 12_000 and first % 400 < 120
            if not lost:
                tracker.add(batch(station, t[first:now_ms], v[first:now_ms]))
        tracker.process_until(EPOCH_NS + now_ms * MS)
        if now_ms == 9_000:
            assert tracker.distrust is Reject.NOT_SETTLED
        elif now_ms == 12_000:
            assert tracker.distrust is Reject.NOT_FITTED
        elif now_ms == 17_000:
            assert tracker._adaptation.fits > 0
            assert tracker.distrust is Reject.NOT_SETTLED
            assert tracker._kalman.steps < 250, "the filter began with the first fit"
            assert tracker.smooth(EPOCH_NS + 16_000 * MS) is Reject.OUT_OF_WINDOW
    assert tracker.distrust is None


def test_without_adaptation_the_airframe_file_is_believed() -> None:
    t, values = swinging(10.2, 0.004)
    assert _run(t, values, adapt=0)[0].distrust is None

"""Guards against a wrong model: NIS, trial of parameters, stamps of held-up sends, warming up."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.pipeline import start, step
from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.readaptation import NewParameters
from companion.core.tracking.tracker import WingTracker
from companion.params.files import load_airframe
from companion.params.settings import Settings, tunables
from companion.records import Deflection, ImuBatch, Reject, Station, Tick, Validity
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.flight.offline import HOST_EPOCH_NS, flight_records
from sitl_tests.native.averaging import respaced

PERIOD_NS = 3_000_000
BROKEN_S, MENDED_S, END_S = 12.0, 14.0, 32.0


@given(st.integers(2, 37), st.integers(1, 60_000))
def test_a_sample_that_was_held_up_goes_back_to_its_place(late: int, early_ns: int) -> None:
    regular = np.arange(40, dtype=np.int64) * PERIOD_NS
    stamped = regular.copy()
    stamped[late] = regular[late + 1] - early_ns  # sent in one go with the next
    assert np.abs(respaced(stamped, PERIOD_NS) - regular).max() <= 1


@given(st.lists(st.integers(1_700_000, 4_300_000), min_size=5, max_size=40))
def test_what_is_only_uneven_stays_where_it_is(gaps_ns: list[int]) -> None:
    stamps = np.cumsum(np.array(gaps_ns, dtype=np.int64))
    np.testing.assert_array_equal(respaced(stamps, PERIOD_NS), stamps)


@pytest.fixture(scope="module")
def flight() -> Flight:
    return build_flight(load_airframe("nadir-2m"), 21, END_S)


def _flown(flight: Flight, spoil: bool) -> list[tuple[float, Validity, Reject | None, float]]:
    """Time, validity, distrust and NIS; with ``spoil`` the left tip's lateral axis shows the vertical one's."""
    state = start(flight.airframe, Settings())
    state.scheduling = state.correction = None
    history, now_ns = [], HOST_EPOCH_NS
    for record in flight_records(flight):
        while now_ns <= getattr(record, "received_host_ns", 0):
            state, _ = step(state, Tick(now_ns))
            now_ns += 20_000_000
            if state.validity is not None:
                tracker = state.tracker
                t_s = (now_ns - HOST_EPOCH_NS) * 1e-9
                history.append((t_s, state.validity, tracker.distrust, tracker.nis))
        if isinstance(record, ImuBatch) and record.station is Station.LEFT and spoil:
            t_s = (record.received_host_ns - HOST_EPOCH_NS) * 1e-9
            if BROKEN_S <= t_s < MENDED_S:
                record.values[:, 1] = 0.2 * record.values[:, 2]
        state, _ = step(state, record)
    return history


@pytest.mark.slow
def test_the_right_model_has_a_nis_near_one_and_is_trusted_once_it_has_learned(flight: Flight) -> None:
    history = _flown(flight, spoil=False)
    late = [entry for entry in history if entry[0] > 12.0]
    assert all(distrust is None for _, _, distrust, _ in late)
    # the rigid roll may have 3 rad/s^2 and has little here: two of nine rows lie inside a tenth of their variance
    assert 0.6 < float(np.median([nis for *_, nis in late])) < 1.4
    early = [entry for entry in history if entry[0] < 9.0]
    assert {distrust for _, _, distrust, _ in early} == {Reject.NOT_SETTLED}


@pytest.mark.slow
def test_sensors_that_contradict_the_model_cost_the_trust_and_give_it_back(flight: Flight) -> None:
    history = _flown(flight, spoil=True)
    during = [entry for entry in history if BROKEN_S + 0.3 < entry[0] < MENDED_S]
    assert all(distrust is Reject.CONTRADICTED for _, _, distrust, _ in during)
    assert all(validity is Validity.INCONSISTENT for _, validity, _, _ in during)
    assert history[-1][2] is None
    assert all(np.isfinite(nis) for *_, nis in history)


def _knowledge(kalman: SeparatedBiasFilter, others: list[int]) -> tuple[np.ndarray, ...]:
    """State, its covariance, and of the constants to keep their means and covariance."""
    return (
        kalman.state,
        kalman.total_covariance,
        kalman.bias_parameters[others],
        kalman._bias_covariance[np.ix_(others, others)],
    )


def _tracked(flight: Flight) -> WingTracker:
    """Tracker after three seconds."""
    state = start(flight.airframe, Settings())
    state.scheduling = state.correction = None
    now_ns = HOST_EPOCH_NS
    for record in flight_records(flight):
        while now_ns <= getattr(record, "received_host_ns", 0):
            state, _ = step(state, Tick(now_ns))
            now_ns += 20_000_000
        if now_ns > HOST_EPOCH_NS + 3_000_000_000:
            break
        state, _ = step(state, record)
    return state.tracker


@pytest.mark.slow
def test_nothing_is_smoothed_across_the_instant_at_which_constants_begin_anew(flight: Flight) -> None:
    tracker = _tracked(flight)
    before_ns = tracker.newest_ns - 100_000_000
    for shaken, expected in (((True, False), Deflection), ((False, False), Reject)):
        noise = copy.deepcopy(tracker._row_noise)
        noise.vibrating = shaken
        tracker._take(NewParameters(noise, tracker._kalman.model, None, 0))
        assert isinstance(tracker.smooth(before_ns), expected)
    assert isinstance(tracker.smooth(tracker.newest_ns), Deflection)


@pytest.mark.slow
def test_a_constant_that_is_reopened_is_unknown_again_and_nothing_else_is(flight: Flight) -> None:
    kalman = _tracked(flight)._kalman
    kalman.reset_bias_parameters([])  # solves, so that all that was gathered is in the answer
    names = kalman.layout.bias_parameters
    at = names.index("left.mx")
    others = [k for k in range(len(names)) if k != at]
    before, sigma = _knowledge(kalman, others), kalman.layout.bias_parameter_sigma[at]
    assert kalman.bias_parameter_covariance[at, at] < 0.9 * sigma**2  # something had been learned
    kalman.reset_bias_parameters(["left.mx"])
    for old, new in zip(before, _knowledge(kalman, others), strict=True):
        np.testing.assert_allclose(new, old, rtol=1e-6, atol=1e-9 * np.abs(old).max())
    assert kalman.bias_parameters[at] == 0.0
    np.testing.assert_allclose(kalman.bias_parameter_covariance[at, others], 0.0, atol=1e-12 * sigma)
    assert kalman.bias_parameter_covariance[at, at] == pytest.approx(sigma**2)


def _taught(sends: str, *, shaken: bool, hidden: bool = False) -> dict[str, float]:
    """Bias parameters by an information that tells of each; the left tip is shaken, or no mode is seen to move."""
    base = load_airframe("nadir-2m")
    left, right = (dataclasses.replace(tip, sends=sends) for tip in (base.left, base.right))
    tracker = WingTracker(dataclasses.replace(base, left=left, right=right), Settings())
    kalman, noise = tracker._kalman, tracker._row_noise
    sigma = np.concatenate([[1.0], kalman.layout.bias_parameter_sigma])
    coupled = 0.5 * (np.eye(len(sigma)) + 1.0)  # of each with every other
    kalman._filter_state.information[:] = 30.0 * coupled / np.outer(sigma, sigma)
    kalman._filter_state.information[0, 1:] = kalman._filter_state.information[1:, 0] = -1.0 / sigma[1:]
    kalman.reset_bias_parameters([])
    noise.vibrating = (shaken, False)
    kalman.take_noise(noise, still=hidden)
    assert np.linalg.eigvalsh(kalman.bias_parameter_covariance).min() > 0.0
    return {name: estimate for name, (estimate, _) in tracker.bias_parameters().items()}


def test_no_scale_is_learned_of_a_tip_that_is_shaken_or_could_not_show_it() -> None:
    calm, shaken, mute = _taught("xyzpqr", shaken=False), _taught("xyzpqr", shaken=True), _taught("z", shaken=False)
    scales = {"left.kz", "left.ky", "left.kp"}
    assert all(calm[name] != 0.0 for name in {*scales, "right.kz", "slope.second_symmetric"})
    unknown = {name for name, estimate in shaken.items() if estimate == 0.0 and calm[name] != 0.0}
    slopes = {name for name in calm if name.startswith("slope.")}
    assert unknown == scales | slopes | {"shortening", "further_shortening", "trim"}
    assert mute["left.kz"] == mute["right.kz"] == 0.0 != mute["trim"]
    hidden = _taught("xyzpqr", shaken=False, hidden=True)
    both = scales | {"right.kz", "right.ky", "right.kp"}
    assert {name for name in both | slopes if hidden[name] != 0.0} == set()


@pytest.mark.parametrize(("rate_sigmas", "still"), [(1.0, True), (6.0, False)])
def test_a_wing_is_still_while_its_modes_move_by_no_more_than_is_unknown_of_them(
    rate_sigmas: float, still: bool
) -> None:
    tracker = WingTracker(load_airframe("nadir-2m"), Settings())
    kalman, activity = tracker._kalman, tracker._activity
    rates = [family.v for family in kalman.layout.families]
    kalman.history.state[:, rates, 0] = rate_sigmas * np.sqrt(np.diag(kalman.covariance)[rates])
    step_s, kalman.steps = kalman.model.step_s, kalman.history_length
    for _ in range(round(3.0 / (kalman.steps * step_s)) + 1):
        activity.update(kalman, kalman.steps, step_s)
    assert activity.still is still


def test_a_tracker_that_has_seen_nothing_is_not_trusted() -> None:
    assert WingTracker(load_airframe("nadir-2m"), Settings()).distrust is Reject.NOT_SETTLED


@pytest.mark.slow
def test_the_longest_lag_leaves_room_for_ticks_and_for_both_stamps_of_a_pair(flight: Flight) -> None:
    longest = next(row for row in tunables() if row.name == "TRK_LAG").maximum
    tracker = _tracked(flight)
    due_ns = tracker.newest_ns - round(longest * 1e9)
    assert isinstance(tracker.smooth(due_ns - 50_000_000), Deflection)

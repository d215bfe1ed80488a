"""Memory of the tracker for trying new parameters: a filter, and the epochs since; as many as a trial needs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from companion.core.clock.bank import ClockBank
from companion.core.pipeline import start, step
from companion.core.tracking.adaptation.spectral_fit import FitInput, SpectralFit
from companion.core.tracking.contradiction import Contradiction
from companion.core.tracking.model import WingParameters
from companion.core.tracking.parameters import FREQUENCY, LOAD
from companion.core.tracking.prediction import Forecast
from companion.core.tracking.rigid_body import join
from companion.core.tracking.spread_work import Stages
from companion.core.tracking.tracker import WingTracker
from companion.params.settings import Settings
from companion.records import ClockName, Deflection, Reject, ServiceStatus, Station, Tick, Validity
from sitl_tests.unit.tracking_samples import EPOCH_NS, MS, batch, plain_airframe, swinging

EVERY_MS = 100
LOST = np.arange(EVERY_MS) < 20  # of each 100 ms both tips lose the first 20: more than the fiftieth that a fit allows


def _flown(tracker: WingTracker, seconds: float, holes: bool, from_s: float = 0.0) -> Iterator[float]:
    """Feed a tracker with tips that lose samples where ``holes``; give the time after each call."""
    t, values = swinging(seconds, 0.005)
    for first in range(round(from_s * 1000), len(t), EVERY_MS):
        batch_slice = slice(first, first + EVERY_MS)
        for station, v in values.items():
            sent = ~LOST if holes and station is not Station.ROOT else slice(None)
            tracker.add(batch(station, t[batch_slice][sent], v[batch_slice][sent]))
        tracker.advance(EPOCH_NS + (first + EVERY_MS) * MS)
        yield 1e-3 * (first + EVERY_MS)


def _stored_s(tracker: WingTracker) -> float:
    return sum(epochs.length for epochs in tracker._trial_epochs) / Settings().track_rate_hz


def test_epochs_for_a_trial_do_not_pile_up_where_no_fit_can_be_made() -> None:
    tracker = WingTracker(plain_airframe(), Settings())
    stored_s = [(at_s, _stored_s(tracker)) for at_s in _flown(tracker, 15.0, holes=True)]
    assert tracker._adaptation.fits == 0
    assert max(s for at_s, s in stored_s if at_s > 10.5) <= 1.5 + 1e-3 * EVERY_MS
    assert max(s for at_s, s in stored_s if at_s <= 10.0) > 9.0, "early on the whole history is wanted"


@pytest.mark.parametrize("holes", [True, False], ids=["no fits", "fits"])
def test_the_trial_filter_reaches_the_tracker_s_state_by_the_trial_epochs(holes: bool) -> None:
    """A trial judges new parameters on these epochs; if they did not belong together, it would judge a jump."""
    tracker = WingTracker(plain_airframe(), Settings())
    compared = 0
    for at_s in _flown(tracker, 12.8, holes):
        if at_s < 10.5 or not tracker._trial_epochs:
            continue
        again = tracker._trial_filter.fork(tracker._kalman.model)
        again.run(join(tracker._trial_epochs))
        sigma = np.sqrt(np.diag(tracker._kalman.total_covariance))
        np.testing.assert_allclose(again.state / sigma, tracker._kalman.state / sigma, atol=1e-6)
        compared += 1
    assert compared > 15


def test_adaptation_that_is_switched_on_in_flight_leaves_time_where_it_is() -> None:
    tracker = WingTracker(plain_airframe(), Settings(adapt=0))
    for _ in _flown(tracker, 3.0, holes=False):
        pass
    tracker.adopt(dataclasses.replace(Settings(), adapt=1))
    for _ in _flown(tracker, 7.0, holes=False, from_s=3.0):
        pass
    assert tracker._adaptation.fits > 0
    middle_ns = tracker._next_ns - 500 * MS
    deflection = tracker.smooth(middle_ns)
    assert isinstance(deflection, Deflection)
    truth_m = 0.005 * np.cos(2 * np.pi * 5.0 * (middle_ns - EPOCH_NS) * 1e-9)
    assert abs(deflection.q_m[0] - 0.0149 - truth_m) < 4 * np.sqrt(deflection.covariance[0, 0])


@pytest.mark.parametrize(
    ("changes", "taken"),
    [({LOAD: math.log(1.5)}, True), ({LOAD: math.log(1e-4), FREQUENCY: math.log(1.5)}, False)],
    ids=["as good", "inconsistent"],
)
def test_new_parameters_are_taken_unless_they_make_the_measurements_inconsistent(
    changes: dict[int, float], taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker = WingTracker(plain_airframe(), Settings())
    for _ in _flown(tracker, 1.4, holes=False):
        pass
    before = tracker._kalman.model.parameters
    log_params = [family.log_params() for family in before]
    for index, change in changes.items():
        for family in log_params:
            family[index] += change
    offered = tuple(old.with_log_params(new, old.log_sigma) for old, new in zip(before, log_params, strict=True))

    contradicted = []

    def fitted(fit: SpectralFit, fit_input: FitInput) -> Stages[WingParameters]:
        contradicted.append(fit_input.contradicted)
        yield
        return offered

    monkeypatch.setattr(SpectralFit, "stages", fitted)
    for _ in _flown(tracker, 2.1, holes=False, from_s=1.4):
        pass
    assert tracker._kalman.model.parameters == (offered if taken else before)
    assert tracker._adaptation.parameters == tracker._kalman.model.parameters
    assert contradicted == [False, not taken], "the next fit knows that a second mode without evidence may be missing"


def _validities(wrong_s: tuple[float, float], end_s: float) -> tuple[WingTracker, dict[float, Validity]]:
    """Tracker, and its validity by time, where the left lateral axis shows a fifth of the vertical one for a while."""
    tracker = WingTracker(plain_airframe(), Settings(adapt=0))
    t, values = swinging(end_s, 0.005)
    wrong = slice(*(round(1000 * at_s) for at_s in wrong_s))
    values[Station.LEFT][wrong, 1] = 0.2 * values[Station.LEFT][wrong, 2]
    validities = {}
    for first in range(0, len(t), EVERY_MS):
        batch_slice = slice(first, first + EVERY_MS)
        for station, v in values.items():
            tracker.add(batch(station, t[batch_slice], v[batch_slice]))
        state = tracker.advance(EPOCH_NS + (first + EVERY_MS) * MS)
        if state is not None:
            validities[1e-3 * (first + EVERY_MS)] = state.validity
    return tracker, validities


def test_trust_comes_back_when_the_filter_has_settled_behind_a_contradiction() -> None:
    _, validities = _validities((2.5, 4.5), 11.0)
    contradicted = [at_s for at_s, validity in validities.items() if validity is Validity.INCONSISTENT]
    settling = [at_s for at_s, validity in validities.items() if validity is Validity.SETTLING and at_s > 2.5]
    assert min(contradicted) < 2.75
    assert 4.5 < max(contradicted) < 8.5
    assert min(settling) > max(contradicted)
    assert max(settling) - max(contradicted) == pytest.approx(2.0, abs=0.1)
    assert validities[11.0] is Validity.TRACKING


def _still(nis: float) -> Any:
    """Filter with an NIS whose left lateral axis contradicts it most."""
    variances = np.array([4.0, 4.0, 4.0, 4.0, 1.0, 4.0, 4.0, 4.0, 4.0])
    return SimpleNamespace(
        nis=nis,
        steps=500,
        history_length=300,
        model=SimpleNamespace(step_s=0.004),
        innovations=lambda count: (np.ones((count, 9)), np.tile(np.diag(variances), (count, 1, 1))),
    )


def _watched(nis: list[float]) -> list[tuple[bool, bool]]:
    """Whether there is a contradiction, and whether none is felt any more, at an NIS each 0.5 s."""
    contradiction, kalman, watched = Contradiction(), _still(1.0), []
    for kalman.nis in nis:
        contradiction.update(kalman, 1.0, 0.5)
        watched.append((contradiction.holds, contradiction.settled))
    return watched


HOLDS, SETTLES, OVER = (True, False), (False, False), (False, True)


def test_a_contradiction_lasts_until_the_nis_is_what_the_right_model_has() -> None:
    watched = _watched([2.9, 3.1, 3.1, 3.1, 2.9, 2.1, 1.9, 2.9, 2.9, 2.9])
    assert watched[0] == OVER
    assert watched[3:6] == 3 * [HOLDS]
    assert watched[6:] == [*(3 * [SETTLES]), OVER]


def test_a_single_blow_costs_no_settling_and_a_second_one_does() -> None:
    blow = [9.0, 2.9]
    assert _watched(blow) == [(True, True), OVER]
    assert _watched([*blow, *(4 * [1.0]), *blow, 1.0])[-3:] == [HOLDS, HOLDS, SETTLES]
    assert _watched([*blow, *(20 * [1.0]), *blow])[-1] == OVER


def test_a_deflection_that_no_gust_of_the_fit_has_is_a_contradiction() -> None:
    contradiction = Contradiction()
    contradiction.update(SimpleNamespace(nis=1.0), 6.1, 0.1)  # type: ignore[arg-type]
    assert contradiction.holds


def test_a_filter_that_contradicts_its_sensors_for_seconds_begins_anew() -> None:
    """From a state that it cannot leave by itself it would never find back."""
    tracker, validities = _validities((2.5, 7.5), 9.0)
    assert validities[2.5] is Validity.TRACKING
    assert {validities[at_s] for at_s in validities if 3.0 < at_s < 7.0} == {Validity.INCONSISTENT}
    assert Validity.SETTLING in {validities[at_s] for at_s in validities if at_s > 7.4}
    assert tracker._kalman.steps < 2.0 * Settings().track_rate_hz


def test_behind_the_restart_of_a_tip_s_clock_nothing_is_smoothed() -> None:
    """Samples that it sent before have another delay than those that it sends now."""
    tracker = WingTracker(plain_airframe(), Settings())
    for _ in _flown(tracker, 10.5, holes=True):
        pass
    restarted_ns = tracker._next_ns
    before_ns, after_ns = restarted_ns - 20 * MS, restarted_ns + 20 * MS
    assert isinstance(tracker.smooth(before_ns), Deflection)
    tracker.clock_restarted([Station.LEFT])
    for _ in _flown(tracker, 10.8, holes=True, from_s=10.5):
        pass
    assert tracker.smooth(before_ns) is Reject.OUT_OF_WINDOW
    assert isinstance(tracker.smooth(after_ns), Deflection)


def test_an_uncertain_slope_factor_makes_the_forecast_of_the_slope_rate_uncertain() -> None:
    """A factor's variance counts with the square of the modal rate; what else it does to the state comes on top."""
    tracker = WingTracker(plain_airframe(), Settings(adapt=0))
    for _ in _flown(tracker, 2.5, holes=False):
        pass
    kalman = tracker._kalman
    sure = tracker.forecast(200 * MS, 5 * MS)
    column = kalman.layout.column("slope.symmetric")
    assert column is not None
    more = 0.05**2
    kalman._bias_covariance[column - 1, column - 1] += more
    unsure = tracker.forecast(200 * MS, 5 * MS)
    assert isinstance(sure, Forecast)
    assert isinstance(unsure, Forecast)
    slope_rate, added = sure.slope_rate_radps.mean(axis=1), unsure.slope_rate_covariance - sure.slope_rate_covariance
    modal_rate = slope_rate / (1.39 + kalman.bias_parameters[column - 1])
    assert np.abs(modal_rate).max() > 0.1, "5 mm at 5 Hz: 0.16 m/s"
    for side in (0, 1):
        assert np.all(added[:, side, side] >= 0.99 * more * modal_rate**2 - 1e-12)


def test_a_preview_takes_the_newest_samples_and_leaves_the_tracker_as_it_is() -> None:
    """One of two trackers previews at every call. Their states stay equal; its forecast begins where samples end."""
    plain, previewing = WingTracker(plain_airframe(), Settings()), WingTracker(plain_airframe(), Settings())
    for _, _ in zip(_flown(plain, 6.0, holes=True), _flown(previewing, 6.0, holes=True), strict=True):
        usual, newest = previewing.forecast(100 * MS, 5 * MS), previewing.forecast(100 * MS, 5 * MS, previews=True)
    assert isinstance(usual, Forecast)
    assert isinstance(newest, Forecast)
    assert np.array_equal(plain._kalman.state_and_sensitivity, previewing._kalman.state_and_sensitivity)
    assert np.array_equal(plain._kalman.covariance, previewing._kalman.covariance)
    last_sample_ns = EPOCH_NS + 5_999 * MS
    assert last_sample_ns - 4 * MS < newest.t_host_ns[0] - 5 * MS <= last_sample_ns
    assert usual.t_host_ns[0] - 5 * MS <= EPOCH_NS + 6_000 * MS - 50 * MS
    # both tell the same instants; the later one knows them better
    at = int(np.searchsorted(usual.t_host_ns, newest.t_host_ns[0]))
    assert newest.q_covariance[0, 0, 0] < usual.q_covariance[at, 0, 0]


@pytest.mark.slow
def test_sensors_that_contradict_the_model_for_good_are_told_so_and_not_that_the_tracker_settles() -> None:
    clocks = ClockBank()
    for clock in ClockName:
        clocks.identity(clock)
    state, (t, values) = start(plain_airframe(), Settings(), clocks=clocks), swinging(24.0, 0.005)
    values[Station.LEFT][:, 1] = 0.2 * np.roll(values[Station.LEFT][:, 2], 20)  # late: no constant explains it
    reasons, distrusted = [], []
    for first in range(0, len(t), 40):
        for station, v in values.items():
            step(state, batch(station, t[first : first + 40], v[first : first + 40]))
        outputs = step(state, Tick(EPOCH_NS + (first + 40) * MS))[1]
        reasons += [(1e-3 * first, each.reason) for each in outputs if isinstance(each, ServiceStatus)]
        distrusted.append((1e-3 * first, state.tracker.distrust))
    said = {reason for at_s, reason in reasons if at_s > 12.0}
    assert len(said) == 1
    assert "the sensors contradict the wing's model, most of all the left " in said.pop()
    assert {reason for at_s, reason in distrusted if at_s > 12.0} == {Reject.CONTRADICTED}


def test_a_contradiction_that_outlives_two_starts_lasts_until_there_was_none_for_ten_seconds() -> None:
    contradiction, kalman = Contradiction(), _still(9.0)
    lasting = []
    for _ in range(2):
        contradiction.begin_anew()
        for _ in range(11):
            contradiction.update(kalman, 1.0, 0.5)
        lasting.append(contradiction.lasting)
    assert lasting == [False, True]
    assert contradiction.sentence == "the sensors contradict the wing's model, most of all the left lateral axis"
    contradiction.begin_anew()
    held = []
    for _ in range(25):
        contradiction.update(_still(1.0), 1.0, 0.5)
        held.append(contradiction.holds)
    assert held == [True] * 19 + [False] * 6
    assert contradiction.sentence == "the sensors contradict the wing's model"

"""Uses that an estimate is good for, reason by reason, and the level of a swing that is known."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from companion.core.pipeline import start, step
from companion.core.tracking.file_check import FileCheck
from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.model import WingParameters, stationary
from companion.core.tracking.parameters import FREQUENCY, ModeParameters, prior_parameters
from companion.core.tracking.prediction import Forecast
from companion.core.tracking.states import StateLayout, make_layout
from companion.core.tracking.tracker import WingTracker
from companion.core.tracking.validity import ModalActivity, classify_validity
from companion.params.settings import Settings
from companion.records import Axis, ClockName, Floats, ModeState, Notice, Reject, Station, Tick, Validity
from sitl_tests.unit.tracking_samples import EPOCH_NS, MS, batch, plain_airframe, swinging

GOOD = {
    "stale": False,
    "saturated": False,
    "settled": True,
    "contradicted": False,
    "rms_m": np.array([0.004, 0.001]),
    "calm_rms_m": 0.0002,
    "ambiguous": False,
}
WORSE = [
    (Validity.STALE, {"stale": True}),
    (Validity.INCONSISTENT, {"contradicted": True}),
    (Validity.SETTLING, {"settled": False}),
    (Validity.SATURATED, {"saturated": True}),
    (Validity.CALM, {"rms_m": np.array([0.00011, 0.00011]), "calm_rms_m": 0.0002}),
    (Validity.AMBIGUOUS, {"ambiguous": True}),
]


def _with_frequency_sigma(relative: tuple[float, float]) -> tuple[ModeParameters, ModeParameters]:
    """Both families' beliefs with a relative sigma of their frequencies."""
    airframe = plain_airframe()
    families = []
    for family, sigma in zip(make_layout(airframe).families, relative, strict=True):
        prior = prior_parameters(family, airframe.wing.gust)
        log_sigma = prior.log_sigma.copy()
        log_sigma[FREQUENCY] = sigma
        families.append(dataclasses.replace(prior, log_sigma=log_sigma))
    return families[0], families[1]


@pytest.mark.parametrize("first", range(len(WORSE)))
def test_the_gravest_reason_wins(first: int) -> None:
    together = dict(GOOD)
    for _, change in WORSE[:first:-1]:
        together |= change
    wanted, change = WORSE[first]
    assert classify_validity(**(together | change), parameters=_with_frequency_sigma((0.01, 0.01))) is wanted


def test_a_mode_is_tracked_where_its_frequency_is_known_to_a_fifth_and_its_twin_does_not_matter() -> None:
    assert classify_validity(**GOOD, parameters=_with_frequency_sigma((0.19, 0.5))) is Validity.TRACKING
    assert classify_validity(**GOOD, parameters=_with_frequency_sigma((0.21, 0.01))) is Validity.AMBIGUOUS
    swapped = GOOD | {"rms_m": GOOD["rms_m"][::-1]}
    assert classify_validity(**swapped, parameters=_with_frequency_sigma((0.01, 0.21))) is Validity.AMBIGUOUS


def test_calm_is_judged_by_both_modes_together() -> None:
    each = 0.00015  # 0.21 mm together
    both, single = np.array([each, each]), np.array([each, 0.0])
    assert (
        classify_validity(**(GOOD | {"rms_m": both}), parameters=_with_frequency_sigma((0.01, 0.01)))
        is Validity.TRACKING
    )
    assert (
        classify_validity(**(GOOD | {"rms_m": single}), parameters=_with_frequency_sigma((0.01, 0.01))) is Validity.CALM
    )


def _unadapted() -> tuple[SeparatedBiasFilter, ModalActivity]:
    """Filter and activity of a tracker that keeps its parameters, 3.4 s into a swing of 4 mm."""
    tracker = WingTracker(plain_airframe(), Settings(adapt=0))
    t, values = swinging(3.4, 0.004)
    for station, v in values.items():
        tracker.add(batch(station, t, v))
    assert tracker.advance(EPOCH_NS + 3400 * MS) is not None
    return tracker._kalman, tracker._activity


def test_a_deflection_that_no_gust_of_the_fit_explains_contradicts_the_model() -> None:
    """Vertical axes alone contradict no load, however large, that holds a wing still where it is."""
    kalman, activity = _unadapted()
    assert activity.deflection_sigmas < 3.0
    q = kalman.layout.families[1].q
    gust_m2 = stationary(kalman.layout, kalman.noise, kalman.model)[q, q]
    by_constants = kalman.state_and_sensitivity[q, 1:]
    sigma_m = math.sqrt(gust_m2 + by_constants @ kalman.bias_parameter_covariance @ by_constants)
    kalman.state_and_sensitivity[q, 0] += 7.0 * sigma_m - kalman.state[q]
    second = round(1.0 / kalman.model.step_s)
    activity.update(kalman, second, kalman.model.step_s)
    assert activity.deflection_sigmas == pytest.approx(7.0)
    for side in (1.0, -1.0):  # a vibration ten times as large has no mean
        kalman.state_and_sensitivity[q, 0] += side * 70.0 * sigma_m - kalman.state[q]
        activity.update(kalman, second // 14, kalman.model.step_s)
    assert activity.deflection_sigmas < 7.0


def test_fits_that_are_all_refused_contradict_the_model() -> None:
    tracker, t, values = WingTracker(plain_airframe(), Settings()), *swinging(0.2, 0.004)
    for station, v in values.items():
        tracker.add(batch(station, t, v))
    tracker.process_until(EPOCH_NS + 200 * MS)
    activity, kalman = tracker._activity, tracker._kalman
    assert not activity.note_fit(taken=False)
    assert activity.reject is Reject.NOT_SETTLED
    activity.settled_s = 10.0
    activity.update(kalman, 1, kalman.model.step_s)
    assert activity.reject is Reject.CONTRADICTED
    assert activity.note_fit(taken=True), "the first that is taken"
    assert not activity.note_fit(taken=True)
    activity.update(kalman, 1, kalman.model.step_s)
    assert activity.reject is None
    rejects = []
    for _ in range(20):
        activity.note_fit(taken=False)
        rejects.append(activity.reject)
    assert rejects == [None] * 19 + [Reject.CONTRADICTED]
    activity.note_fit(taken=True)
    assert activity.reject is None


@pytest.mark.slow
@pytest.mark.parametrize(("drift_radps2", "level_radps", "trusted"), [(0.0, 0.01, True), (3e-4, 0.0, False)])
def test_a_gyro_may_be_off_but_not_drift(drift_radps2: float, level_radps: float, trusted: bool) -> None:
    """A large bias is learned and harmless; a drift is followed too late, and no innovation shows it."""
    tracker, t, values = WingTracker(plain_airframe(), Settings()), *swinging(22.0, 0.004)
    seconds = np.arange(len(t)) * 1e-3
    values[Station.LEFT][:, 3] += level_radps + drift_radps2 * np.maximum(seconds - 12.0, 0.0)
    for first in range(0, len(t), 40):
        for station, v in values.items():
            tracker.add(batch(station, t[first : first + 40], v[first : first + 40]))
        tracker.process_until(EPOCH_NS + (first + 40) * MS)
        if first == 12_000:
            assert tracker.distrust is None
    assert tracker.nis < 2.0
    assert tracker.distrust is (None if trusted else Reject.CONTRADICTED)


def _looked(sigmas: list[float], name: str, error: float = 0.1) -> list[bool]:
    """Whether each look, a second apart, finds that a constant which is off by so many sigmas contradicts the file.

    ``error`` is the estimate's own sigma, over the file's.
    """
    layout = make_layout(plain_airframe())
    at = layout.bias_parameters.index(name)
    check, contradicts = FileCheck(), []
    parameters = _with_frequency_sigma((0.01, 0.01))
    for second, off in enumerate(sigmas, 1):
        constants = np.zeros(len(layout.bias_parameters))
        constants[at] = off * layout.bias_parameter_sigma[at]
        check.update(_learned(layout, 250 * second, constants, parameters, error))
        contradicts.append(check.sentence is not None)
    return contradicts


def _learned(
    layout: StateLayout, steps: int, constants: Floats, parameters: WingParameters, error: float = 0.1
) -> SeparatedBiasFilter:
    """Filter that has learned these constants, as far as the check looks at it."""
    covariance = np.diag((error * layout.bias_parameter_sigma) ** 2)
    model = SimpleNamespace(step_s=0.004, parameters=parameters)
    return SimpleNamespace(  # type: ignore[return-value]
        steps=steps, bias_parameters=constants, bias_parameter_covariance=covariance, layout=layout, model=model
    )


def test_a_constant_that_a_flight_hardly_tells_contradicts_no_file() -> None:
    """A mounting about x that vertical axes alone show grows less certain than the file, and wanders."""
    assert not any(_looked([6.3] * 9, "right.mx", error=4.0))
    assert any(_looked([6.3] * 9, "right.mx"))


def test_a_constant_six_sigmas_off_the_file_contradicts_it_until_it_is_back() -> None:
    assert not any(_looked([5.9] * 9, "left.kz"))
    assert not any(_looked([9.0, 9.0, 1.0, 9.0, 9.0], "trim"))
    contradicts = _looked([-6.1, -6.1, -6.1, -4.0, -2.9], "slope.second_symmetric")
    assert contradicts == [False, False, True, True, False]


def test_a_further_mode_far_from_the_file_contradicts_it() -> None:
    layout = make_layout(plain_airframe())
    parameters = _with_frequency_sigma((0.01, 0.01))
    first, second = parameters[0].modes
    moved = dataclasses.replace(parameters[0], modes=(first, dataclasses.replace(second, frequency_hz=13.0)))
    check = FileCheck()
    for third in range(1, 4):
        constants = np.zeros(len(layout.bias_parameters))
        check.update(_learned(layout, 250 * third, constants, (moved, parameters[1])))
    assert check.sentence == "frequency of second symmetric is -14 Hz off the airframe's file, which states 3 Hz"


def test_a_scale_that_the_file_does_not_know_costs_the_trust_and_is_named() -> None:
    state, (t, values) = start(plain_airframe(), Settings(), hub=ClockName.HOST), swinging(14.0, 0.004)
    values[Station.LEFT][:, :3] *= 1.1
    said = []
    for first in range(0, len(t), 40):
        for station, v in values.items():
            step(state, batch(station, t[first : first + 40], v[first : first + 40]))
        said += [each for each in step(state, Tick(EPOCH_NS + (first + 40) * MS))[1] if isinstance(each, Notice)]
    assert state.tracker.distrust is Reject.CONTRADICTED
    (notice,) = (each for each in said if "file" in each.text)
    assert notice.text.startswith("left ")
    assert " off the airframe's file, which states " in notice.text


@pytest.mark.parametrize("amplitude_m", [0.0015, 0.005])
def test_the_level_of_a_sine_is_its_amplitude_over_root_two(amplitude_m: float) -> None:
    tracker = WingTracker(plain_airframe(), Settings(adapt=0))
    t, values = swinging(3.4, amplitude_m)
    for station, v in values.items():
        tracker.add(batch(station, t, v))
    state = tracker.advance(EPOCH_NS + 3400 * MS)
    assert state is not None
    assert Station.LEFT in state.stations
    # the first second's block is of a filter that was still finding it; the median of three leaves that out
    assert state.symmetric.rms_m == pytest.approx(amplitude_m / math.sqrt(2.0), rel=0.03)
    assert state.antisymmetric.rms_m < 0.1 * amplitude_m


def _swinging_by_vertical_axes(trim_sigma_m: float) -> tuple[WingTracker, ModeState]:
    """Tracker of a wing that swings by 3 mm at 5 Hz, whose trim bend is known so well, and its state after 6 s."""
    airframe = plain_airframe()
    trim = dataclasses.replace(airframe.wing.trim_bend_m, sigma=trim_sigma_m)
    sensors = {
        name: dataclasses.replace(airframe.sensor(Station[name.upper()]), sends="z") for name in ("left", "right")
    }
    wing = dataclasses.replace(airframe.wing, trim_bend_m=trim)
    tracker = WingTracker(dataclasses.replace(airframe, wing=wing, **sensors), Settings())
    t_ns, values = swinging(6.0, 0.003)
    for station in Station:
        axes = Axis.ALL if station is Station.ROOT else Axis.Z
        tracker.add(dataclasses.replace(batch(station, t_ns, values[station]), axes=axes))
    state = tracker.advance(int(t_ns[-1]) + 20 * MS)
    assert state is not None
    return tracker, state


def test_an_unknown_trim_bend_is_no_uncertainty_of_the_swing() -> None:
    """With vertical axes alone nobody knows how far the wing is bent at rest, and everybody sees how far it swings."""
    trim_m = 0.02
    _, state = _swinging_by_vertical_axes(trim_m)
    swing = state.symmetric
    assert swing.amplitude_m == pytest.approx(0.003, rel=0.1)
    assert swing.amplitude_sigma_m < 0.001
    assert swing.phase_sigma_rad < 0.25
    assert swing.swings
    assert state.q_sigma_m[0] > 0.5 * trim_m, "the deflection itself stays unknown by its trim"


def test_an_unknown_trim_bend_is_not_predicted_to_swing() -> None:
    """An error of the static bend stays what it is: a quarter of a period on it is no slope rate."""
    sigmas = []
    for trim_m in (0.0002, 0.02):
        tracker, state = _swinging_by_vertical_axes(trim_m)
        ahead = tracker.forecast(60 * MS, MS)
        assert isinstance(ahead, Forecast)
        sigmas.append(math.sqrt(float(ahead.slope_rate_covariance[-1, 0, 0])))
    slope_radpm = plain_airframe().wing.symmetric.slope_factor_radpm.value
    by_a_swing_radps = 2.0 * math.pi * state.symmetric.frequency_hz * 0.02 * slope_radpm
    assert sigmas[1] < sigmas[0] + 0.1 * by_a_swing_radps


def test_a_deflection_that_an_unknown_constant_explains_contradicts_no_model() -> None:
    """A misalignment that is only considered moves the deflection by several of the gusts' sigmas."""
    kalman, activity = _unadapted()
    q = kalman.layout.families[1].q
    sigma_m = math.sqrt(stationary(kalman.layout, kalman.noise, kalman.model)[q, q])
    parameter_sigma = math.sqrt(kalman.bias_parameter_covariance[0, 0])
    kalman.state_and_sensitivity[q, 1:] = 0.0
    kalman.state_and_sensitivity[q, 1] = 3.0 * sigma_m / parameter_sigma
    kalman.state_and_sensitivity[q, 0] += 7.0 * sigma_m - kalman.state[q]
    activity.update(kalman, round(1.0 / kalman.model.step_s), kalman.model.step_s)
    assert activity.deflection_sigmas == pytest.approx(7.0 / math.hypot(1.0, 3.0))

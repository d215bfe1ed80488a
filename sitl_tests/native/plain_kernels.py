"""The readable numpy versions in the places of the C kernels: the whole pipeline by them, to hold both to each other.

Not replaced, for want of a numpy version: the bulk decoder and the reading of datagrams (pymavlink is held against them
in ``sitl_tests/unit/test_mavlink_bulk.py`` and ``test_native_datagrams.py``); a simulated flight's records are decoded
already. ``stream_averages`` by itself is not called in a flight (``epochs_build`` averages; so does its numpy version),
and the diagnosis' filter is no part of the live path.
"""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from companion.core.clock import clock_map, sync_set
from companion.core.tracking import (
    estimates,
    filter,
    line_peaks,
    prediction,
    rigid_body,
    row_noise,
    smoother,
    streams,
    validity,
)
from companion.core.tracking.adaptation import frequency_drift, slow_load, spectral_fit, whittle
from companion.core.trigger import blur, planner
from companion.core.trigger.instants import PlannedInstant
from companion.params.airframe import Sensor
from companion.records import Floats, Ints
from sitl_tests.reference.kernels import bias_information as plain_bias
from sitl_tests.reference.kernels import clock as plain_clock
from sitl_tests.reference.kernels import filter_numpy as plain_filter
from sitl_tests.reference.kernels import lines as plain_lines
from sitl_tests.reference.kernels import outliers as plain_outliers
from sitl_tests.reference.kernels import prediction as plain_prediction
from sitl_tests.reference.kernels import rigid_body as plain_rigid_body
from sitl_tests.reference.kernels import row_noise as plain_row_noise
from sitl_tests.reference.kernels import smoother as plain_smoother
from sitl_tests.reference.kernels import streams as plain_streams
from sitl_tests.reference.kernels import trigger as plain_trigger
from sitl_tests.reference.kernels import whittle as plain_whittle

_FILTER_STATE = 3  # place of the state among the filter's arguments
_IN_PLACE = {"age_information": 0, "solve_parameters": 4}
"""Place of what a kernel that gives nothing works on among its arguments."""


def _valid(t_ns: Ints, values: Floats, sensor: Sensor, oldest_ns: int) -> bool:
    return plain_streams.all_valid(t_ns, values, streams.channel_ranges(sensor), oldest_ns)


def _remove_lines(*arguments: Any) -> Floats:
    with np.errstate(invalid="ignore"):  # before the first sample there is an infinite gap
        return plain_lines.remove_lines(*arguments)


def _fit(periodogram: Any, prior: Any, start: Floats, rounds: int) -> whittle.WhittleFit:
    log_params, best, information = plain_whittle.improve(periodogram, prior, start, rounds)
    return whittle.WhittleFit(log_params, np.sqrt(np.diag(np.linalg.inv(information))), best)


def _streaks(*arguments: Any) -> blur.Streaks:
    return blur.Streaks(*plain_trigger.streak_px(*arguments))


def _still_instants(forecast: blur.BlurForecast, from_host_ns: int = 0) -> list[PlannedInstant]:
    shape = (
        forecast.motion,
        forecast.motion_per_rate,
        forecast.acceleration_radps2,
        forecast.rate_covariance,
        forecast.q_covariance,
    )
    minima = plain_trigger.minima(forecast.t_host_ns, from_host_ns, *shape, forecast.spring, forecast.rms_px)
    first_ns = int(forecast.t_host_ns[0])
    return [PlannedInstant(first_ns + round(t), round(sigma), px) for t, sigma, px in minima.tolist()]


def _to_host(self: clock_map.ClockMap, t_ns: Ints) -> tuple[Ints, int, int, int]:
    host_ns, low, high, bound_ns = plain_clock.mapped(t_ns, self._stamps[: self._count], self._slopes[: self._count])
    return host_ns, int(low), int(high), bound_ns


def _centre(self: sync_set.FeasibleLines) -> tuple[float, float, float, float]:
    offset_ns, skew, half_offset_ns, half_skew = map(float, plain_clock.centre(self.corners))
    return offset_ns, skew, half_offset_ns, half_skew


def _within(
    self: sync_set.FeasibleLines, uppers: Floats, lowers: Floats, later_ns: float = 0.0
) -> sync_set.FeasibleLines | None:
    corners = plain_clock.cut(plain_clock.cut(self.moved(later_ns).corners, uppers, 1.0), lowers, -1.0)
    return sync_set.FeasibleLines(corners) if len(corners) else None


PLACES: dict[str, list[tuple[Any, str, Callable[..., Any]]]] = {
    "filter_epochs": [(filter, "filter_epochs", plain_filter.filter_epochs)],
    "bias_age": [(filter, "age_information", plain_bias.age_information)],
    "bias_solve": [(filter, "solve_parameters", plain_bias.solve_parameters)],
    "noise_terms": [(row_noise, "noise_terms", plain_row_noise.noise_terms)],
    "smoother_backward": [(smoother, "backward_pass", plain_smoother.backward_pass)],
    "forecast_powers": [(prediction, "powers", plain_prediction.powers)],
    "forecast_run": [(prediction, "run_ahead", plain_prediction.run_ahead)],
    "estimate_squares": [(validity, "rate_squares", plain_prediction.rate_squares)],
    "estimate_oscillation": [(estimates, "oscillation", plain_prediction.oscillation)],
    "stream_append": [(streams, "_appended", plain_streams.appended)],
    "stream_all_valid": [(streams, "_valid", _valid)],
    "stream_outliers": [(streams, "find_outliers", plain_outliers.find_outliers)],
    "lines_envelope": [(line_peaks, "squared_envelope", plain_lines.squared_envelope)],
    "lines_remove": [(streams, "remove_lines", _remove_lines)],
    "epochs_build": [(rigid_body, "build_epochs", plain_rigid_body.build_epochs)],
    "whittle_expected": [(whittle, "expected_power", plain_whittle.expected_power)],
    "whittle_cost": [
        (whittle, "neg_log_posterior", plain_whittle.neg_log_posterior),
        (spectral_fit, "neg_log_likelihood", plain_whittle.neg_log_likelihood),
        (slow_load, "neg_log_likelihood", plain_whittle.neg_log_likelihood),
    ],
    "whittle_gradient": [(frequency_drift, "gradient_and_fisher", plain_whittle.gradient_and_fisher)],
    "whittle_improve": [(spectral_fit, "fit", _fit)],
    "trigger_streaks": [(blur, "streaks", _streaks)],
    "trigger_minima": [(planner, "still_instants", _still_instants)],
    "clock_to_host": [(clock_map.ClockMap, "to_host", _to_host)],
    "clock_centre": [(sync_set.FeasibleLines, "centre", _centre)],
    "clock_cut": [(sync_set.FeasibleLines, "within", _within)],
}
"""Where each kernel of the live path is called, and what takes its place."""


def replace_kernels(patch: pytest.MonkeyPatch) -> Counter[str]:
    """Put the numpy version of every kernel into its place; give a count of the calls of each, which goes on."""
    calls: Counter[str] = Counter()
    for kernel, places in PLACES.items():
        for where, name, plain in places:
            patch.setattr(where, name, _counted(kernel, plain, calls))
    return calls


def spoil_kernel(patch: pytest.MonkeyPatch, kernel: str, ratio: float) -> None:
    """Make the results of a C kernel wrong by a ratio; stamps by so much of a second, and one of many truths."""
    for where, name, _ in PLACES[kernel]:
        patch.setattr(where, name, _spoilt(getattr(where, name), ratio))


def _counted(kernel: str, plain: Callable[..., Any], calls: Counter[str]) -> Callable[..., Any]:
    @functools.wraps(plain)
    def called(*arguments: Any, **named: Any) -> Any:
        calls[kernel] += 1
        return plain(*arguments, **named)

    return called


def _spoilt(kernel: Callable[..., Any], ratio: float) -> Callable[..., Any]:
    @functools.wraps(kernel)
    def called(*arguments: Any, **named: Any) -> Any:
        result = kernel(*arguments, **named)
        if isinstance(result, bool):  # of the filter, which works in place
            arguments[_FILTER_STATE].covariance[:] *= 1.0 + ratio
            return result
        if result is None:
            arguments[_IN_PLACE[kernel.__name__]][:] *= 1.0 + ratio
            return None
        return _wrong(result, ratio)

    return called


def _wrong(value: Any, ratio: float) -> Any:
    if isinstance(value, np.ndarray) and value.dtype == np.int64:
        return value + round(1e9 * ratio)
    if isinstance(value, np.ndarray) and value.dtype == np.bool_ and value.ndim == 1:
        return value ^ (np.arange(len(value)) == len(value) // 2)
    if isinstance(value, float) or (isinstance(value, np.ndarray) and value.dtype == np.float64):
        return value * (1.0 + ratio)
    if hasattr(value, "_fields"):
        return type(value)(*(_wrong(each, ratio) for each in value))
    if isinstance(value, tuple | list):
        return type(value)(_wrong(each, ratio) for each in value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        changed = {each.name: _wrong(getattr(value, each.name), ratio) for each in dataclasses.fields(value)}
        return dataclasses.replace(value, **changed)
    return value

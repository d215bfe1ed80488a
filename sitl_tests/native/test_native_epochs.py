"""Streams, their averages and the measurement rows against their numpy versions, on streams with every fault."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion import native
from companion.core.tracking import streams
from companion.core.tracking.error_jacobians import error_columns
from companion.core.tracking.rigid_body import _RootNoise, build_epochs
from companion.core.tracking.sample_outliers import find_outliers
from companion.core.tracking.sensor_errors import ROOT_ERRORS, SENSOR_ERRORS
from companion.core.tracking.states import make_layout
from companion.core.tracking.streams import StreamSamples
from companion.params.files import load_airframe
from companion.records import Floats, Ints
from sitl_tests.native.averaging import averages
from sitl_tests.reference.kernels import outliers as plain_outliers
from sitl_tests.reference.kernels import rigid_body as plain_rigid_body
from sitl_tests.reference.kernels import streams as plain

FIRST_NS, STEP_NS = 5_000_000_000_000, 4_000_000
LAYOUT = make_layout(load_airframe("nadir-2m"))


def _samples(rng: np.random.Generator, rate_hz: float, filtered: bool, seconds: float = 0.3) -> StreamSamples:
    """Uneven stamps, lost samples, an outage now and then, motion with noise."""
    period_ns = 1e9 / rate_hz
    t_ns = FIRST_NS - 60_000_000 + (np.arange(round(seconds * rate_hz)) * period_ns).astype(np.int64)
    t_ns = t_ns + rng.integers(-int(0.2 * period_ns), int(0.2 * period_ns), len(t_ns))
    keep = rng.random(len(t_ns)) > rng.choice([0.0, 0.05, 0.3])
    if rng.random() < 0.3:
        gap = int(rng.integers(0, len(t_ns)))
        keep[gap : gap + int(0.05 * rate_hz)] = False
    t_ns = t_ns[keep]
    t = 1e-9 * (t_ns - FIRST_NS)[:, None]
    values = np.sin(t * rng.uniform(10, 200, 6) + rng.uniform(0, 6, 6)) * np.array([2, 2, 5, 0.5, 0.5, 0.5])
    values[:, 2] -= rng.choice([9.8, 9.8, 0.0])
    values += 0.01 * rng.standard_normal(values.shape)
    cutoff_hz = np.where(rng.random(6) < 0.8, rng.uniform(20, 90, 6), 0.0) if filtered else np.zeros(6)
    return StreamSamples(t_ns, values, rate_hz, cutoff_hz, filtered)


def _agree(got: tuple[object, ...], expected: tuple[object, ...], names: tuple[str, ...]) -> None:
    for name, actual, desired in zip(names, got, expected, strict=True):
        size = float(np.abs(np.asarray(desired, np.float64)).max(initial=0.0))
        np.testing.assert_allclose(actual, desired, rtol=1e-9, atol=1e-10 * size + 1e-13, err_msg=name)


@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("rate_hz", [110.0, 400.0, 1000.0])
def test_averages_are_those_of_numpy(rate_hz: float, filtered: bool) -> None:
    covered = 0
    for seed in range(15):
        rng = np.random.default_rng(seed)
        samples = _samples(rng, rate_hz, filtered)
        edges_ns = FIRST_NS + int(rng.integers(0, STEP_NS)) + STEP_NS * np.arange(int(rng.integers(2, 60)))
        got, expected = averages(samples, edges_ns), plain.averages(samples, edges_ns)
        _agree(got, expected, got._fields)
        covered += int(got.covered.sum())
    assert covered > 50


@pytest.mark.parametrize("samples", [0, 1, 3, 4])
def test_a_handful_of_samples_covers_nothing_or_is_averaged(samples: int) -> None:
    t_ns = FIRST_NS + 1_000_000 * np.arange(samples)
    few = StreamSamples(t_ns, np.ones((samples, 6)), 1000.0, np.zeros(6), False)
    edges_ns = FIRST_NS + STEP_NS * np.arange(3)
    got = averages(few, edges_ns)
    _agree(got, plain.averages(few, edges_ns), got._fields)
    assert not got.covered.any()


def _build_arguments(rng: np.random.Generator, filtered: bool, columns: Ints) -> tuple[Any, ...]:
    """Arguments of ``build_epochs``: three streams with faults, axes that are not sent, any levers."""
    streams = (_samples(rng, 400.0, filtered), *(_samples(rng, 1000.0, False) for _ in range(2)))
    return (
        *streams, FIRST_NS + int(rng.integers(0, STEP_NS)), STEP_NS, int(rng.integers(1, 30)),
        rng.random((3, 6)) > rng.choice([0.0, 0.3]), rng.standard_normal((2, 3)),
        _RootNoise(2e-3, np.array([0.05, 0.05, 0.005])), columns, len(LAYOUT.bias_parameters),
    )  # fmt: skip


@pytest.mark.parametrize("filtered", [False, True], ids=["plain root", "filtered root"])
def test_rows_and_their_jacobian_are_those_of_numpy(filtered: bool) -> None:
    present = 0
    for seed in range(20):
        rng = np.random.default_rng(seed)
        columns = error_columns(LAYOUT).copy()
        columns[rng.random(columns.shape) < 0.2] = -1
        arguments = _build_arguments(rng, filtered, columns)
        got, expected = build_epochs(*arguments), plain_rigid_body.build_epochs(*arguments)
        _agree(got, expected, got._fields)
        present += int(got.present.sum())
    assert present > 500


def test_the_compiled_jacobian_has_the_errors_in_their_order() -> None:
    """Two errors that changed places would each fill the other's column."""
    (enum,) = re.findall(r"enum \{ ([A-Z, ]+), ERRORS \}", (Path(native.__file__).parent / "epochs.c").read_text())
    compiled = [name.lower() for name in enum.split(", ")]
    wanted = [*SENSOR_ERRORS, *ROOT_ERRORS]
    assert compiled == wanted, "enum of native/epochs.c: the errors of core/tracking/sensor_errors.py, in their order"


def test_an_error_that_the_compiled_jacobian_does_not_have_is_refused() -> None:
    """One more error in ``SENSOR_ERRORS`` would shift the columns of all others; a place beyond the last is none."""
    columns = error_columns(LAYOUT)
    beyond = columns.copy()
    beyond[0, 0] = len(LAYOUT.bias_parameters)
    below = columns.copy()
    below[0, 0] = -2
    for wrong in (np.insert(columns, 7, -1, axis=1), columns[:, :-1].copy(), columns[:2].copy(), beyond, below):
        with pytest.raises(TypeError, match="epochs_build"):
            build_epochs(*_build_arguments(np.random.default_rng(0), False, wrong))


def test_outliers_are_those_of_numpy() -> None:
    outlier_count = 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        samples = _samples(rng, 1000.0, False)
        values = samples.values.copy()
        struck = rng.integers(0, len(values), 3)
        values[struck, rng.integers(0, 6, 3)] += rng.choice([-1.0, 1.0], 3) * rng.uniform(0.5, 20.0, 3)
        arguments = (samples.t_ns, values, int(rng.integers(0, 40)), np.full(6, 0.014), 1e6)
        before = values.copy()
        got = find_outliers(*arguments)
        np.testing.assert_array_equal(got, plain_outliers.find_outliers(*arguments))
        np.testing.assert_array_equal(values, before)
        outlier_count += int(got.sum())
    assert outlier_count > 20


def _both_appended(t_ns: Ints, values: Floats, more_ns: Ints, more: Floats, needed_ns: int) -> bool:
    arguments = (t_ns, values, more_ns, more, 1_000_000, needed_ns)
    got, expected = streams._appended(*arguments), plain.appended(*arguments)
    np.testing.assert_array_equal(got[0], expected[0])
    np.testing.assert_array_equal(got[1], expected[1])
    assert got[2] == expected[2]
    return got[2]


def test_samples_are_appended_and_put_back_as_numpy_does() -> None:
    ordered = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        t_ns = FIRST_NS + np.cumsum(rng.integers(200_000, 2_000_000, 40))
        values = rng.standard_normal((40, 6))
        split = int(rng.integers(0, 41))
        first, more = (t_ns[:split], values[:split]), (t_ns[split:].copy(), values[split:])
        if seed % 3 == 0:
            rng.shuffle(more[0])
        ordered += _both_appended(*first, *more, FIRST_NS + int(rng.integers(0, 60_000_000)))
    assert 20 < ordered < 60


@pytest.mark.parametrize("spoilt", [None, 1.0, -1.0, 0.998, 0.9979, np.nan, np.inf, -np.inf])
def test_valid_is_what_numpy_calls_valid(spoilt: float | None) -> None:
    limits = np.repeat([100.0, 10.0], 3)
    for place in range(6):
        t_ns, values = FIRST_NS + np.arange(5), np.zeros((5, 6))
        if spoilt is not None:
            values[3, place] = spoilt * limits[place]
        for oldest_ns in (FIRST_NS - 1, FIRST_NS):
            expected = plain.all_valid(t_ns, values, limits, oldest_ns)
            assert bool(streams._all_valid(t_ns, values, 100.0, 10.0, oldest_ns)) == expected

"""A flight through the whole pipeline by the C kernels and by their readable numpy versions: the same toe and range.

Vibration of a propeller, an ordinary calibration, clocks that drift: all kernels of the live path have work. The last
bits of its data sometimes decide whether a Whittle fit takes another step of its scoring. So the flight is flown twice
by numpy. First each fit by numpy is held against the fit by C, which then is gone on with: every number of every output
is the same to rounding. Then with the fits by numpy: a fit may end in another minimum that is about as deep, and toes,
trusted ranges and their sigmas differ by a small part of what they are uncertain by (``companion/native/README.md``,
*Numbers*).
"""

from __future__ import annotations

import functools
from collections import Counter
from typing import Any

import numpy as np
import pytest

from companion.core.pipeline import start, step
from companion.core.tracking.adaptation import spectral_fit
from companion.core.tracking.adaptation.whittle import WhittleFit, fit
from companion.evaluation.replay_comparison import ReplayComparison
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Bools, CorrectedRange, Floats, Record
from companion.sim.flight.flight import build_flight
from companion.sim.flight.world_draw import as_calibrated
from companion.sim.flight.worlds import WORLDS
from sitl_tests.native.plain_kernels import PLACES, replace_kernels, spoil_kernel
from tools.bench.slow import in_order
from tools.bench.world_flight import StruckPair, judged_shots

DURATION_S = 16.0
SEED = 3
ROUNDING = 1e-7
"""Of every number of every output, where a fit goes on with that of C; 1e-9 was measured."""
A_STEP = 1e-2
"""Of a fitted parameter, in its sigmas, should scoring take another step; 5e-8 was measured."""
BY_FIT = 3e-2
"""Of a trusted range and of both its sigmas, where fits go on with those of numpy; 3e-4 and 2e-3 were measured."""
BY_FIT_SIGMAS, BY_FIT_MEDIAN = 0.25, 0.01
"""Of any toe (adds 6 % to a NEES), and of half of them, in sigmas, where fits go on with those of numpy: 0.12, 4e-5.

The last bits of its data decide which of two minima a fit ends in, where both are about as deep. Its parameters then
lie sigmas apart, and toes with them by a part of their sigma, until the data tell the minima apart.
"""
SPOILT = 1e-5
"""Error of a kernel that must show."""
UNSEEN = {
    "lines_envelope",  # only its mean and variance are held against each other
    "stream_all_valid",  # only spares work: where it says no, numpy looks again
    "whittle_cost",  # costs are held against each other: a common factor moves no choice, and weights by little
}
"""Kernels whose error by a ratio shows in no flight; the tests beside this one hold their values."""


@functools.cache
def _flown() -> tuple[Airframe, tuple[Record, ...]]:
    """The airframe that the pipeline is given, and its inputs in order."""
    airframe = as_calibrated(load_airframe("nadir-2m"), WORLDS["fair"])
    flight = build_flight(airframe, SEED, DURATION_S, world=WORLDS["fair"])
    return airframe, tuple(in_order(flight, list(judged_shots(flight, StruckPair(flight, 0.0)))))


def _outputs() -> list[Record]:
    airframe, inputs = _flown()
    state, outputs = start(airframe, Settings()), []
    for record in inputs:
        state, more = step(state, record)
        outputs += more
    return outputs


@functools.cache
def _by_c() -> tuple[tuple[Record, ...], tuple[WhittleFit, ...]]:
    """Outputs by the C kernels, and the fits on the way to them."""
    fits: list[WhittleFit] = []

    def noted(*arguments: Any) -> WhittleFit:
        fits.append(fit(*arguments))
        return fits[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(spectral_fit, "fit", noted)
        return tuple(_outputs()), tuple(fits)


def _by_numpy() -> tuple[list[Record], Counter[str]]:
    with pytest.MonkeyPatch.context() as patch:
        calls = replace_kernels(patch)
        return _outputs(), calls


def _by_numpy_with_the_fits_of_c() -> tuple[list[Record], list[float]]:
    """Outputs, and by how many sigmas the farthest parameter of each fit by numpy was off."""
    by_c, off_sigmas = iter(_by_c()[1]), []

    with pytest.MonkeyPatch.context() as patch:
        replace_kernels(patch)
        by_numpy = spectral_fit.fit

        def held(*arguments: Any) -> WhittleFit:
            numpy_fit, expected = by_numpy(*arguments), next(by_c)
            off_sigmas.append(float(np.abs((numpy_fit.log_params - expected.log_params) / expected.log_sigma).max()))
            return expected

        patch.setattr(spectral_fit, "fit", held)
        return _outputs(), off_sigmas


def _compared(outputs: list[Record]) -> ReplayComparison:
    comparison = ReplayComparison(ROUNDING)
    c_outputs = _by_c()[0]
    for at in range(max(len(c_outputs), len(outputs))):
        comparison.compare(*(each[at] if at < len(each) else None for each in (c_outputs, outputs)))
    return comparison


def _ranges(outputs: tuple[Record, ...] | list[Record]) -> Floats:
    """Toe, range and their sigmas of every shot, (n, 4)."""
    ranges = [record for record in outputs if isinstance(record, CorrectedRange)]
    return np.array([(each.toe_rad, each.toe_sigma_rad, each.range_m, each.sigma_m) for each in ranges])


def _trusted(outputs: tuple[Record, ...] | list[Record]) -> Bools:
    """Whether each range is trusted, (n,)."""
    return np.array([record.trusted for record in outputs if isinstance(record, CorrectedRange)])


@pytest.mark.long
def test_a_flight_by_numpy_is_the_flight_by_c_to_rounding() -> None:
    outputs, off_sigmas = _by_numpy_with_the_fits_of_c()
    assert len(off_sigmas) == len(_by_c()[1]) > 50
    assert max(off_sigmas) < A_STEP
    assert _compared(outputs).difference is None
    ranges = _ranges(outputs)
    assert len(ranges) > 80
    assert any(record.trusted for record in outputs if isinstance(record, CorrectedRange))
    np.testing.assert_allclose(ranges, _ranges(_by_c()[0]), rtol=ROUNDING, atol=1e-9)


@pytest.mark.long
def test_a_flight_whose_fits_are_numpys_too_has_the_same_toe_and_range() -> None:
    outputs, calls = _by_numpy()
    assert set(calls) == set(PLACES), "every kernel had work"
    by_c, by_numpy = _ranges(_by_c()[0]), _ranges(outputs)
    apart_sigmas = np.abs(by_numpy - by_c)[:, 0] / by_c[:, 1]
    assert apart_sigmas.max() < BY_FIT_SIGMAS
    assert np.median(apart_sigmas) < BY_FIT_MEDIAN
    trusted, too = _trusted(_by_c()[0]), _trusted(outputs)
    assert trusted.sum() > 10
    np.testing.assert_array_equal(too, trusted)
    np.testing.assert_allclose(by_numpy[trusted, 1:], by_c[trusted, 1:], rtol=BY_FIT)


@pytest.mark.long
@pytest.mark.parametrize("kernel", sorted(set(PLACES) - UNSEEN))
def test_a_kernel_that_is_wrong_is_seen(kernel: str, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = _by_c()
    spoil_kernel(monkeypatch, kernel, SPOILT)
    assert expected
    assert _compared(_outputs()).difference is not None

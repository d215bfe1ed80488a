"""The clocks' inner loops against their numpy versions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.clock.clock_map import ClockMap
from companion.core.clock.sync_set import FeasibleLines
from companion.records import Floats
from sitl_tests.reference.kernels import clock as plain

BOX = FeasibleLines.box(-5e6, 5e6, (-2e-4, 2e-4))


def _map(rng: np.random.Generator, knots: int) -> ClockMap:
    clock, host_ns = ClockMap(), 10**12
    for _ in range(knots):
        offset_ns, skew = 1e5 * rng.standard_normal(), 1e-4 * rng.standard_normal()
        clock.steer(host_ns, offset_ns, -7 * 10**9, skew, abs(1e5 * rng.standard_normal()), 1e-5 * rng.random())
        host_ns += int(rng.integers(1, 200_000_000))
    return clock


@pytest.mark.parametrize("knots", [1, 2, 40, 300])
def test_stamps_are_mapped_as_numpy_maps_them(knots: int) -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        clock = _map(rng, knots)
        used = clock._stamps[: clock._count]
        span = (int(used[0, 0]) - 10**9, int(used[-1, 0]) + 10**9)
        t_ns = rng.integers(*span, size=int(rng.integers(1, 60)))
        if seed % 2:
            t_ns.sort()
        host_ns, *ends_ns = clock.to_host(t_ns)
        expected_ns, *expected_ends_ns = plain.mapped(t_ns, used, clock._slopes[: clock._count])
        np.testing.assert_array_equal(host_ns, expected_ns)
        assert ends_ns == expected_ends_ns


def _bounds(rng: np.random.Generator, count: int, sign: float) -> Floats:
    at = rng.uniform(-1e10, 1e10, count)
    return np.stack([at, sign * np.abs(3e6 * rng.standard_normal(count))], axis=1)


@given(st.integers(0, 2**32), st.integers(0, 12), st.integers(0, 12), st.floats(0.0, 1e9))
def test_polygons_are_moved_cut_and_centred_as_numpy_does(seed: int, uppers: int, lowers: int, later_ns: float) -> None:
    rng = np.random.default_rng(seed)
    above, below = _bounds(rng, uppers, 1.0), _bounds(rng, lowers, -1.0)
    moved = BOX.corners + np.stack([later_ns * BOX.corners[:, 1], np.zeros(len(BOX.corners))], axis=1)
    expected = plain.cut(plain.cut(moved, above, 1.0), below, -1.0)
    cut = BOX.within(above, below, later_ns)
    if cut is None:
        assert not len(expected)
        return
    np.testing.assert_allclose(cut.corners, expected, rtol=1e-12)
    np.testing.assert_allclose(cut.centre(), plain.centre(expected), rtol=1e-9, atol=1e-12)


def test_more_corners_than_a_convex_set_can_have_are_kept() -> None:
    """Rounding may fold a set that has almost no extent; here a star does the same on purpose."""
    angle = np.linspace(0.0, 2.0 * np.pi, 41)[:-1]
    radius = np.where(np.arange(40) % 2, 1.0, 3.0)
    star = FeasibleLines(np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1))
    bound = np.array([[0.0, 0.5]])
    cut = star.within(bound, np.empty((0, 2)))
    assert cut is not None
    np.testing.assert_allclose(cut.corners, plain.cut(star.corners, bound, 1.0))

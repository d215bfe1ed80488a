"""The set of possible clock lines, against a linear program solver."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from companion.core.clock.sync_set import FeasibleLines

MOST_SKEW = 5e-4
ANY_SKEW = (-MOST_SKEW, MOST_SKEW)


def constraints(seed: int, count: int) -> list[tuple[float, float, bool]]:
    """Bounds around a true line: at most (True) or at least."""
    rng = np.random.default_rng(seed)
    offset, skew = rng.normal(0.0, 1e6), rng.uniform(-4e-4, 4e-4)
    at = -rng.uniform(0.0, 60e9, count)
    slack = rng.exponential(3e6, count)
    upper = rng.random(count) < 0.5
    line = offset + skew * at
    return [(t, v, bool(u)) for t, v, u in zip(at, np.where(upper, line + slack, line - slack), upper, strict=True)]


def one_more(lines: FeasibleLines, at: float, limit: float, upper: bool) -> FeasibleLines | None:
    bound, nothing = np.array([[at, limit]]), np.empty((0, 2))
    return lines.within(bound, nothing) if upper else lines.within(nothing, bound)


@pytest.mark.parametrize("seed", range(20))
def test_extent_and_centre_are_those_of_the_linear_program(seed: int) -> None:
    bounds = constraints(seed, 30)
    lines: FeasibleLines | None = FeasibleLines.box(-1e9, 1e9, ANY_SKEW)
    for at, limit, upper in bounds:
        assert lines is not None
        lines = one_more(lines, at, limit, upper)
    assert lines is not None
    centre, skew, half_width, half_skew = lines.centre()
    # unknowns: offset in ms, skew in ppm
    rows = np.array([[1.0, at * 1e-12] if upper else [-1.0, -at * 1e-12] for at, _, upper in bounds])
    limits = np.array([limit * 1e-6 if upper else -limit * 1e-6 for _, limit, upper in bounds])
    box = [(-1e3, 1e3), (-MOST_SKEW * 1e6, MOST_SKEW * 1e6)]
    least, most = (linprog([sign, 0.0], A_ub=rows, b_ub=limits, bounds=box).x for sign in (1.0, -1.0))
    assert (centre - half_width) * 1e-6 == pytest.approx(least[0], abs=1e-5)
    assert (centre + half_width) * 1e-6 == pytest.approx(most[0], abs=1e-5)
    assert np.all(rows @ np.array([centre * 1e-6, skew * 1e6]) <= limits + 1e-6)
    flattest, steepest = (linprog([0.0, sign], A_ub=rows, b_ub=limits, bounds=box).x[1] for sign in (1.0, -1.0))
    assert skew * 1e6 - half_skew * 1e6 <= flattest + 1e-6
    assert skew * 1e6 + half_skew * 1e6 >= steepest - 1e-6


def test_contradicting_bounds_leave_nothing() -> None:
    lines = FeasibleLines.box(-10.0, 10.0, (0.0, 0.0))
    below = one_more(lines, 0.0, -1.0, upper=True)
    assert below is not None
    assert one_more(below, 0.0, 1.0, upper=False) is None
    assert lines.within(np.array([[0.0, -1.0]]), np.array([[0.0, 1.0]])) is None


@pytest.mark.parametrize("seed", range(20))
def test_many_bounds_at_once_leave_what_they_leave_one_by_one(seed: int) -> None:
    bounds = constraints(seed, 30)
    box = FeasibleLines.box(-1e9, 1e9, ANY_SKEW)
    uppers, lowers = ([(at, limit) for at, limit, upper in bounds if upper is which] for which in (True, False))
    together = box.within(np.array(uppers), np.array(lowers))
    lines: FeasibleLines | None = box
    for at, limit, upper in bounds:
        assert lines is not None
        lines = one_more(lines, at, limit, upper)
    assert together is not None
    assert lines is not None
    assert together.centre() == pytest.approx(lines.centre())


def test_moving_the_reference_keeps_the_lines() -> None:
    lines = one_more(FeasibleLines.box(-1e6, 1e6, ANY_SKEW), -1e9, 0.0, upper=True)
    assert lines is not None
    moved = lines.moved(5e9)
    for (offset, skew), (later, same) in zip(lines.corners, moved.corners, strict=True):
        assert skew == same
        assert later == pytest.approx(offset + 5e9 * skew)

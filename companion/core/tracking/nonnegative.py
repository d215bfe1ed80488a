"""Least squares whose unknowns are not negative, by Lawson and Hanson's active set."""

from __future__ import annotations

import numpy as np

from companion.records import Bools, Floats

_ROUNDS_PER_UNKNOWN = 3  # Lawson and Hanson, Solving Least Squares Problems, chapter 23: their bound on the iterations
_ROUNDING = 10.0 * float(np.finfo(np.float64).eps)  # chosen, of the largest gradient: what is below is rounding


def nonnegative_least_squares(equations: Floats, right_side: Floats) -> Floats:
    """Vector ``x >= 0`` with the least ``|equations @ x - right_side|``.

    For a few unknowns: each step solves a small dense problem.

    Parameters
    ----------
    equations : (m, n) float64
        Columns may be dependent.
    right_side : (m,) float64
        What the equations should give.

    Returns
    -------
    (n,) float64
    """
    count = equations.shape[1]
    solution, free = np.zeros(count), np.zeros(count, dtype=bool)
    negligible = (
        _ROUNDING * max(equations.shape) * float(np.abs(equations).sum(axis=0).max() * np.abs(right_side).max())
    )
    for _ in range(_ROUNDS_PER_UNKNOWN * count):
        gradient = np.where(free, 0.0, equations.T @ (right_side - equations @ solution))
        if gradient.max() <= negligible:
            break
        free[gradient.argmax()] = True
        solution, free = _brought_inside(equations, right_side, solution, free)
    return solution


def _brought_inside(equations: Floats, right_side: Floats, inside: Floats, free: Bools) -> tuple[Floats, Bools]:
    """Solution of the free unknowns, those that it would make negative held at 0; and which are free still."""
    free = free.copy()
    while free.any():
        unbound = np.zeros_like(inside)
        unbound[free] = np.linalg.lstsq(equations[:, free], right_side, rcond=None)[0]
        leaving = free & (unbound <= 0.0)
        if not leaving.any():
            return unbound, free
        fractions = np.divide(inside, inside - unbound, out=np.zeros_like(inside), where=inside > unbound)
        fraction = fractions[leaving].min()  # of the way: there the first of them is 0
        free &= ~(leaving & (fractions == fraction))
        inside = np.where(free, inside + fraction * (unbound - inside), 0.0)
    return np.zeros_like(inside), free

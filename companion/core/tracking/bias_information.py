"""Information of the bias parameters: its time update, marginalisation and solution (Friedland's separated bias).

The information matrix (1 + c, 1 + c) belongs to ``[1; c]``: column 0 holds its vector with minus sign. Time update and
solution, ten times a second, are C: ``native/bias.c``.
"""

from __future__ import annotations

import numpy as np

from companion.native.library import ARRAY, REAL, kernel
from companion.records import Floats, Ints

_age = kernel("bias_age", ARRAY, ARRAY, ARRAY, ARRAY, ARRAY, REAL)
_solve = kernel("bias_solve", ARRAY, ARRAY, ARRAY, ARRAY, ARRAY, ARRAY)


def age_information(
    accumulated: Floats,
    state_and_sensitivity: Floats,
    covariance: Floats,
    wandering: Ints,
    sigma: Floats,
    autocorrelation: float,
) -> None:
    """Time update of the wandering bias parameters, in information form and in place.

    A first-order process: ``c_old = r c_new + noise``. The noise is marginalised; the state's dependence on it becomes
    its own variance. ``accumulated`` is the information (1 + c, 1 + c), ``state_and_sensitivity`` (n + 1, 1 + c),
    ``covariance`` (n, n); ``wandering`` has their columns (w,), ``sigma`` (c,) all stationary sigmas.
    """
    _age(accumulated, state_and_sensitivity, covariance, wandering, sigma, autocorrelation)


def marginalise(
    accumulated: Floats,
    state_and_sensitivity: Floats,
    covariance: Floats,
    column: int,
    prior_information: float,
    *,
    considered: bool,
) -> None:
    """Integrate one bias parameter out of information, sensitivities and covariance, in place.

    Of a considered one nothing is learned: its prior alone says how uncertain it was. Shapes as in
    :func:`age_information`; ``prior_information`` is one over the prior's variance.
    """
    if considered:
        accumulated[column, :], accumulated[:, column] = 0.0, 0.0
    others = np.flatnonzero(np.arange(len(accumulated)) != column)
    strength = accumulated[column, column] + prior_information
    regression = accumulated[column, others] / strength  # with minus sign: how the constant follows from the others
    accumulated[np.ix_(others, others)] -= strength * np.outer(regression, regression)
    accumulated[column, :], accumulated[:, column] = 0.0, 0.0
    sensitivity_column = state_and_sensitivity[:-1, column].copy()
    state_and_sensitivity[:-1, others] -= np.outer(sensitivity_column, regression)
    covariance += np.outer(sensitivity_column, sensitivity_column) / strength
    state_and_sensitivity[:-1, column] = 0.0


def solve_parameters(
    accumulated: Floats, sigma: Floats, estimated: Ints, considered: Ints, bias_parameters: Floats, covariance: Floats
) -> None:
    """Bias parameters and their covariance, in place; ``considered`` ones stay at their priors (Schmidt).

    Not a number where the information (1 + c, 1 + c) is not positive definite or not finite: the filter has run away.
    ``estimated`` and ``considered`` are indices into the parameters (c,), whose covariance is (c, c).
    """
    _solve(accumulated, sigma, estimated, considered, bias_parameters, covariance)

"""Time update and solution of the bias parameters' information in numpy: ``native/bias.c``."""

from __future__ import annotations

import numpy as np

from companion.records import Floats, Ints


def age_information(
    information: Floats, state: Floats, covariance: Floats, wandering: Ints, sigma: Floats, autocorrelation: float
) -> None:
    """Marginalise the noise of each wandering column, in place; ``state`` has the sensitivities beside it."""
    for column in wandering:
        noise = (1.0 - autocorrelation * autocorrelation) * sigma[column - 1] ** 2
        learned, sensitivity_column = information[column].copy(), state[:-1, column].copy()
        gain = noise / (1.0 + noise * learned[column])
        state[:-1] -= gain * np.outer(sensitivity_column, learned)
        covariance += gain * np.outer(sensitivity_column, sensitivity_column)
        information -= gain * np.outer(learned, learned)
        information[column, :] *= autocorrelation
        information[:, column] *= autocorrelation
        state[:-1, column] *= autocorrelation


def solve_parameters(
    accumulated: Floats, sigma: Floats, estimated: Ints, considered: Ints, bias_parameters: Floats, covariance: Floats
) -> None:
    """Bias parameters and their covariance, in place; ``considered`` ones stay at their priors (Schmidt)."""
    information = accumulated[estimated + 1][:, estimated + 1] + np.diag(1.0 / sigma[estimated] ** 2)
    estimated_covariance = np.linalg.inv(information)
    estimated_covariance = 0.5 * (estimated_covariance + estimated_covariance.T)
    consider_map = -estimated_covariance @ accumulated[estimated + 1][:, considered + 1]
    consider_gain = consider_map * sigma[considered] ** 2
    estimated_total = estimated_covariance + consider_gain @ consider_map.T
    bias_parameters[estimated] = -estimated_covariance @ np.ascontiguousarray(accumulated[estimated + 1, 0])
    covariance[estimated[:, None], estimated] = estimated_total
    covariance[estimated[:, None], considered] = consider_gain
    covariance[considered[:, None], estimated] = consider_gain.T

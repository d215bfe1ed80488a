"""Error of the slope factors by the spectral fit: a gyro tells a mode's slope only beside the other modes' motion.

At its resonance a mode answers the load in quadrature, the family's other modes in phase with it. A frequency that is
wrong by ``delta`` (relative) turns the mode's answer by ``delta / damping``, and so much of it passes for theirs: where
the loads are coherent, the gyro then sees the difference of the slope factors in the ratio

    2 delta |chi_other| sqrt(G_other / G),    |chi_other| = f^2 / |f_other^2 - f^2|

with G a load's density. A false frequency is constant, and no flight averages its effect away.
"""

from __future__ import annotations

import numpy as np

from companion.core.tracking.model import WingParameters
from companion.core.tracking.parameters import FREQUENCY, parameter_index
from companion.core.tracking.states import StateLayout
from companion.records import Floats

_MIN_LOAD = 1e-30  # numerical, (m/s^2)^2/Hz: of a mode that no load drives


def slope_factor_variance(layout: StateLayout, parameters: WingParameters) -> Floats:
    """Variance of every bias parameter by the standard errors of the modal frequencies, (c,).

    Parameters
    ----------
    layout : StateLayout
        State vector of the airframe.
    parameters : (symmetric, antisymmetric)
        With the standard errors of the fit.

    Returns
    -------
    (c,) float64
        Zero for all but slope factors, (rad/m)^2.
    """
    variance = np.zeros(len(layout.bias_parameters))
    for family, fitted in zip(layout.families, parameters, strict=True):
        count = len(fitted.modes)
        index = parameter_index([count])
        places = FREQUENCY + np.concatenate([index.first, index.further])
        slopes = np.array([mode.slope_factor_radpm.value for mode in family.modes])
        square_hz = np.array([mode.frequency_hz for mode in fitted.modes]) ** 2
        loads = np.maximum(fitted.white_loads, _MIN_LOAD)
        apart = np.where(np.eye(count, dtype=bool), np.inf, np.abs(square_hz[None, :] - square_hz[:, None]))
        ratio = square_hz[:, None] / np.maximum(apart, 1e-9) * np.sqrt(loads[None, :] / loads[:, None])
        error = 2.0 * fitted.log_sigma[places][:, None] * ratio * (slopes[None, :] - slopes[:, None])
        for name, square in zip(family.names, (error**2).sum(axis=1), strict=True):
            column = layout.column(f"slope.{name}")
            if column is not None:
                variance[column - 1] = square
    return variance

"""Sensors' errors in the measurement rows: their names, their columns, and which contain a measurement.

The Jacobian of the rows by these errors is ``tip_errors``, ``root_errors`` and ``roll_errors`` in ``native/epochs.c``,
whose enum has the errors of :mod:`companion.core.tracking.sensor_errors` in their order; it refuses another number.

A sensor with scale errors ``k`` (per axis), misalignment ``m`` (small rotation vector) and stamp error ``tau`` reads
``(1 + k) (f - m x f)(t - tau)``, and likewise for the rate. The biases of the root's rates change the rest wing's
centripetal force ``w x (w x r)``: in a roll of 0.6 rad/s a milliradian per second is a tenth of a milliradian of slope.

The measured values stand in for the true ones (errors in variables). The bias that this regression on the measurement's
own noise would have is removed by :class:`companion.core.tracking.filter.SeparatedBiasFilter`, which takes the
innovation out again wherever :func:`measured_regressors` says that it is in.
"""

from __future__ import annotations

import numpy as np

from companion.core.tracking.sensor_errors import ROOT_ERRORS, SENSOR_ERRORS
from companion.core.tracking.states import M_LEFT, P_LEFT, P_ROOT, Y_LEFT, Z_LEFT, StateLayout
from companion.records import Ints

_PLACES = ("root", "left", "right")
_ERRORS = (*SENSOR_ERRORS, *ROOT_ERRORS)
EARLIER = 3  # chosen, epochs: past the root's smoothing over three, and most of what the roll rate's estimate remembers
AVERAGED = 12  # chosen, epochs: 48 ms, in which a shaft's vibration averages out and a manoeuvre hardly changes
_Z, _M, _Y, _P, _P0 = Z_LEFT, M_LEFT, Y_LEFT, P_LEFT, P_ROOT


def error_columns(layout: StateLayout) -> Ints:
    """Column of each error (``SENSOR_ERRORS``, ``ROOT_ERRORS``) of root, left and right, (3, e); -1 where absent."""
    index = {name: at for at, name in enumerate(layout.bias_parameters)}
    return np.array([[index.get(f"{place}.{error}", -1) for error in _ERRORS] for place in _PLACES], np.int64)


def measured_regressors(layout: StateLayout) -> list[tuple[int, int, int, float]]:
    """Row, column, source row and sign of the sensitivities that contain the measurement of a source row.

    A tip's roll rate contains the rigid one, measured by the root: the regressor has the root's mean of some epochs
    before in its place (``scaled_p`` of ``tip_errors`` in ``native/epochs.c``).
    """
    regressors: list[tuple[int, int, int, float]] = []
    for side, place in ((0, "left"), (1, "right")):
        z, m, y, p = _Z + side, _M + side, _Y + side, _P + side
        for error, row, source, sign in (
            ("kz", z, z, 1.0),
            ("kz", m, m, 1.0),
            ("kz", y, y, -1.0),
            ("ky", y, y, 1.0),
            ("kp", p, p, 1.0),
            ("kp", p, _P0, -1.0),
        ):
            column = layout.column(f"{place}.{error}")
            if column is not None:
                regressors.append((row, column, source, sign))
    column = layout.column("root.kp")
    return [*regressors, (_P0, column, _P0, 1.0)] if column is not None else regressors

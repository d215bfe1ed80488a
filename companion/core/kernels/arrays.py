"""What the filter's inner loop takes and leaves: see :mod:`companion.core.tracking.filter` for its equations.

The loop itself exists twice: :mod:`companion.core.kernels.filter_loops` is compiled, and
:mod:`companion.core.kernels.filter_numpy` runs where that cannot be. Both use the rows that were measured alone, and
whiten them: with ``S = L L^T`` the history holds ``L^-1 G``, ``L^-1 e`` and ``L^-1 C^T``, from which gain, likelihood
and smoother follow by products.

Both noises have heavy tails. Where a vertical row's innovation lies beyond the gate, the wing may have been struck, or
its sensor lies: either way the process noise of this step is raised until the innovation is no surprise, so that the
state follows and knows that it is uncertain. Another row that lies beyond the gate even so counts as noisier, so that
its pull is that of a row at the gate (Huber). The constants learn nothing from such a step. How surprising it is counts
as if nothing had been raised, but bounded: a blow of 20 ms is no contradiction, and what goes on for longer is.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from companion.records import Bools, Floats, Ints

LOAD_TIME_S = 0.1
GATE = 5.0  # sigmas
LIFTED = 2.0  # share of the variance of the root's force that drives the wing, by the load factor's bend
MOST_STIR = 1e6  # of the process noise
MOST_SURPRISE = 200.0  # of a step: the sum of its rows' squares
_MOTIONS = 8  # more than a history holds, for parameters change once a second


class Fixed(NamedTuple):
    """What never changes of a wing.

    Attributes
    ----------
    step_s, trim_m, bend_per_g_m, root_z, root_y : float
    trim, bend : int
        Columns of these constants, 0 where they are certain.
    own : (9,) float64
        Sensor noise variances.
    lateral_bias : (2,) int64
        States that hold the lateral biases; -1 where there is none.
    leaning : (2,) int64
        Columns of the tips' misalignment about the body's x axis, 0 where it is certain.
    vertical_bias : (2,) int64
        States that hold the vertical biases; -1 where there is none.
    own_bias : (2, 2) float64
        See :class:`companion.core.tracking.states.Noise`.
    force_bias : int
        Column of what the vertical biases have in common, 0 where it tells nothing.
    factor_rows, factor_columns : (f,) int64
        Where the slope factors show.
    own_rows, own_columns : (s,) int64
    own_signs : (s,) float64
        Sensitivities that are to be taken at the prediction instead of at the measurement, which holds the innovation.
    """

    step_s: float
    trim_m: float
    bend_per_g_m: float
    root_z: float
    root_y: float
    trim: int
    bend: int
    own: Floats
    lateral_bias: Ints
    leaning: Ints
    vertical_bias: Ints
    own_bias: Floats
    force_bias: int
    factor_rows: Ints
    factor_columns: Ints
    own_rows: Ints
    own_columns: Ints
    own_signs: Floats


class Step(NamedTuple):
    """The model of one step as plain arrays: see :class:`companion.core.tracking.model.StepModel`.

    Attributes
    ----------
    motion : (n, n) float64
        The transition without the static bend.
    static : (n,) float64
        What the static bend adds.
    to, of : (t,) int64
    share : (t,) float64
        What is not zero of the motion (a tenth), row after row: ``motion[to, of] = share``.
    number : int
        Where the history keeps the motion.
    cross : (9, n) float64
        Transposed.
    watch : (4 + f, n + 1) float64
        Tip slopes, tip slope rates and what multiplies the slope factors.
    """

    motion: Floats
    static: Floats
    to: Ints
    of: Ints
    share: Floats
    number: int
    sense: Floats
    noise: Floats
    cross: Floats
    measured: Floats
    watch: Floats
    cut: float
    rough: bool


class Data(NamedTuple):
    """A run of cells as plain arrays: see :class:`companion.core.tracking.rigid_body.Cells`."""

    rows: Floats
    present: Bools
    vertical: Floats
    lateral: Floats
    tilted: Floats
    lateral_gain: Floats
    load: Floats
    sensitivity: Floats
    cut: Floats
    shaken: Floats


class Memory(NamedTuple):
    """What one step leaves for the next: see :class:`companion.core.tracking.filter.Kalman`.

    Attributes
    ----------
    columns : (n + 1, 1 + c) float64
    covariance : (n, n) float64
    information : (1 + c, 1 + c) float64
    weights : (1 + c,) float64
        One and the constants.
    surprise : (2,) float64
        Fading sums of squared normalised innovations, bounded in each step, and of their number.
    """

    columns: Floats
    covariance: Floats
    information: Floats
    weights: Floats
    surprise: Floats


class History(NamedTuple):
    """What the smoother needs of each step, in rings; slot ``k % size`` is step ``k``.

    Attributes
    ----------
    state : (size, n, 1 + c) float64
        At the start of the step.
    covariance : (size, n, n) float64
    transition : (m, n, n) float64
        The few that there were.
    by : (size,) int64
        Which of these each step was.
    used : (size,) int64
        How many rows were used; as many rows of the next three are valid.
    seen : (size, 9, n) float64
        ``L^-1 G``.
    innovation : (size, 9, 1 + c) float64
        ``L^-1`` times the innovation.
    drawn : (size, 9, n) float64
        ``L^-1 C^T``.
    static_m : (size, 1 + c) float64
    excess : (size, 9) float64
        What of a row teaches nothing: by how much a lapse's innovation exceeds the gate, or all of it where most of its
        variance is a shaken root's; else 0.
    """

    state: Floats
    covariance: Floats
    transition: Floats
    by: Ints
    used: Ints
    seen: Floats
    innovation: Floats
    drawn: Floats
    static_m: Floats
    excess: Floats


def make_history(size: int, states: int, constants: int, rows: int) -> History:
    """Empty rings for ``size`` steps."""
    return History(
        state=np.zeros((size, states, 1 + constants)),
        covariance=np.zeros((size, states, states)),
        transition=np.zeros((_MOTIONS, states, states)),
        by=np.zeros(size, np.int64),
        used=np.zeros(size, np.int64),
        seen=np.zeros((size, rows, states)),
        innovation=np.zeros((size, rows, 1 + constants)),
        drawn=np.zeros((size, rows, states)),
        static_m=np.zeros((size, 1 + constants)),
        excess=np.zeros((size, rows)),
    )

"""Array types of the filter's inner loop: constants, discrete model, measurements, state and history.

The equations are in :mod:`companion.core.tracking.filter`. The loop is C and processes the rows that were measured and
whitens them: with ``S = L L^T`` the history holds ``L^-1 H``, ``L^-1 e`` and ``L^-1 C^T``, from which gain,
likelihood and smoother follow as products.

Process and measurement noise have heavy tails. An innovation e of a vertical row beyond the gate of 5 sigma raises the
process noise of that step until the row's variance S is larger by ``e^2 - 25 S``, so that a large e lies at about one
sigma: the state follows a blow, and its covariance says so. Any other row beyond the gate is given the variance
``|e| sqrt(S) / 5``, that is Huber's weight ``5 sqrt(S) / |e|``. The bias parameters learn nothing from such a step.
The gate is wider where the bias parameters that a flight may teach are uncertain: by their share of a whitened row's
variance. What they may explain teaches them instead.
Where the root is struck, the load factor then measured bends no wing: modes and loads become as uncertain as those of
an unknown gust. A step's normalised innovation squared (NIS) is counted as without the inflation, but bounded where a
row lies beyond the gate: a blow of 20 ms is no contradiction of the model, a lasting one is.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar, cast

import numpy as np

from companion.records import Bools, Floats, Ints

LOAD_FACTOR_TIME_S = (
    1.0  # measured (bench world): noise of the load factor drew bend per g by 4 sigma at 0.1 s, by 1 at 1 s
)
GATE_SIGMAS = 5.0  # convention: a Gaussian innovation lies beyond once in 1.7 million
LOAD_VARIANCE_RATIO = 0.7  # chosen: variance of the wing's load per variance of a shaken root's vertical force
MAX_NOISE_INFLATION = 1e6  # numerical: bound on the process noise's factor
MAX_STEP_NIS = 200.0  # chosen: a 20 ms blow (5 steps) then stays below NIS_LIMIT over a second
STRUCK_SIGMAS = 3.0  # chosen: of both tips' vertical rows, beside a root whose motion makes up half of their variance
# chosen: tips behind a petrol engine reach 0.38; a state beyond it is wrong, and the derivatives there drove it on
MOST_TILT_RAD = 0.5
_Array = TypeVar("_Array", bound=Any)
_TRANSITIONS = 8  # derived: parameters change once a second, and a history holds little more than one second


def plain(array: _Array) -> _Array:
    """The array, or a contiguous copy of a view with gaps, which no compiled loop takes."""
    return array if array.flags.c_contiguous else cast(_Array, array.copy())


def row_medians(values: Floats) -> Floats:
    """Median of each row, (m,), of ``values`` (m, n): for short rows at a fraction of the price of numpy's; no NaN."""
    ordered, n = np.sort(values, axis=1), values.shape[1]
    return np.asarray(0.5 * (ordered[:, (n - 1) // 2] + ordered[:, n // 2]))


class Epochs(NamedTuple):
    """Measurements of all sensors over consecutive averaging epochs: made in ``rigid_body``, filtered in the kernel.

    Attributes
    ----------
    start_ns : (n,) int64
        Beginning of each epoch, host clock.
    rows : (n, 9) float64
        Measurements z in the order of :mod:`companion.core.tracking.states`; 0 where absent.
    present : (n, 9) bool
        Rows that were measured.
    vertical_mps2, lateral_mps2 : (n, 2) float64
        Sensed vertical and rigid lateral specific force at the left and right tip, lateral signed for the side; in the
        vertical one the root's part is the mean of some epochs before, without this epoch's noise. A tip's slope
        ``psi`` adds ``-(vertical psi^2 / 2 + lateral psi)`` to its vertical row.
    slope_rate_gain : (n, 2) float64
        Coefficient of a tip's slope rate in its slope row, s: slope and force change together inside the epoch.
    lateral_gain : (n, 2) float64
        Inverse of the vertical specific force, signed for the side, s^2/m: slope row per lateral error.
    load_g : (n,) float64
        Load factor less one.
    body_rate_radps : (n, 3) float64
        Body rate at the end of the epoch, FRD.
    earlier_roll_radps2 : (n,) float64
        Roll acceleration, mean of some epochs before: without this epoch's noise.
    earlier_load_g : (n,) float64
        Load factor less one, likewise.
    sensitivity : (n, 9, c) float64
        Jacobian of the rows with respect to the bias parameters, as far as data alone give it.
    aliasing_noise : (n, 2) float64
        Multiple of ``DiscreteModel.aliasing_variance`` in each vertical mean, by edges of the epoch that cut samples.
    root_motion_variance : (n, 3) float64
        Variance of the rigid vertical and lateral force, (m/s^2)^2, and of the roll rate, (rad/s)^2, where the root
        moved faster than its filtered samples resolve; 0 in steady flight.
    root_vibrates : (n,) bool
        Where it moved so again and again: that loads the wing less than a blow does.
    root_covered : (n,) bool
        Epochs in which the root had samples; load factor and body rate of the others are those of the last one.
    """

    start_ns: Ints
    rows: Floats
    present: Bools
    vertical_mps2: Floats
    lateral_mps2: Floats
    slope_rate_gain: Floats
    lateral_gain: Floats
    load_g: Floats
    body_rate_radps: Floats
    earlier_roll_radps2: Floats
    earlier_load_g: Floats
    sensitivity: Floats
    aliasing_noise: Floats
    root_motion_variance: Floats
    root_vibrates: Bools
    root_covered: Bools

    @property
    def length(self) -> int:
        """Number of epochs."""
        return len(self.start_ns)

    def span(self, first: int, last: int) -> Epochs:
        """Epochs ``first:last``, as views."""
        if first == 0 and last == self.length:
            return self
        columns: Any = (column[first:last] for column in self)
        return Epochs(*columns)


class FilterConstants(NamedTuple):
    """Constants of one airframe in the filter.

    Attributes
    ----------
    step_s, trim_m, bend_per_g_m : float
    root_z_variance, root_y_variance : float
        Noise of the root's accelerometer, common to both tips' rows, (m/s^2)^2.
    trim_column, bend_column : int
        Columns of the bias parameters ``trim`` and ``bend_per_g``, 0 where they are certain.
    sensor_variance : (9,) float64
        Variance of each row by the tip's own sensor.
    lateral_bias_state, vertical_bias_state : (2,) int64
        States that hold the tips' accelerometer biases; -1 where there is none.
    roll_misalignment_column : (2,) int64
        Columns of the tips' misalignment about body x, 0 where it is certain.
    bias_projection : (2, 2) float64
        See :class:`companion.core.tracking.states.SensorNoise`.
    common_bias_column : int
        Column of the common part of the vertical biases, 0 where it is not estimated.
    slope_factor_rows, slope_factor_columns : (f,) int64
        Entries of the sensitivity that depend on the state through the slope factors.
    regressor_rows, regressor_columns, regressor_sources : (s,) int64
    regressor_signs : (s,) float64
        Entries of the sensitivity that contain the measurement of the source row, which the prediction replaces: a
        regression on the measurement's own noise would be biased towards zero (errors in variables).
    lever_m : (2,) float64
        Places of the tips along body y from the root.
    foreshortening_pm : (2, r, r) float64
        kappa with the sign of y, 1/m: by lifts w_i and w_j a tip moves to the left by kappa_ij w_i w_j / 2.
    foreshortening_column, further_foreshortening_column : int
        Columns of the relative error of that by the lowest modes alone, and of all that further modes have in it; 0
        where it is not estimated.
    height_column : (2,) int64
        Columns of the tips' heights over their places in the airframe file, 0 where they are certain.
    """

    step_s: float
    trim_m: float
    bend_per_g_m: float
    root_z_variance: float
    root_y_variance: float
    trim_column: int
    bend_column: int
    sensor_variance: Floats
    lateral_bias_state: Ints
    roll_misalignment_column: Ints
    vertical_bias_state: Ints
    bias_projection: Floats
    common_bias_column: int
    slope_factor_rows: Ints
    slope_factor_columns: Ints
    regressor_rows: Ints
    regressor_columns: Ints
    regressor_sources: Ints
    regressor_signs: Floats
    lever_m: Floats
    foreshortening_pm: Floats
    foreshortening_column: int
    further_foreshortening_column: int
    height_column: Ints


class DiscreteModel(NamedTuple):
    """One step of wing and sensors as plain arrays: see :class:`companion.core.tracking.model.DiscreteWingModel`.

    Attributes
    ----------
    transition : (n, n) float64
        ``A``.
    static_input : (n,) float64
        ``b``: input column of the static bend.
    row, col : (t,) int64
    value : (t,) float64
        Non-zero entries of ``A`` (a tenth of it), row after row: ``transition[row, col] = value``.
    transition_index : int
        Slot of ``A`` in the history.
    H : (9, n + 1) float64
        Measurement matrix on the state before the step, static bend last.
    Q : (n, n) float64
        Process noise.
    cross_cov : (9, n) float64
        ``H1 Q``: covariance of the rows' noise with the process noise.
    process_noise_in_rows : (9, 9) float64
        ``H1 Q H1^T``.
    load_noise, load_cross_cov, load_noise_in_rows : (n, n), (9, n), (9, 9) float64
        Parts of the last three by the loads, which a blow inflates.
    linearisation_rows : (6 + 6 r + f, n + 1) float64
        Rows that give, from a state, what the middle of the step has: tip slopes and slope rates (2 each), roll rate,
        roll acceleration; for each of r ranks of modes the tips' lifts, lift rates as it begins and lift accelerations
        (2 each); the regressors of the slope factors (f).
    aliasing_variance : float
        Variance of a vertical mean, on average, by edges that cut samples, (m/s^2)^2.
    moments_beside_gyro : bool
        Whether first moments are used even where the tip has a gyro.
    lift_acceleration_share : (3, r) float64
        Share of each rank of modes in what a tip's mean acceleration, measured as the sum of all ranks, is beyond the
        expected one: where this tip alone is measured; where both are, in this tip's, and in the other's.
    lift_acceleration_covariance : (3, r, r) float64
        Covariance of the ranks' accelerations by the load inside the step where both tips are measured, this one
        alone, or none.
    motion_covariance : (n, n) float64
        Added to the state's where the root is struck: modes and loads are as uncertain as those of an unknown gust.
    """

    transition: Floats
    static_input: Floats
    row: Ints
    col: Ints
    value: Floats
    transition_index: int
    H: Floats
    Q: Floats
    cross_cov: Floats
    process_noise_in_rows: Floats
    load_noise: Floats
    load_cross_cov: Floats
    load_noise_in_rows: Floats
    linearisation_rows: Floats
    aliasing_variance: float
    moments_beside_gyro: bool
    lift_acceleration_share: Floats
    lift_acceleration_covariance: Floats
    motion_covariance: Floats


class FilterState(NamedTuple):
    """State that one step hands to the next: see :class:`companion.core.tracking.filter.SeparatedBiasFilter`.

    Attributes
    ----------
    state_and_sensitivity : (n + 1, 1 + c) float64
        ``[x | V]``, static bend in the last row.
    covariance : (n, n) float64
    information : (1 + c, 1 + c) float64
        Sum of ``[e | D]^T S^-1 [e | D]`` over the steps.
    one_and_bias : (1 + c,) float64
        ``[1; bias parameters]``.
    nis_sums : (2,) float64
        Sums, fading over a second, of the NIS (bounded in steps beyond the gate) and of the number of rows.
    bias_covariance : (c, c) float64
        Of the bias parameters.
    teachable : (t,) int64
        Those bias parameters that a flight may teach: the gate is as wide as they are uncertain.
    """

    state_and_sensitivity: Floats
    covariance: Floats
    information: Floats
    one_and_bias: Floats
    nis_sums: Floats
    bias_covariance: Floats
    teachable: Ints


class History(NamedTuple):
    """Filter quantities that the smoother needs, in rings; slot ``k % size`` is step ``k``.

    Attributes
    ----------
    state : (size, n, 1 + c) float64
        ``[x | V]`` at the start of the step.
    covariance : (size, n, n) float64
    transition : (m, n, n) float64
        The few transitions that the history spans.
    transition_index : (size,) int64
        Which of these each step used.
    row_count : (size,) int64
        How many rows were used; as many rows of the next three are valid.
    whitened_H : (size, 9, n) float64
        ``L^-1 H``.
    whitened_innovation : (size, 9, 1 + c) float64
        ``L^-1 [e | D]``.
    whitened_cross_cov : (size, 9, n) float64
        ``L^-1 C^T``.
    static_m : (size, 1 + c) float64
        Static bend and its sensitivity.
    gate_excess : (size, 9) float64
        Part of each row that teaches nothing: by how much an innovation exceeds the gate, or all of it where most of
        its variance is a shaken root's; else 0.
    innovation : (size, 9) float64
        Innovation of each row at the estimated bias parameters; 0 where the row was not used.
    innovation_covariance : (size, 9, 9) float64
        ``S`` as predicted, before any gate, of the rows that were used: lower half; else 0.
    lateral_gain : (size, 2) float64
        What the left and the right slope row are of a lateral force, s^2/m.
    """

    state: Floats
    covariance: Floats
    transition: Floats
    transition_index: Ints
    row_count: Ints
    whitened_H: Floats
    whitened_innovation: Floats
    whitened_cross_cov: Floats
    static_m: Floats
    gate_excess: Floats
    innovation: Floats
    innovation_covariance: Floats
    lateral_gain: Floats


def make_history(size: int, states: int, parameters: int, rows: int) -> History:
    """Empty rings for ``size`` steps of a filter with so many states, bias parameters and measurement rows."""
    return History(
        state=np.zeros((size, states, 1 + parameters)),
        covariance=np.zeros((size, states, states)),
        transition=np.zeros((_TRANSITIONS, states, states)),
        transition_index=np.zeros(size, np.int64),
        row_count=np.zeros(size, np.int64),
        whitened_H=np.zeros((size, rows, states)),
        whitened_innovation=np.zeros((size, rows, 1 + parameters)),
        whitened_cross_cov=np.zeros((size, rows, states)),
        static_m=np.zeros((size, 1 + parameters)),
        gate_excess=np.zeros((size, rows)),
        innovation=np.zeros((size, rows)),
        innovation_covariance=np.zeros((size, rows, rows)),
        lateral_gain=np.zeros((size, 2)),
    )

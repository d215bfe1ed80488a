"""Noise of the slope and rate rows as it is in this flight, learned from the filter's innovations.

Let ``e`` be the innovations of a step and ``S`` their covariance as predicted. A source of noise k with variance R_k
enters the rows by a column ``d_k`` (a row's own noise: a unit vector; the root's lateral axis: both slope rows). Then
``score_k = d_k^T S^-1 e`` has the variance ``d_k^T S^-1 d_k`` where S is right, and each source j whose variance is
larger by ``excess_j`` adds ``(d_k^T S^-1 d_j)^2 excess_j`` (the score of the likelihood, to first order; Mehra, IEEE
TAC 15, 1970, for the idea). These are as many equations as sources, solved with no variance below the belief. So
noise of one slope row is seen beside a root whose noise both rows share, and a rate's beside the rigid roll.

With the right R, the score is white: beside its variance gamma_0 stands gamma_0 - gamma_1, gamma_1 its autocovariance
at one step, and the smaller of both counts. What contradicts the model slowly (a drifting bias, a wrong scale, a load
larger than believed) makes gamma_1 as large as gamma_0: it is not learned as noise and stays a contradiction.
Vibration above the wing's band makes gamma_1 negative, and its variance is gamma_0. Medians stand for means, for
blows and lies. The vertical rows tell nothing so: what they feel is the gust's, and the fit of its spectrum gives
their noise. A source that is hidden behind others by far is learned where innovations show it beyond what a load that
is fitted a little wrong could.
"""

from __future__ import annotations

import numpy as np

from companion.core.kernels.arrays import plain, row_medians
from companion.core.tracking.nonnegative import nonnegative_least_squares
from companion.core.tracking.states import M_LEFT, P_LEFT, P_ROOT, ROWS, Y_LEFT, SensorNoise
from companion.native.library import ARRAY, kernel
from companion.records import Bools, Floats, Ints

_MIN_STEPS = 60  # chosen: their median square is right to a quarter
_MEDIAN_OF_SQUARE = 0.4549  # derived: of a unit Gaussian's square, the median of chi-square with one degree
_MIN_BEYOND = 0.3  # chosen, of v: a load's fit is as wrong
_CLEARLY_BEYOND = 1.0  # chosen, of v: six sigmas of one look
_MAX_OTHERS = 50.0  # chosen, believed variances: a source behind that much of others shows where it is large
_MEMORY = 0.6  # chosen, of the difference, a second: two fifths of it remain
# chosen, of a variance: where lines are taken out of a stream, its noise falls at once; and of all that hides it: a
# look is right to a tenth of that
_FALLEN = 0.25
_FALLEN_MEMORY = 0.9  # chosen, for such a fall
_MAX_RATIO = 1e4  # chosen: noise up to a hundred times the belief; beyond, the sensor is broken
_VIBRATING_RATIO = 1.5  # chosen: 1.01 at most by sensors as believed, 4 to 40 by broadband vibration (bench world)
_STILL_RATIO = 1.2  # chosen: below the other one, for a sensor between both stays what it is taken for
# chosen, m/s^2 rms an epoch, lateral and vertical: 0.02 to 0.1 and up to 0.15 behind electric motors, their lines taken
# out, 0.1 to 0.4 or 0.25 to 20 behind petrol engines (bench world); the lateral part falls as misalignment takes it up
_STRONG_MPS2 = (0.1, 0.2)
_STRONG_END_RATIO = 0.5  # chosen, of these: as for _STILL_RATIO
_LEARNED = range(Y_LEFT, ROWS)  # rows

_terms = kernel("noise_terms", ARRAY, ARRAY, ARRAY, ARRAY, ARRAY, ARRAY)


class RowNoise:
    """Variance of each source of noise, the believed one and what was learned beyond it.

    Attributes
    ----------
    variance : (9,) float64
        As ``SensorNoise.sensor_variance``: of the lateral rows in (m/s^2)^2.
    root_y_variance : float
        As ``SensorNoise.root_y_variance``.
    root_z_variance : float
        As ``SensorNoise.root_z_variance``.
    vibrating : (bool, bool)
        Whether the left and the right tip show more noise than their sensors have, as vibration does.
    strongly_vibrating : (bool, bool)
        Whether they vibrate so much across that it passes for a misalignment about x, which turns the vertical force.
    """

    def __init__(self, believed: SensorNoise) -> None:
        self.variance: Floats = believed.sensor_variance.copy()
        self.root_y_variance = believed.root_y_variance
        self.root_z_variance = believed.root_z_variance
        self._believed_vertical = believed.sensor_variance[:Y_LEFT].copy(), believed.root_z_variance
        self._columns = _columns()
        self._believed = self._all()
        self.vibrating = self.strongly_vibrating = (False, False)
        self._vibrated: Bools = np.zeros(2, np.bool_)  # as the last look has it
        self._strong: Bools = np.zeros(2, np.bool_)  # so is this
        self._beyond = np.zeros(len(self._believed))  # C_0 - C_1 over v, less one, of the last look

    def _all(self) -> Floats:
        """Variances of the learned sources: rows, then the root's lateral axis."""
        return np.array([*self.variance[Y_LEFT:], self.root_y_variance])

    @property
    def ratio(self) -> Floats:
        """Standard deviation of each learned source over the believed one, (6,)."""
        return np.asarray(np.sqrt(self._all() / self._believed))

    def _compare(self, present: Bools, ratio: Floats) -> None:
        """Compare what a look shows of the tips with their sensors: two at once tell vibration, and two stillness."""
        shown = np.zeros(len(present))
        shown[present] = ratio
        largest = shown[: P_ROOT - Y_LEFT].reshape(2, 2).max(axis=0)
        vibrates = (largest > _VIBRATING_RATIO) | (np.array(self.vibrating) & (largest > _STILL_RATIO))
        steady = (vibrates == self._vibrated) & (largest > 0.0)
        left, right = np.where(steady, vibrates, self.vibrating).tolist()
        self.vibrating, self._vibrated = (left, right), np.where(largest > 0.0, vibrates, self._vibrated)

    def _compare_strength(self) -> None:
        """Compare the tips' noise with what would pass for misalignment about x, by two looks too."""
        lateral_mps2, vertical_mps2 = np.sqrt(self.variance[Y_LEFT:P_LEFT]), np.sqrt(self.variance[:M_LEFT])
        ratio = np.maximum(lateral_mps2 / _STRONG_MPS2[0], vertical_mps2 / _STRONG_MPS2[1])
        strong = (ratio > 1.0) | (np.array(self.strongly_vibrating) & (ratio > _STRONG_END_RATIO))
        left, right = np.where(strong == self._strong, strong, self.strongly_vibrating).tolist()
        self.strongly_vibrating, self._strong = (left, right), strong

    def take_vertical(self, tips: float, root: float) -> None:
        """Take the vertical axes' noise as the spectral fit has it, as ratios of variance to the believed one."""
        believed_tips, believed_root = self._believed_vertical
        self.variance[:Y_LEFT], self.root_z_variance = tips * believed_tips, root * believed_root

    def learn(self, innovation: Floats, covariance: Floats) -> None:
        """Take the innovations of the last second.

        Parameters
        ----------
        innovation : (n, 9) float64
            Innovations, those of slopes as lateral forces, m/s^2; 0 where a row was absent.
        covariance : (n, 9, 9) float64
            Their covariance as predicted, lower half; 0 where a row was absent.
        """
        if len(innovation) < _MIN_STEPS:
            return
        used = np.diagonal(covariance, axis1=1, axis2=2) > 0.0
        rows = used.mean(axis=0) > 0.5
        at = np.all(used == rows, axis=1)
        at[1:] &= at[:-1]  # a pair is named by its second step
        at[:1] = False
        columns = self._columns[rows]
        present = np.any(columns, axis=0)
        if at.sum() < _MIN_STEPS or not present.any():
            return
        terms = noise_terms(innovation, covariance, np.flatnonzero(at), np.flatnonzero(rows), self._columns[:, present])
        if terms is None:
            return
        medians, sources = row_medians(terms), int(present.sum())
        coupling, square, half_change = np.split(medians, [sources**2, sources**2 + sources])
        coupling = coupling.reshape(sources, sources)
        strength = np.diagonal(coupling)
        variance = np.minimum(square, half_change)
        beyond = variance / strength / _MEDIAN_OF_SQUARE - 1.0
        self._take(present, coupling, self._credible(present, beyond, strength))

    def _credible(self, present: Bools, beyond: Floats, strength: Floats) -> Floats:
        """``beyond`` without what may be chance, or may be a small share of what hides the source."""
        before, self._beyond[present] = self._beyond[present], beyond
        steady = np.where((before > _MIN_BEYOND) & (beyond > _MIN_BEYOND), np.minimum(beyond, before), 0.0)
        credible = np.where((beyond > 0.0) & (beyond < _CLEARLY_BEYOND), steady, beyond)
        others = 1.0 / strength - self._all()[present]
        hidden = others > _MAX_OTHERS * self._believed[present]
        return np.where(hidden & (np.minimum(before, beyond) < _CLEARLY_BEYOND), np.minimum(credible, 0.0), credible)

    def _take(self, present: Bools, coupling: Floats, beyond: Floats) -> None:
        """Move each variance towards the solution of the equations of all sources."""
        now, believed = self._all()[present], self._believed[present]
        strength = np.diagonal(coupling)
        equations = coupling**2 / strength[:, None]
        excess = nonnegative_least_squares(equations, np.maximum(beyond + equations @ (now - believed), 0.0))
        learned = self._all()
        target = believed + excess
        self._compare(present, np.sqrt(target / believed))
        fallen = (target < _FALLEN * now) & (1.0 / strength < now / _FALLEN)
        memory = np.where(fallen, _FALLEN_MEMORY, _MEMORY)
        learned[present] = np.clip(now + memory * (target - now), believed, _MAX_RATIO * believed)
        self.variance[Y_LEFT:], self.root_y_variance = learned[:-1], float(learned[-1])
        self._compare_strength()


def slopes_as_forces(innovation: Floats, covariance: Floats, lateral_gain: Floats) -> tuple[Floats, Floats]:
    """Innovations (n, 9) and their covariance (n, 9, 9) with the lateral forces that slopes were taken from, m/s^2.

    ``lateral_gain`` (n, 2) is one over the vertical force, signed for the side. In gusts that forces follow the
    columns of noise in slopes change from step to step, and with constant ones a noisy root would not be seen to be
    still: what is orthogonal to its true columns says that other rows are known well.
    """
    scale = np.ones(innovation.shape)
    np.divide(1.0, lateral_gain, out=scale[:, Y_LEFT:P_LEFT], where=lateral_gain != 0.0)
    return innovation * scale, covariance * scale[:, :, None] * scale[:, None, :]


def noise_terms(innovation: Floats, covariance: Floats, steps: Ints, rows: Ints, columns: Floats) -> Floats | None:
    """Couplings, squared scores and half squared changes of the scores at m steps, (s s + 2 s, m).

    Parameters
    ----------
    innovation : (n, 9) float64
        Innovations.
    covariance : (n, 9, 9) float64
        Their covariance, lower half.
    steps : (m,) int64
        None of them the first of n.
    rows : (r,) int64
        Rows in use at all of these steps.
    columns : (9, s) float64
        ``g`` of each source.

    Returns
    -------
    (s s + 2 s, m) float64 or None
        ``g_k^T S^-1 g_l``, ``u_k^2``, and half the square of ``u_k``'s change since the step before, both by the later
        step's S; None where a covariance is not positive definite.
    """
    sources = columns.shape[1]
    terms = np.empty((sources * sources + 2 * sources, len(steps)))
    innovations = plain(innovation), plain(covariance)
    return terms if _terms(*innovations, steps, rows, plain(columns), terms) else None


def _columns() -> Floats:
    """Columns (9, 6) by which the learned sources enter the rows, slopes as lateral forces: the root's into both."""
    columns = np.zeros((ROWS, len(_LEARNED) + 1))
    for k, row in enumerate(_LEARNED):
        columns[row, k] = 1.0
    columns[Y_LEFT:P_LEFT, -1] = 1.0
    return columns

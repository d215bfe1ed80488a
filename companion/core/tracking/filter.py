"""Kalman filter with separated bias: one fused step per epoch for the state and its sensitivity to the bias parameters.

With ``x1 = A x0 + b q_s + w`` and ``z = H1 x1 + H0 x0 - D c + eps``, put ``H = H1 A + H0``, ``C = A P H^T + Q H1^T``
and ``S = H P H^T + H1 Q H1^T + R``. Then ``e = z - H x0 - H1 b q_s``, ``K = C S^-1``, ``x1 = A x0 + b q_s + K e`` and
``P1 = A P A^T + Q - K C^T``: exact for noise that is in the process and in the measurement alike. Column 0 of
``X = [x | V]`` is the state if all bias parameters were zero, the others are its derivative by each: the same linear
filter, run on ``D`` in the place of ``z`` (Friedland, IEEE TAC 14, 1969). The innovations' information about the
parameters is summed and solved a few times a second. The symbols are those of this folder's README.
"""

from __future__ import annotations

import copy
from collections.abc import Collection
from itertools import compress

import numpy as np

from companion.core.kernels.arrays import Epochs, FilterState, make_history
from companion.core.kernels.filter_loops import filter_epochs
from companion.core.tracking.bias_information import age_information, marginalise, solve_parameters
from companion.core.tracking.kernel_arrays import kernel_constants, kernel_model
from companion.core.tracking.model import DiscreteWingModel, WingParameters, stationary
from companion.core.tracking.row_noise import RowNoise, slopes_as_forces
from companion.core.tracking.sensor_errors import ROOT_ERRORS, SENSOR_ERRORS
from companion.core.tracking.slope_error import slope_factor_variance
from companion.core.tracking.states import ROWS, SensorNoise, StateLayout
from companion.records import Floats, Ints

_SOLVE_EVERY = 25  # chosen, steps: ten solutions a second at 250 Hz
# The root's own errors stay at their priors (Schmidt's consider states): its filtered, unevenly sent samples have noise
# that is not white, and a scale estimated from it is wrong. The biases of its rates are estimated. The tips' stamps are
# considered too: a gust that comes later is as likely, and a Taylor series in the offset would claim microseconds.
_CONSIDERED = frozenset([*(f"root.{error}" for error in SENSOR_ERRORS), "left.tau", "right.tau"])
_SCALES, _MISALIGNMENTS = ("kz", "ky", "kp"), ("mx", "my", "mz")
# by a vibrating tip, whose lateral axis shares its vertical vibration
_TAUGHT_FALSELY = ("shortening", "further_shortening", "trim")
# chosen, relative sigma of a bend per g that is considered as well: a flight's gusts tell it no better, and where the
# load factor hardly changes, its noise would draw the estimate
_CALIBRATED_BEND = 0.05
_WANDERING = tuple(f"root.{error}" for error in ROOT_ERRORS)  # first-order processes, beside the slope factors


class SeparatedBiasFilter:
    """State, covariance and bias parameters; see the module's equations.

    Attributes
    ----------
    state_and_sensitivity : (n + 1, 1 + c) float64
        ``[x | V]``, ``V = dx/dc``; the last row is the static bend over the coming step.
    covariance : (n, n) float64
        Of the state, given the bias parameters.
    bias_parameters : (c,) float64
    steps : int
        Steps done.
    finite : bool
        False once the numbers have run away: only a fresh filter helps.
    """

    def __init__(
        self,
        layout: StateLayout,
        noise: SensorNoise,
        model: DiscreteWingModel,
        trim_m: float,
        bend_per_g_m: float,
        history_length: int,
    ) -> None:
        self.layout, self.noise, self.model = layout, noise, model
        n, c = layout.size, len(layout.bias_parameters)
        self.state_and_sensitivity = np.zeros((n + 1, 1 + c))
        self.state_and_sensitivity[layout.symmetric.q, 0] = trim_m
        self._bend_per_g_m, self._bend_column = bend_per_g_m, layout.column("bend_per_g")
        if (trim_column := layout.column("trim")) is not None:
            self.state_and_sensitivity[layout.symmetric.q, trim_column] = 1.0
        self.covariance = stationary(layout, noise, model)
        self.bias_parameters = np.zeros(c)
        self._bias_covariance = np.diag(layout.bias_parameter_sigma**2)
        self._prior_information = 1.0 / layout.bias_parameter_sigma**2
        self._considered_now: list[str] = []  # as long as tips vibrate or send no lateral axis
        self._set_considered(np.arange(0, dtype=np.int64))
        self._consider(_CONSIDERED)
        if self._bend_is_calibrated():
            self._consider(["bend_per_g"])
        self._consider_scales((False, False), (False, False))
        self._autocorrelation = float(np.exp(-_SOLVE_EVERY * model.step_s / noise.bias_time_s))
        self._one_and_bias = np.concatenate([[1.0], self.bias_parameters])
        self._steps_since_solution = self.steps = 0
        self._by_parameters = 0.0  # of the NIS's sum, by the covariance of those that a flight may teach
        self._teachable = np.setdiff1d(np.arange(c), self._considered)
        self.finite = self._linearises_at_estimate = True
        self._filter_state = self._state_of_loops(np.zeros((1 + c, 1 + c)))
        self.history = make_history(history_length, n, c, ROWS)
        self._constants = kernel_constants(layout, noise, model, trim_m, bend_per_g_m)
        self.switch_model(model)

    def fork(self, model: DiscreteWingModel) -> SeparatedBiasFilter:
        """Copy that goes on with ``model``; its history holds a single step."""
        other = copy.copy(self)
        other.state_and_sensitivity, other.covariance = self.state_and_sensitivity.copy(), self.covariance.copy()
        other.bias_parameters, other._bias_covariance = (self.bias_parameters.copy(), self._bias_covariance.copy())
        other._one_and_bias = self._one_and_bias.copy()
        other._filter_state = other._state_of_loops(self._filter_state.information.copy())
        other._by_parameters = 0.0
        other.history = make_history(1, self.layout.size, len(self.bias_parameters), ROWS)
        other.steps = 0
        if model is not self.model:
            other.switch_model(model)
        else:
            other._discrete_model = self._discrete_model._replace(
                transition_index=other._store_transition(self._discrete_model.transition)
            )
        return other

    def _state_of_loops(self, information: Floats) -> FilterState:
        """Arrays that the compiled loops update, with the information (1 + c, 1 + c) of its steps."""
        state = (self.state_and_sensitivity, self.covariance, information, self._one_and_bias, np.zeros(2))
        return FilterState(*state, self._bias_covariance, self._teachable)

    def _set_considered(self, considered: Ints) -> None:
        """Consider these bias parameters and estimate all others, of which biases of rates and slope factors wander.

        As constants slope factors came out 3 to 4 sigma off: a wing's bend is never that of its named modes alone.
        """
        self._considered = considered
        self._estimated = np.setdiff1d(np.arange(len(self.bias_parameters), dtype=np.int64), considered)
        self._wandering = np.intersect1d(self._columns([*_WANDERING, *self._slopes()]), self._estimated + 1)

    def _consider(self, names: Collection[str]) -> None:
        """Leave bias parameters at their priors from here on, and what is not known of them in the covariance."""
        new = np.array([at for at in self._estimated if self.layout.bias_parameters[at] in names], np.int64)
        self._set_considered(np.union1d(self._considered, new))
        self.bias_parameters[new] = self._bias_covariance[new] = self._bias_covariance[:, new] = 0.0
        self._bias_covariance[new, new] = self.layout.bias_parameter_sigma[new] ** 2

    def _consider_scales(self, vibrating: tuple[bool, bool], strongly: tuple[bool, bool]) -> bool:
        """Consider what vibrating and vertical-only tips cannot tell, estimate what still ones can again; whether any.

        Vibration is coherent from epoch to epoch. A load that follows it, or the noise about a still wing, makes
        predictions and innovations contradict each other by it. Every scale learned so comes out small, slopes' and
        foreshortening's too; and by its product with the bend the latter teaches the trim. A misalignment about x and a
        lateral bias differ by the vertical force alone, with which a strongly vibrating tip's lateral motion goes; what
        is then told of the others is less certain than their priors.
        """
        tips = zip(("left", "right"), vibrating, self.layout.vertical_only_tips, strict=True)
        places = [place for place, vibrates, vertical_only in tips if vibrates or vertical_only]
        names = [f"{place}.{scale}" for place in places for scale in _SCALES]
        names += self._slopes() if places else []
        names += _TAUGHT_FALSELY if any(vibrating) else []
        names += [f"{tip}.{error}" for tip in compress(("left", "right"), strongly) for error in _MISALIGNMENTS]
        names = [name for name in names if name in self.layout.bias_parameters]
        again = [name for name in self._considered_now if name not in names]
        if again:
            self._estimate_again(again)
        self._consider(names)
        self._considered_now = names
        return bool(again)

    def _estimate_again(self, names: list[str]) -> None:
        """Estimate considered bias parameters from here on, and all others anew, which were estimated beside them."""
        others = [self.layout.bias_parameters[at] for at in self._estimated]
        self.reset_bias_parameters([*others, *names])  # in this order: the others hang on the considered ones
        self._set_considered(np.setdiff1d(self._considered, self._columns(names) - 1))

    def _slopes(self) -> list[str]:
        """Names of the slope factors."""
        return [f"slope.{name}" for family in self.layout.families for name in family.names]

    def _columns(self, names: Collection[str]) -> Ints:
        """Columns of those of these bias parameters that there are."""
        return np.array([column for name in names if (column := self.layout.column(name)) is not None], np.int64)

    def _bend_is_calibrated(self) -> bool:
        """Whether the airframe knows the bend per g to a few per cent."""
        column = self._bend_column
        return column is not None and bool(
            self.layout.bias_parameter_sigma[column - 1] < _CALIBRATED_BEND * abs(self._bend_per_g_m)
        )

    def linearise_at(self, bias_parameters: Floats | None) -> None:
        """Linearise the rows, and give the state, at these bias parameters (c,) from here on; None: at the estimate."""
        self._linearises_at_estimate = bias_parameters is None
        self._one_and_bias[1:] = self.bias_parameters if bias_parameters is None else bias_parameters
        self._one_and_bias[self._considered + 1] = 0.0

    def reset_bias_parameters(self, names: Collection[str]) -> None:
        """Return bias parameters to their priors: from here on they are others.

        The state's dependence on the old ones is marginalised: their uncertainty becomes the state's.
        """
        self._solve_bias_parameters()
        for name in names:
            column = self.layout.column(name)
            if column is not None:
                self._marginalise(column, considered=column - 1 in self._considered)
        self._solve_bias_parameters()

    def _marginalise(self, column: int, *, considered: bool) -> None:
        """Integrate one bias parameter out of information, sensitivities and covariance."""
        marginalise(
            self._filter_state.information,
            self.state_and_sensitivity,
            self.covariance,
            column,
            self._prior_information[column - 1],
            considered=considered,
        )

    @property
    def history_length(self) -> int:
        """Number of steps that the history holds at most."""
        return len(self.history.state)

    @property
    def state(self) -> Floats:
        """State at the estimated bias parameters, (n,)."""
        return np.asarray(self.state_and_sensitivity[:-1] @ self._one_and_bias)

    @property
    def one_and_bias(self) -> Floats:
        """``[1; bias parameters]``: what the columns of ``[x | V]`` are summed with, (1 + c,)."""
        return self._one_and_bias

    @property
    def static_m(self) -> float:
        """Static bend over the newest step at the estimated bias parameters, m."""
        return float(self.state_and_sensitivity[-1] @ self._one_and_bias)

    @property
    def bend_per_g_m(self) -> float:
        """Estimated bend per g, m."""
        return self._bend_per_g_m + (
            float(self.bias_parameters[self._bend_column - 1]) if self._bend_column is not None else 0.0
        )

    @property
    def bias_parameter_covariance(self) -> Floats:
        """Covariance of the bias parameters, (c, c): slope factors with what the fit's error adds, up to the prior."""
        covariance = self._bias_covariance.copy()
        room = np.maximum(self.layout.bias_parameter_sigma**2 - covariance.diagonal(), 0.0)
        covariance.flat[:: len(covariance) + 1] += np.minimum(self._slope_variance, room)
        return covariance

    @property
    def total_covariance(self) -> Floats:
        """Covariance of the state with that of the bias parameters as solved, ``P + V P_c V^T``, (n, n)."""
        v = self.state_and_sensitivity[:-1, 1:]
        return np.asarray(self.covariance + v @ self._bias_covariance @ v.T)

    @property
    def dynamic_covariance(self) -> Floats:
        """Total covariance (n, n) with the symmetric deflection measured from the static bend."""
        v = self.state_and_sensitivity[:-1, 1:].copy()
        v[self.layout.symmetric.q] -= self.state_and_sensitivity[-1, 1:]
        return np.asarray(self.covariance + v @ self._bias_covariance @ v.T)

    @property
    def nis(self) -> float:
        """Mean normalised innovation squared of a row over the last second, steps bounded.

        Normalised by all that is not known, bias parameters included: 1 where the model is right (Bar-Shalom, Li,
        Kirubarajan 2001, section 5.4, as a ratio per row).
        """
        square, count = self._filter_state.nis_sums.tolist()
        return square / (count + self._by_parameters) if count > 0.0 else 1.0

    @property
    def nis_of_known_wing(self) -> float:
        """The same as if the bias parameters were known: a blow, too, moves what they may explain."""
        square, count = self._filter_state.nis_sums.tolist()
        return square / count if count > 0.0 else 1.0

    def gate_excess(self, count: int) -> Floats:
        """Part of the newest ``count`` steps' rows that teaches nothing, (count, 9); may be a view."""
        first = (self.steps - count) % self.history_length
        if first + count <= self.history_length:
            return self.history.gate_excess[first : first + count]
        gate_excess: Floats = self.history.gate_excess[np.arange(first, first + count) % self.history_length]
        return gate_excess

    def innovations(self, count: int, *, of_all: bool = False) -> tuple[Floats, Floats]:
        """Innovations (count, 9) of the newest steps and their covariance ``S + D P_c D^T`` (count, 9, 9), lower half.

        Slopes are lateral forces here. P_c is of the bias parameters that a flight may teach, or of all (for noise).
        """
        parameters = np.arange(len(self.bias_parameters)) if of_all else self._teachable
        P_c = self._bias_covariance[np.ix_(parameters, parameters)]
        slots = np.arange(self.steps - count, self.steps) % self.history_length
        covariance = self.history.innovation_covariance[slots]
        present = np.diagonal(covariance, axis1=1, axis2=2) > 0.0
        for used in np.unique(present, axis=0):
            at, rows = np.flatnonzero((present == used).all(axis=1)), np.flatnonzero(used)
            whitened = self.history.whitened_innovation[slots[at], : len(rows)][:, :, parameters + 1]
            D = np.linalg.cholesky(covariance[block := np.ix_(at, rows, rows)]) @ whitened
            covariance[block] += np.tril(D @ P_c @ D.swapaxes(1, 2))
        return slopes_as_forces(self.history.innovation[slots], covariance, self.history.lateral_gain[slots])

    def take_noise(self, noise: RowNoise, *, still: bool = False) -> bool:
        """Go on with other variances of rows and root; whether bias parameters begin anew. ``still``: no mode shows."""
        self._constants = self._constants._replace(
            sensor_variance=noise.variance.copy(),
            root_y_variance=noise.root_y_variance,
            root_z_variance=noise.root_z_variance,
        )
        again = self._consider_scales((True, True) if still else noise.vibrating, noise.strongly_vibrating)
        self._solve_bias_parameters()
        return again

    def run(self, epochs: Epochs) -> None:
        """Filter a run of epochs."""
        first = 0
        while first < epochs.length and self.finite:
            count = min(epochs.length - first, _SOLVE_EVERY - self._steps_since_solution)
            before, span = self._filter_state.information.copy(), (first, first + count, self.steps)
            self.finite = filter_epochs(
                self._constants, self._discrete_model, epochs, self._filter_state, self.history, *span
            )
            if not self.finite:
                return
            at = self._teachable[:, np.newaxis], self._teachable
            gained = np.sum((self._filter_state.information - before)[1:, 1:][at] * self._bias_covariance[at])
            self._by_parameters = (1.0 - self.model.step_s) ** count * self._by_parameters + float(gained)
            self.steps, self._steps_since_solution = self.steps + count, self._steps_since_solution + count
            if self._steps_since_solution >= _SOLVE_EVERY:
                self._solve_bias_parameters()
                self._age_wandering()
            first += count

    def switch_model(self, model: DiscreteWingModel) -> None:
        """Go on with another model of the same wing."""
        if model is not self.model:
            self._preserve_acceleration(model.parameters)
        self.model, self._slope_variance = model, slope_factor_variance(self.layout, model.parameters)
        transition = np.ascontiguousarray(model.transition[:, : self.layout.size])
        self._discrete_model = kernel_model(self.layout, model, transition, self._store_transition(transition))

    def _store_transition(self, transition: Floats) -> int:
        """Put a transition into a slot of the history that no step refers to; its number."""
        stored = self.history.transition
        unused = np.ones(len(stored), dtype=np.bool_)
        unused[self.history.transition_index] = False
        if not unused.any():
            self.history = self.history._replace(transition=np.concatenate([stored, np.empty_like(stored)]))
            return self._store_transition(transition)
        free = int(unused.argmax())
        self.history.transition[free] = transition
        return free

    def _preserve_acceleration(self, parameters: WingParameters) -> None:
        """Shift the loads by the change of spring and damping forces, so that the modal acceleration stays.

        The acceleration, load less spring, is known well, the slow bend hardly. Were the load kept, the difference
        between two stiffnesses would pass for a measurement of the bend.
        """
        n, transform = self.layout.size, np.eye(self.layout.size + 1)
        for family, old, new in zip(self.layout.families, self.model.parameters, parameters, strict=True):
            corner = 2.0 * np.pi * new.cautious().corner_2_hz
            for (q, _), before, after in zip(family.pairs, old.modes, new.modes, strict=True):
                stiffer = 4.0 * np.pi**2 * (after.frequency_hz**2 - before.frequency_hz**2)
                damped = 4.0 * np.pi * (after.frequency_hz * after.damping - before.frequency_hz * before.damping)
                transform[q + 2, q : q + 2] += stiffer, damped + stiffer / corner
                transform[q + 3, q : q + 2] += stiffer, damped
                if q == self.layout.symmetric.q:
                    transform[q + 2 : q + 4, n] -= stiffer
        state_transform = transform[:n, :n]
        self.state_and_sensitivity[:] = transform @ self.state_and_sensitivity
        self.covariance[:] = state_transform @ self.covariance @ state_transform.T
        if self.steps:  # the smoother's adjoint passes through it
            at = (self.steps - 1) % self.history_length
            carried = state_transform @ self.history.transition[self.history.transition_index[at]]
            self.history.transition_index[at] = self._store_transition(carried)
            self.history.whitened_cross_cov[at] = self.history.whitened_cross_cov[at] @ state_transform.T

    def _age_wandering(self) -> None:
        """Age the wandering bias parameters by one solution period."""
        sigma = self.layout.bias_parameter_sigma
        age_information(
            self._filter_state.information,
            self.state_and_sensitivity,
            self.covariance,
            self._wandering,
            sigma,
            self._autocorrelation,
        )

    def _solve_bias_parameters(self) -> None:
        """Estimate the bias parameters from the information of all steps and the prior."""
        self._steps_since_solution = 0
        if not len(self.bias_parameters):
            return
        solve_parameters(
            self._filter_state.information,
            self.layout.bias_parameter_sigma,
            self._estimated,
            self._considered,
            self.bias_parameters,
            self._bias_covariance,
        )
        if self._linearises_at_estimate:
            self._one_and_bias[1:] = self.bias_parameters

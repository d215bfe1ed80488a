"""Wing tracker: inertial batches in, the state of the wing out; causal, smoothed and predicted.

It owns the time grid, the streams and the filter and keeps them in step; the estimation is in the other modules.
"""

from __future__ import annotations

import functools
from collections.abc import Collection

import numpy as np

from companion.core.kernels.arrays import Epochs
from companion.core.tracking.adaptation.adaptation import Adaptation
from companion.core.tracking.adaptation.spectral_fit import EARLY_S
from companion.core.tracking.blow import BlowWatch
from companion.core.tracking.body_rates import BodyRates
from companion.core.tracking.contradiction import NIS_LIMIT, Contradiction
from companion.core.tracking.estimates import (
    bias_parameter_estimates,
    fast_slope_time_s,
    mode_estimate,
    tip_estimate,
    tip_output_matrix,
)
from companion.core.tracking.filter import SeparatedBiasFilter
from companion.core.tracking.first_moments import FirstMoments
from companion.core.tracking.line_following import LineFollowing
from companion.core.tracking.manoeuvre_error import ManoeuvreError
from companion.core.tracking.model import DiscreteWingModel, WingParameters, build_model, slope_rows
from companion.core.tracking.parameters import alike, prior_parameters
from companion.core.tracking.prediction import Forecast, Forecaster, Newest, previewed
from companion.core.tracking.readaptation import NewParameters, fresh_filter, newest_innovations, readapt
from companion.core.tracking.rigid_body import BEFORE, MeasurementBuilder, RareGates, join
from companion.core.tracking.row_noise import RowNoise
from companion.core.tracking.smoother import smooth_between
from companion.core.tracking.spread_work import SPREAD_S, SpreadWork, Stages
from companion.core.tracking.states import make_layout, make_noise
from companion.core.tracking.streams import SampleBuffer
from companion.core.tracking.validity import DISTRUST, ModalActivity, classify_validity
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import Deflection, ImuBatch, ModeState, Reject, Rejected, Station, Validity

_HISTORY_S = 1.25  # chosen: longest lag of the smoother, and what ticks and two stamps of a pair are late
_TURN_S, _TURNS = 0.1, 10  # chosen: lines out of lock turn as the locked ones, and so often until all are searched for
_FALLING = 0.7  # chosen: of the NIS before: new parameters that take away as much have found what was wrong
_TRIAL_S = 1.5  # derived: fits come once a second


class WingTracker:
    """Bending of one aircraft's wing, from any subset of axes of three stations; stamps are host nanoseconds."""

    def __init__(self, airframe: Airframe, settings: Settings) -> None:
        self._airframe, self._settings = airframe, settings
        self._step_ns = round(1e9 / settings.track_rate_hz)
        self._step_s = self._step_ns * 1e-9
        self._streams = tuple(SampleBuffer(airframe.sensor(station), station.name.lower()) for station in Station)
        self._layout = make_layout(airframe)
        self._noise = make_noise(airframe, self._layout, self._step_s)
        self._front_end = MeasurementBuilder(self._layout, self._noise, self._streams)
        root_y_m, left_y_m, right_y_m = (stream.sensor.position_m[1] for stream in self._streams)
        self._levers = left_y_m - root_y_m, right_y_m - root_y_m
        self._keep, self._turn_epochs = int(_HISTORY_S / self._step_s) + 8, int(_TURN_S / self._step_s)
        (symmetric, antisymmetric), gust = self._layout.families, airframe.wing.gust
        self._prior = prior_parameters(symmetric, gust), prior_parameters(antisymmetric, gust)
        self._fresh = functools.partial(fresh_filter, self._layout, self._noise, airframe.wing, self._keep)
        self._forecaster, self._body_rates = Forecaster(self._layout), BodyRates(self._keep, self._step_s)
        self._start_ns: int | None = None
        self._reopened_ns = self._settle_ns = self._next_ns = 0
        self._lines, self._search_due = LineFollowing(self._streams), 0  # epoch of the grid
        self._row_noise, self._rows = RowNoise(self._noise), tip_output_matrix(self._layout, slope_rows(self._layout))
        self._validity, self.contradiction, self._first_moments = Validity.SETTLING, Contradiction(), FirstMoments()
        self._restart()

    def _restart(self) -> None:
        """Start again at the airframe's beliefs."""
        self._adaptation = Adaptation(self._layout, self._noise, self._prior, self._levers, self._step_s)
        self._kalman = self._fresh(self._model(self._adaptation.parameters), self._row_noise)
        self._readaptation: SpreadWork[NewParameters] | None = None  # new parameters on their way
        self._refused = False  # whether the last parameters made the measurements inconsistent
        self._adaptation.set_bias_parameters(self._kalman.bias_parameters, self._kalman.bend_per_g_m)
        self._trial_epochs: list[Epochs] = []  # on which new parameters are tried
        self._trial_filter = self._kalman.fork(self._kalman.model)
        self._activity = ModalActivity(self._layout, adapts=bool(self._settings.adapt))
        self._manoeuvre_error, self._blow, self._rare_gates = ManoeuvreError(), BlowWatch(), RareGates()
        self.contradiction.begin_anew()
        self._body_rates.clear()
        self._start_ns = None if self._start_ns is None else self._next_ns

    def add(self, batch: ImuBatch) -> list[Rejected]:
        """Take inertial samples; refusals with their reasons.

        Raises
        ------
        ValueError
            If the batch's shape is wrong (a defect of the caller).
        """
        if batch.values.shape != (len(batch.t_ns), 6):
            raise ValueError(f"values of an ImuBatch are (n, 6), not {batch.values.shape}")
        return self._streams[batch.station].add(batch, self._next_ns if self._start_ns is not None else -(2**62))

    def lifted_off(self) -> None:
        """Start again without what rolling over bumps has taught; trusted again once the filter has settled."""
        self._row_noise, self._first_moments, learned = RowNoise(self._noise), FirstMoments(), self._activity.learned
        self._restart()
        self._activity.learned = learned

    def clock_restarted(self, stations: Collection[Station]) -> None:
        """Reset the stamp offsets of stations whose clocks, relative to the root's, started again."""
        if self._adaptation.early:
            self._restart()
            return
        self._adaptation.abandon()
        self._readaptation = None
        self._kalman.reset_bias_parameters([f"{station.name.lower()}.tau" for station in stations])
        self._adaptation.set_bias_parameters(self._kalman.bias_parameters, self._kalman.bend_per_g_m)
        self._mark()
        self._reopened_ns = self._next_ns

    def adopt(self, settings: Settings) -> None:
        """Use changed live settings; adaptation that is switched on in flight starts again without a history."""
        before, self._settings, self._activity.adapts = self._settings, settings, bool(settings.adapt)
        if settings.adapt and not before.adapt:
            self._restart()

    def advance(self, now_host_ns: int) -> ModeState | None:
        """Process until ``now`` and describe the wing; None before the first epoch."""
        return None if self.process_until(now_host_ns) is None else self.describe()

    def process_until(self, now_host_ns: int) -> Validity | None:
        """Process all epochs that ended before ``now`` less the reorder window; None before the first."""
        until_ns = now_host_ns - round(self._settings.reorder_window_s * 1e9)
        if self._start_ns is None and not self._begin(until_ns):
            return None
        while (count := min((until_ns - self._next_ns) // self._step_ns, self._until_line_work())) > 0:
            self._process(int(count))
            self._work_on_lines()
        if not self._body_rates:
            return None
        self._validity = self._classify(now_host_ns)
        return self._validity

    def work(self) -> None:
        """Run a stage of what is spread over turns, where there is one: for turns without epochs to process."""
        if self._readaptation is None or not self._readaptation.work():
            self._lines.work()

    def _begin(self, until_ns: int) -> bool:
        """Set the time grid once the root and a tip have sent."""
        root, *heard_tips = (stream.first_ns() for stream in self._streams)
        heard = [first for first in heard_tips if first is not None]
        if root is None or not heard:
            for stream in self._streams:
                stream.forget_waited()
            return False
        self._next_ns = self._start_ns = (max(root, min(heard)) // self._step_ns + 2) * self._step_ns
        self._settle_ns = self._start_ns + round(EARLY_S * 1e9)
        return self._next_ns < until_ns

    def _until_line_work(self) -> int:
        """Number of epochs until loops share their turn, a search for lines begins, or its result is due."""
        often = self._lines.follows or self._settings.adapt  # fits then see late epochs as those that come in time
        steps, every = self._next_ns // self._step_ns, self._turn_epochs * (1 if often else _TURNS)
        due = (steps // every + 1) * every
        return int((min(due, self._search_due) if self._lines.is_searching else due) - steps)

    def _work_on_lines(self) -> None:
        """Share the turn of loops, begin a search for lines, or follow those that it shows, where it is time."""
        steps = self._next_ns // self._step_ns
        if steps % self._turn_epochs == 0:
            self._lines.share_turn()
        if steps % (_TURNS * self._turn_epochs) == 0:
            self._lines.begin(self._next_ns)
            self._search_due = steps + (0 if self._adaptation.early else round(SPREAD_S / self._step_s))
        if self._lines.is_searching and steps >= self._search_due:
            new = self._lines.finish()
            if new and self._next_ns < self._settle_ns:
                self._restart()  # what was filtered with a line in it is filtered no more
            elif new:
                self._adaptation.begin_history()

    def _process(self, count: int) -> None:
        """Filter the next ``count`` epochs and adapt the parameters."""
        epochs = self._front_end.epochs(self._next_ns, self._step_ns, count)
        self._next_ns += count * self._step_ns
        for segment in self._adaptation.split(epochs, fits=bool(self._settings.adapt)):
            self._first_moments.leave_out(segment)
            self._kalman.run(segment)
            passed_s = segment.length * self._step_s
            self.contradiction.update(self._kalman, self._activity.deflection_sigmas, passed_s)
            judged = self._adaptation.fits > 1
            left_out = judged and self._first_moments.contradict(self._kalman, segment.length, passed_s)
            if (left_out and self._adaptation.early) or self.contradiction.too_long or not self._kalman.finite:
                self._restart()
                break
            self._activity.update(self._kalman, segment.length, self._step_s)
            vibration = self._activity.rms_m(), self._activity.recent_rms_m()
            if not self._adaptation.early and self._blow.update(self._kalman.nis_of_known_wing, *vibration, passed_s):
                self._adaptation.begin_history()
            self._body_rates.extend(segment)
            if self._settings.adapt:
                self._trial_epochs.append(segment)
                contradicted = self._refused or self._kalman.nis > NIS_LIMIT
                gate_excess = self._kalman.gate_excess(segment.length)
                clean = self._rare_gates.without(segment, gate_excess, self._step_s, learning=self._adaptation.early)
                clipped = any(stream.clipping.often for stream in self._live_streams)
                fit = self._adaptation.add_epochs(clean, contradicted, self._blow.under_way, clipped)
                if fit.stages is not None:
                    self._begin_readaptation(fit.stages)
                if fit.due and self._readaptation is not None:
                    self._take(self._readaptation.finish())
                idle = self._readaptation is None and not self._adaptation.early
                if idle and self._step_s * sum(each.length for each in self._trial_epochs) > _TRIAL_S:
                    self._row_noise.learn(*newest_innovations(self._kalman, self._step_s))
                    self._take_noise()
                    self._mark()  # there was no fit, for want of samples or for a blow, as which new noise passes
        for stream in self._streams:
            stream.forget(self._next_ns - BEFORE * self._step_ns)

    def _take_noise(self) -> None:
        """Filter by the learned noise from here on."""
        if self._kalman.take_noise(self._row_noise, still=self._activity.still):
            self._reopened_ns, self._manoeuvre_error = self._next_ns, ManoeuvreError()

    def _begin_readaptation(self, fit: Stages[WingParameters]) -> None:
        """Begin to fit parameters, and to try them on all that was measured early on, later since the last fit."""
        trial = newest_innovations(self._kalman, self._step_s), self._model, self._trial, self._trial_epochs
        self._readaptation = SpreadWork(readapt(fit, self._row_noise, *trial))

    def _trial(self, model: DiscreteWingModel, noise: RowNoise) -> SeparatedBiasFilter | None:
        """Filter on which a model is tried; None where it differs too little. Early on it filters the history again."""
        if self._adaptation.refilter:
            return self._fresh(model, noise, self._kalman.bias_parameters)
        if alike(model.parameters, self._kalman.model.parameters):
            return None
        tried = self._trial_filter.fork(model)
        tried.take_noise(noise, still=self._activity.still)
        return tried

    def _take(self, new: NewParameters) -> None:
        """Take new parameters unless they make the measurements inconsistent."""
        self._readaptation, self._row_noise = None, new.row_noise
        self._take_noise()
        model, self._refused = new.model, False
        if new.tried is not None:
            if remaining := self._trial_epochs[new.segments :]:
                new.tried.run(join(remaining))
            self._refused = not new.tried.finite or new.tried.nis > max(NIS_LIMIT, self._kalman.nis)
            if self._adaptation.fits > 1:
                self._refused |= self._first_moments.contradict_trial(new.tried, self._trial_epochs, self._step_s)
            if new.tried.nis < _FALLING * self._kalman.nis:
                self.contradiction.mend()  # a load that has grown is known now, and the state follows
            if self._refused:
                model = self._kalman.model
            elif self._adaptation.refilter:
                self._kalman = new.tried
        if self._activity.note_fit(taken=new.tried is None or not self._refused) and not self._adaptation.refilter:
            self._start_filter(model)
        if model is not self._kalman.model:
            self._kalman.switch_model(model)
        self._adaptation.parameters = model.parameters
        self._adaptation.set_bias_parameters(self._kalman.bias_parameters, self._kalman.bend_per_g_m)
        if not self._adaptation.early:
            self._mark()

    def _start_filter(self, model: DiscreteWingModel) -> None:
        """Forget what was learned under a gust that was only believed: constants would keep its errors for good."""
        self._kalman, self._manoeuvre_error = self._fresh(model, self._row_noise), ManoeuvreError()
        self._start_ns, self._activity.settled_s = int(self._trial_epochs[-1].start_ns[-1]) + self._step_ns, 0.0
        self._body_rates.clear()

    def _mark(self) -> None:
        """Fork the filter on which the next parameters are tried."""
        self._trial_epochs.clear()
        self._trial_filter = self._kalman.fork(self._kalman.model)

    def _model(self, parameters: WingParameters) -> DiscreteWingModel:
        """Discrete model at these parameters."""
        return build_model(self._layout, self._noise, parameters, self._levers, self._step_s)

    @property
    def newest_ns(self) -> int:
        """The newest processed instant."""
        return self._next_ns

    def describe(self) -> ModeState | None:
        """Wing at the newest processed instant; None before the first one."""
        if not self._body_rates:
            return None
        kalman, layout, q = self._kalman, self._layout, [family.q for family in self._layout.families]
        state, covariance, dynamic = kalman.state, kalman.total_covariance, kalman.dynamic_covariance
        rms, static = self._activity.rms_m(), (kalman.static_m, 0.0)
        symmetric, antisymmetric = (
            mode_estimate(family, parameters, state, dynamic, static[k], float(rms[k]))
            for k, (family, parameters) in enumerate(zip(layout.families, self._adaptation.parameters, strict=True))
        )
        heard = tuple(filter(self._alive, Station))
        return ModeState(
            t_host_ns=self._next_ns,
            symmetric=symmetric,
            antisymmetric=antisymmetric,
            validity=self._validity,
            q_m=state[q],
            q_sigma_m=np.sqrt(np.diag(covariance)[q]),
            stations=heard,
            axes=tuple(self._streams[station].axes for station in heard),
        )

    def bias_parameters(self) -> dict[str, tuple[float, float]]:
        """Estimate and sigma of every bias parameter (``states.StateLayout``), as deviations from the airframe's."""
        return bias_parameter_estimates(self._kalman)

    def _alive(self, station: Station) -> bool:
        """Whether a station has sent lately; the root every axis, for nothing else tells load and body rates."""
        newest_ns, missing = self._streams[station].newest_ns, self._streams[station].presence.missing
        recent = newest_ns is not None and self._next_ns - newest_ns <= self._settings.stale_s * 1e9
        return recent and not (station is Station.ROOT and missing)

    @property
    def _live_streams(self) -> list[SampleBuffer]:
        """Streams that count: what a sensor did before it fell silent says nothing of the others."""
        return [s for s in self._streams if not s.is_silent(self._next_ns - round(self._settings.stale_s * 1e9))]

    def _classify(self, now_host_ns: int) -> Validity:
        """Validity at ``now``."""
        stale = not self._alive(Station.ROOT) or not (self._alive(Station.LEFT) or self._alive(Station.RIGHT))
        stale |= now_host_ns - self._next_ns > (self._settings.reorder_window_s + self._settings.stale_s) * 1e9
        if stale:
            self._activity.settled_s = 0.0
        return classify_validity(
            stale=stale,
            saturated=any(stream.is_saturated(self._next_ns) for stream in self._live_streams),
            settled=self._activity.settled and self.contradiction.settled,
            contradicted=self.contradiction.holds,
            rms_m=self._activity.rms_m(),
            calm_rms_m=self._settings.calm_rms_m,
            parameters=self._adaptation.parameters,
            ambiguous=self._adaptation.ambiguous,
        )

    @property
    def distrust(self) -> Reject | None:
        """Reason why nothing that rests on this estimate may be published; None where it may."""
        if not self._body_rates or self.contradiction.lasting:
            return Reject.CONTRADICTED if self.contradiction.lasting else Reject.NOT_SETTLED
        if (unlearned := self._activity.reject) is not None:
            return unlearned
        blinded = any(stream.clipping.blinds for stream in self._live_streams)
        return Reject.SATURATED if blinded else DISTRUST.get(self._validity)

    @property
    def complaints(self) -> list[str]:
        """Sentences for the operator on what is wrong with the sensors or with the airframe's file."""
        wrong = [each for stream in self._streams for each in stream.complaints]
        return wrong if (off := self._activity.file_check.sentence) is None else [*wrong, off]

    @property
    def nis(self) -> float:
        """Mean normalised innovation squared of a row over the last second: 1 where the model is right."""
        return self._kalman.nis

    def forecast(self, horizon_ns: int, step_ns: int, *, previews: bool = False) -> Forecast | Reject:
        """Predict up to a horizon from the newest processed instant, or, with ``previews``, from the newest samples."""
        if not self._body_rates or self._validity in (Validity.SATURATED, Validity.STALE):
            return Reject[self._validity.name] if self._body_rates else Reject.NOT_SETTLED
        newest = Newest(self._kalman, self._next_ns, self._body_rates.newest_radps)
        newest = previewed(newest, self._front_end, self._live_streams if previews else (), self._step_ns)
        return self._forecaster.run(newest, self._next_ns + horizon_ns - newest.t_host_ns, step_ns)

    def smooth(self, t_host_ns: int) -> Deflection | Reject:
        """Wing at a past instant, with all measurements since; causal at the newest. Feeds ``ManoeuvreError`` too."""
        if not self._body_rates or self._start_ns is None:
            return Reject.NOT_SETTLED
        if self._validity is Validity.STALE:
            return Reject.STALE
        oldest_ns = max(self._start_ns, self._reopened_ns, self._next_ns - round(_HISTORY_S * 1e9))
        if not oldest_ns <= t_host_ns <= self._next_ns:
            return Reject.OUT_OF_WINDOW
        step, into_ns = divmod(t_host_ns - self._start_ns, self._step_ns)
        if step == self._kalman.steps:
            step, into_ns = step - 1, self._step_ns
        kalman, fraction = self._kalman, into_ns / self._step_ns
        if (body_rate_radps := self._body_rates.at(int(step) - kalman.steps, fraction)) is None:
            return Reject.STALE
        smoothed = smooth_between(kalman, int(step), fraction)
        bias = kalman.bias_parameters, kalman.bias_parameter_covariance
        estimate = tip_estimate(self._layout, self._rows, smoothed, *bias)
        return Deflection(
            t_host_ns=t_host_ns,
            q_m=estimate.values[:2],
            qdot_mps=estimate.values[2:4],
            slope_rad=estimate.values[4:],
            covariance=estimate.covariance,
            body_rate_radps=body_rate_radps,
            lag_ns=self._next_ns - t_host_ns,
            slow_slope_sigma_rad=estimate.slow_slope_sigma_rad,
            fast_slope_time_s=fast_slope_time_s(kalman, self._rows[4:], int(step)),
            manoeuvre_slope_sigma_rad=self._manoeuvre_error.sigma_rad(t_host_ns, estimate.slope_by_bias, bias[1]),
        )

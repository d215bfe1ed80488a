"""The tracker: inertial batches in, the state of the wing out; causal, ahead and behind.

It owns the time grid, the streams and the filter, and does nothing itself but keep them in step.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection

import numpy as np

from companion.core.tracking.adaptation.adaptation import Adaptation
from companion.core.tracking.estimates import mode_estimate, tip_rows, tips
from companion.core.tracking.filter import Kalman
from companion.core.tracking.model import Parameters, StepModel, build_model, slope_rows
from companion.core.tracking.parameters import COHERENCE, DAMPING_2, FREQUENCY_2, LOAD, LOAD_2, prior_parameters
from companion.core.tracking.prediction import Forecast, Forecaster
from companion.core.tracking.rigid_body import Cells, FrontEnd, join
from companion.core.tracking.smoother import smooth_between
from companion.core.tracking.states import make_layout, make_noise
from companion.core.tracking.streams import Stream
from companion.core.tracking.validity import SURPRISED, Level, judge
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import Deflection, Floats, ImuBatch, ModeState, Reject, Rejected, Station, Validity

_WINDOW_S = 1.0
_MOST_CELLS = 250  # averaged at once
_SATURATED_NS = 200_000_000
_PATIENCE_S = 5.0
_OFTEN = 0.2  # share of cells
_TRIAL_S = 1.5  # fits come once a second
_SMALL = np.array([0.02, 0.5, 0.7, 1.0, 1.0, 0.05, 0.7, 1.0, 0.7])  # of the parameters' logarithms
_IDLE = np.log(1e-6)  # load of a second mode, as a share of the first one's, that nobody would see
_DISTRUST = {
    Validity.STALE: Reject.STALE,
    Validity.SETTLING: Reject.NOT_SETTLED,
    Validity.INCONSISTENT: Reject.CONTRADICTED,
}


class WingTracker:
    """Track the bending of one aircraft's wing.

    Every axis that arrives is used; any of the three stations may fall silent. Stamps are host nanoseconds.
    """

    def __init__(self, airframe: Airframe, settings: Settings) -> None:
        self._airframe, self._settings = airframe, settings
        self._step_ns = round(1e9 / settings.track_rate_hz)
        self._step_s = self._step_ns * 1e-9
        self._streams = tuple(Stream(airframe.sensor(station)) for station in Station)
        self._layout = make_layout(airframe)
        root, left, right = self._streams
        self._noise = make_noise(airframe, self._layout, self._step_s)
        self._front_end = FrontEnd(self._layout, self._noise, (root, left, right))
        wing = airframe.wing
        root_y = airframe.root.position_m[1]
        self._levers = (airframe.left.position_m[1] - root_y, airframe.right.position_m[1] - root_y)
        self._keep = int(_WINDOW_S / self._step_s) + 8
        self._prior = (
            prior_parameters(self._layout.symmetric, wing.gust),
            prior_parameters(self._layout.antisymmetric, wing.gust),
        )
        self._forecaster = Forecaster(self._layout)
        self._rates: deque[Floats] = deque(maxlen=self._keep)  # body rate at the end of each cell
        self._start_ns: int | None = None
        self._reopened_ns = 0
        self._next_ns = 0
        self._rows = tip_rows(self._layout, slope_rows(self._layout))
        self._validity = Validity.SETTLING
        self._restart()

    def _restart(self) -> None:
        """Begin anew, at the airframe's beliefs."""
        self._adaptation = Adaptation(self._layout, self._noise, self._prior, self._levers, self._step_s)
        self._kalman = self._fresh(self._model(self._adaptation.parameters))
        self._refused = False  # whether the last parameters that were found made the measurements a surprise
        self._adaptation.learn(self._kalman.constants, self._kalman.bend_per_g_m)
        self._recent: list[Cells] = []  # on which new parameters are tried
        self._untried = 0  # cells in these
        self._begun = self._kalman.fork(self._kalman.model)
        self._level = Level(self._layout)
        self._surprised_s = 0.0
        self._struck = 0.0  # cells of the last second
        self._rates.clear()
        if self._start_ns is not None:
            self._start_ns = self._next_ns

    # ------------------------------------------------------------------------------------------ in

    def add(self, batch: ImuBatch) -> list[Rejected]:
        """Take inertial samples; say which were refused and why.

        Raises
        ------
        ValueError
            If the batch's shape is wrong (a defect of the caller).
        """
        if batch.values.shape != (len(batch.t_ns), 6):
            raise ValueError(f"values of an ImuBatch are (n, 6), not {batch.values.shape}")
        done_ns = self._next_ns if self._start_ns is not None else -(2**62)
        return self._streams[batch.station].add(batch, done_ns)

    def restarted(self, stations: Collection[Station]) -> None:
        """Know that the clocks of these stations, relative to the root's, began anew: so does their stamps' error."""
        if self._adaptation.early:
            self._restart()
            return
        self._kalman.reopen([f"{station.name.lower()}.tau" for station in stations])
        self._adaptation.learn(self._kalman.constants, self._kalman.bend_per_g_m)
        self._mark()
        self._reopened_ns = self._next_ns

    def adopt(self, settings: Settings) -> None:
        """Use changed live settings from now on; who begins to adapt in flight begins anew, for nothing was kept."""
        begins = bool(settings.adapt and not self._settings.adapt)
        self._settings = settings
        if begins:
            self._restart()

    def advance(self, now_host_ns: int) -> ModeState | None:
        """Go on to ``now``, as :meth:`turn` does, and describe the wing; None until there is a first cell."""
        return None if self.turn(now_host_ns) is None else self.describe()

    def turn(self, now_host_ns: int) -> Validity | None:
        """Process every cell that ended before ``now`` less the reorder window; None until there is a first one."""
        until_ns = now_host_ns - round(self._settings.reorder_window_s * 1e9)
        if self._start_ns is None and not self._begin(until_ns):
            return None
        while (count := min((until_ns - self._next_ns) // self._step_ns, _MOST_CELLS)) > 0:
            self._process(int(count))
        if not self._rates:
            return None
        self._validity = self._judge(now_host_ns)
        return self._validity

    def _begin(self, until_ns: int) -> bool:
        root, *others = (stream.first_ns() for stream in self._streams)
        heard = [first for first in others if first is not None]
        if root is None or not heard:
            return False
        first = max(root, min(heard))
        self._start_ns = (first // self._step_ns + 2) * self._step_ns
        self._next_ns = self._start_ns
        return self._next_ns < until_ns

    def _process(self, count: int) -> None:
        cells = self._front_end.cells(self._next_ns, self._step_ns, count)
        self._next_ns += count * self._step_ns
        for part in self._adaptation.split(cells):
            self._kalman.run(part)
            if self._lost(len(part)):
                self._restart()
                break
            self._level.update(self._kalman, len(part), self._step_s)
            self._rates.extend(part.rate)
            if self._settings.adapt:
                self._recent.append(part)
                self._untried += len(part)
                if self._adaptation.take(self._cleaned(part), self._refused or self._kalman.surprise > SURPRISED):
                    self._readapt()
                elif not self._adaptation.early and self._untried * self._step_s > _TRIAL_S:
                    self._mark()  # without enough samples there was no fit, and the cells must not pile up
        for stream in self._streams:
            stream.forget(self._next_ns - 4 * self._step_ns - 50_000_000)

    def _cleaned(self, cells: Cells) -> Cells:
        """Cells without what lapses and blows added, unless there are so many that this is how the wing moves.

        While the parameters are still being found, they and not the sensors are wrong.
        """
        excess = self._kalman.excess(len(cells))
        struck = int(np.count_nonzero(excess.any(axis=1)))
        self._struck += struck - self._struck * min(1.0, len(cells) * self._step_s)
        rare = self._struck * self._step_s < _OFTEN and not self._adaptation.early
        return cells.without(excess) if struck and rare else cells

    def _lost(self, steps: int) -> bool:
        """Whether the filter has run away, or has contradicted its sensors for too long to find back."""
        surprised = self._kalman.surprise > SURPRISED
        self._surprised_s = self._surprised_s + steps * self._step_s if surprised else 0.0
        return not self._kalman.finite or self._surprised_s > _PATIENCE_S

    def _readapt(self) -> None:
        """Take new parameters, unless they make the measurements a surprise; early on, run the whole history again.

        They are tried on what was measured since the filter stood at ``_begun``: everything in the first seconds,
        later the cells since the last fit.
        """
        model = self._model(self._adaptation.parameters)
        early = self._adaptation.refilter
        if early or not _alike(model.parameters, self._kalman.model.parameters):
            tried = self._fresh(model) if early else self._begun.fork(model)
            tried.run(join(self._recent))
            self._refused = not tried.finite or tried.surprise > max(SURPRISED, self._kalman.surprise)
            if self._refused:
                model = self._kalman.model
                self._adaptation.parameters = model.parameters
            elif early:
                self._kalman = tried
        if model is not self._kalman.model:
            self._kalman.use(model)
        self._adaptation.learn(self._kalman.constants, self._kalman.bend_per_g_m)
        if not self._adaptation.early:
            self._mark()

    def _mark(self) -> None:
        """From here on new parameters are tried."""
        self._recent.clear()
        self._untried = 0
        self._begun = self._kalman.fork(self._kalman.model)

    def _model(self, parameters: Parameters) -> StepModel:
        return build_model(self._layout, self._noise, parameters, self._levers, self._step_s)

    def _fresh(self, model: StepModel) -> Kalman:
        wing = self._airframe.wing
        return Kalman(self._layout, self._noise, model, wing.trim_bend_m.value, wing.bend_per_g_m.value, self._keep)

    # ------------------------------------------------------------------------------------------ out

    @property
    def newest_ns(self) -> int:
        """The newest processed instant."""
        return self._next_ns

    def describe(self) -> ModeState | None:
        """The wing at the newest processed instant; None until there is a first one."""
        if not self._rates:
            return None
        kalman, layout = self._kalman, self._layout
        state, covariance, swing = kalman.state, kalman.total_covariance, kalman.swing_covariance
        rms = self._level.rms_m()
        static = (kalman.static_m, 0.0)
        symmetric, antisymmetric = (
            mode_estimate(family, parameters, state, swing, static[k], float(rms[k]))
            for k, (family, parameters) in enumerate(zip(layout.families, self._adaptation.parameters, strict=True))
        )
        q = [family.q for family in layout.families]
        heard = tuple(station for station in Station if self._alive(station))
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

    def _alive(self, station: Station) -> bool:
        newest = self._streams[station].newest_ns
        return newest is not None and self._next_ns - newest <= self._settings.stale_s * 1e9

    def _judge(self, now_host_ns: int) -> Validity:
        stale = not self._alive(Station.ROOT) or not (self._alive(Station.LEFT) or self._alive(Station.RIGHT))
        stale |= now_host_ns - self._next_ns > (self._settings.reorder_window_s + self._settings.stale_s) * 1e9
        if stale:
            self._level.settled_s = 0.0
        recent = [s.saturated_ns for s in self._streams if s.saturated_ns is not None]
        return judge(
            stale=stale,
            saturated=any(self._next_ns - seen < _SATURATED_NS for seen in recent),
            settled=self._level.settled,
            surprise=self._kalman.surprise,
            rms_m=self._level.rms_m(),
            calm_rms_m=self._settings.calm_rms_m,
            parameters=self._adaptation.parameters,
            ambiguous=self._adaptation.ambiguous,
        )

    @property
    def distrust(self) -> Reject | None:
        """Why nothing should be published that rests on this estimate; None where it may be."""
        return _DISTRUST.get(self._validity) if self._rates and self._level.learned else Reject.NOT_SETTLED

    @property
    def surprise(self) -> float:
        """Mean square of the last second's normalised innovations: one where the model is right."""
        return self._kalman.surprise

    def _refusal(self) -> Reject | None:
        """Why nothing can be said at all."""
        if not self._rates:
            return Reject.NOT_SETTLED
        if self._validity is Validity.SATURATED:
            return Reject.SATURATED
        return Reject.STALE if self._validity is Validity.STALE else None

    def forecast(self, horizon_ns: int, step_ns: int) -> Forecast | Reject:
        """Predict from the newest processed instant, in steps of ``step_ns`` up to ``horizon_ns``."""
        refusal = self._refusal()
        if refusal is not None:
            return refusal
        return self._forecaster.run(self._kalman, self._next_ns, self._rates[-1], horizon_ns, step_ns)

    def smooth(self, t_host_ns: int) -> Deflection | Reject:
        """The wing at a past instant, with all that was measured since; causal at the newest instant."""
        if not self._rates or self._start_ns is None:
            return Reject.NOT_SETTLED
        if self._validity is Validity.STALE:
            return Reject.STALE
        oldest_ns = max(self._start_ns, self._reopened_ns, self._next_ns - round(_WINDOW_S * 1e9))
        if not oldest_ns <= t_host_ns <= self._next_ns:
            return Reject.OUT_OF_WINDOW
        step, into_ns = divmod(t_host_ns - self._start_ns, self._step_ns)
        if step == self._kalman.steps:
            step, into_ns = step - 1, self._step_ns
        kalman, share = self._kalman, into_ns / self._step_ns
        smoothed = smooth_between(kalman, int(step), share)
        found = tips(
            self._layout,
            self._rows,
            smoothed.state,
            smoothed.covariance,
            smoothed.by_constants,
            kalman.constants,
            kalman.constants_covariance,
        )
        return Deflection(
            t_host_ns=t_host_ns,
            q_m=found.values[:2],
            qdot_mps=found.values[2:4],
            slope_rad=found.values[4:],
            covariance=found.covariance,
            body_rate_radps=self._rate_at(int(step), share),
            lag_ns=self._next_ns - t_host_ns,
            slow_slope_sigma_rad=found.slow_slope_sigma_rad,
        )

    def _rate_at(self, step: int, share: float) -> Floats:
        at = step - self._kalman.steps  # -1: the newest cell
        end, before = self._rates[at], self._rates[max(at - 1, -len(self._rates))]
        rate: Floats = before + share * (end - before)
        return rate


def _alike(new: Parameters, old: Parameters) -> bool:
    """Whether a change is too small to be worth a trial."""
    return all(_close(one.logs(), other.logs()) for one, other in zip(new, old, strict=True))


def _close(one: Floats, other: Floats) -> bool:
    close = np.abs(one - other) < _SMALL
    if max(one[LOAD_2] - one[LOAD], other[LOAD_2] - other[LOAD]) < _IDLE:  # what it is makes no difference
        close[[FREQUENCY_2, DAMPING_2, COHERENCE]] = True
    return bool(close.all())

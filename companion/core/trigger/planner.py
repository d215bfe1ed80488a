"""The plan to fire or to skip: the instant, or the tick of the timer, of the next exposure."""

from __future__ import annotations

import enum
import itertools
from dataclasses import dataclass

import numpy as np

from companion.core.tracking.prediction import Forecast
from companion.core.trigger.blur import BlurForecast, BlurModel, GroundMotion
from companion.core.trigger.instants import ModeActivity, PlannedInstant, blur_at_px, deflection_peaks, still_instants
from companion.core.trigger.latency import LatencyModel
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import Firing, Reject, Shot, TriggerPlan, Validity

HORIZON_NS = 250_000_000
"""Reach of a forecast: two intervals of the fastest usual rate, and a half period of a slow wing (choice)."""
STEP_NS = 5_000_000  # a tenth of the period at 20 Hz; minima are refined by a parabola (choice)
MARGIN_NS = 3_000_000
"""Time that a plan needs to reach the trigger process. Nearer to its command a plan is not changed (choice)."""
_SLOW_PIPE_NS = 40_000_000  # time that a plan may need on a busy machine (choice)
EXPIRY_NS = 10_000_000
"""A command later than this is not given: the wing would be moving again (choice)."""
_HARDLY_MORE = 1.03  # ratio of blurs that is not worth a later shot (choice)
_STILL_PX = 0.1  # nor is a blur below this, which matches do not show (choice)
_EARLY_FRACTION = 0.3
"""Share of the interval by which a peak may come before its turn; the average rate is kept (choice)."""
_ANY_SPACING_NS = 50_000_000  # spacing of peaks, if fewer than two are forecast: 10 Hz (choice)
_NOT_YET = -1  # before the first call (convention)
_MS_NS = 1_000_000  # nanoseconds in a millisecond (by definition)


class Policy(enum.IntEnum):
    """The choices of TRG_POLICY."""

    PEAKS = 0
    TIMER = 1
    OFF = 2


class Aim(enum.IntEnum):
    """The choices of TRG_AIM."""

    BLUR = 0
    DEFLECTION = 1


@dataclass(frozen=True, slots=True)
class _Draft:
    """A plan without its number. ``at_peak``: of a peak, fired or skipped; else of the timer."""

    firing: Firing
    exposure_ns: int
    sigma_ns: int
    blur_px: float
    reject: Reject | None
    at_peak: bool
    spacing_ns: int = _ANY_SPACING_NS


class Planner:
    """One open plan, refined until its command is due; then the next.

    The same peak keeps its ``plan_id`` while its time is refined. So the trigger process replaces the plan and cannot
    fire twice. Numbers begin at the host time of the first call in ms, above all numbers of an ended process. Call
    :meth:`plan` every 40 ms with a forecast of :data:`HORIZON_NS` in steps of :data:`STEP_NS`.
    """

    def __init__(self, airframe: Airframe, settings: Settings, latency: LatencyModel) -> None:
        self.settings = settings
        self._latency = latency
        self._blur = BlurModel(airframe)
        modes = (airframe.wing.symmetric, airframe.wing.antisymmetric)
        self._factors_radpm = tuple(mode.slope_factor_radpm.value for mode in modes)
        self._activity = ModeActivity()
        self._next_id = 0
        self._open: TriggerPlan | None = None
        self._draft: _Draft | None = None
        self._due_ns = _NOT_YET
        self._waits_ns = _NOT_YET  # since when the turn waits: skipped peaks put it off no further
        self._last: _Draft | None = None
        self._fired_id = 0
        self._overtaken = False

    def plan(
        self, forecast: Forecast | Reject, validity: Validity, now_host_ns: int, motion: GroundMotion | None = None
    ) -> TriggerPlan | None:
        """Give the plan in force, new or refined.

        Parameters
        ----------
        forecast : Forecast or Reject
            Forecast of the wing tracker, three instants or more; or the reason for none.
        validity : Validity
            Validity of the newest mode state; ``CALM`` means the timer.
        now_host_ns : int
            The tick's time.
        motion : GroundMotion, optional
            Velocity and range; zero and infinite where unknown.

        Returns
        -------
        TriggerPlan or None
            ``SKIP`` plans have their reason in ``reject`` and withdraw an earlier plan of that id. None: the open plan
            stays (triggering is off, it is being fired, or the forecast does not reach far enough).
        """
        if self._due_ns == _NOT_YET:
            self._due_ns = self._waits_ns = now_host_ns + self._interval_ns
            self._next_id = now_host_ns // _MS_NS
        if self._overtaken:
            self._overtaken = False
            return self._withdraw(now_host_ns)
        if self._being_fired(now_host_ns):
            return None
        if self.settings.trigger_policy == Policy.OFF:
            return self._withdraw(now_host_ns)
        draft = self._choose(forecast, validity, now_host_ns, motion or GroundMotion())
        return None if draft is None else self._number(draft, now_host_ns)

    def fired(self, shot: Shot) -> None:
        """Add a shot. A shot of a plan that was replaced too late takes its turn all the same.

        On a busy machine a plan may reach the trigger process after the command of the plan that it replaces. The open
        plan then comes too early, and the next :meth:`plan` withdraws it.
        """
        is_open = self._open is not None and self._open.plan_id == shot.plan_id
        if is_open or shot.plan_id <= self._fired_id:
            return  # its turn is taken, or will be when it is closed
        self._fired_id = shot.plan_id
        self._due_ns = max(self._due_ns, shot.fired_host_ns + self._latency.lead_ns + self._interval_ns)
        self._waits_ns = self._due_ns
        if self._draft is not None:
            self._overtaken = self._due_ns - self._draft.exposure_ns > self._early_ns

    def commands_before(self, t_host_ns: int) -> bool:
        """Whether a command may be given before an instant: that of the open plan, or, without one, of the next."""
        is_due = self._open is None or self._open.command_host_ns < t_host_ns
        return is_due and self.settings.trigger_policy != Policy.OFF

    # ---------------------------------------------------------------------------------------- the open plan

    def _being_fired(self, now_ns: int) -> bool:
        """Close the open plan once its command has passed; True while the command is within :data:`MARGIN_NS`."""
        if self._open is None or self._draft is None:
            return False
        until_ns = self._open.command_host_ns - now_ns
        fires = self._open.firing is not Firing.SKIP
        if until_ns > MARGIN_NS:
            return False
        if fires and until_ns > -MARGIN_NS:
            return True
        if fires:
            self._fired_id = max(self._fired_id, self._open.plan_id)
        if fires or not self._draft.at_peak:
            self._due_ns = max(self._due_ns, self._draft.exposure_ns) + self._interval_ns
            self._waits_ns = self._due_ns
        else:  # a skipped peak costs no turn, but the next peak has its chance before the timer stands in
            self._due_ns = max(self._due_ns, self._draft.exposure_ns + min(self._interval_ns, self._draft.spacing_ns))
        self._last, self._open, self._draft = self._draft, None, None
        return False

    def _withdraw(self, now_ns: int) -> TriggerPlan | None:
        if self._open is None or self._draft is None or self._open.firing is Firing.SKIP:
            return None
        draft = _Draft(Firing.SKIP, self._draft.exposure_ns, 0, self._draft.blur_px, None, self._draft.at_peak)
        return self._number(draft, now_ns)

    def _number(self, draft: _Draft, now_ns: int) -> TriggerPlan:
        if self._open is None or self._draft is None or not _same(self._draft, draft):
            plan_id, self._next_id = self._next_id, self._next_id + 1
        else:
            plan_id = self._open.plan_id
        command_ns = draft.exposure_ns - self._latency.lead_ns
        self._draft = draft
        self._open = TriggerPlan(
            plan_id=plan_id,
            firing=draft.firing,
            command_host_ns=command_ns,
            exposure_host_ns=draft.exposure_ns,
            sigma_ns=draft.sigma_ns,
            blur_px=draft.blur_px,
            expires_host_ns=command_ns + EXPIRY_NS,
            planned_host_ns=now_ns,
            reject=draft.reject,
        )
        return self._open

    # ---------------------------------------------------------------------------------------- what to do next

    @property
    def _interval_ns(self) -> int:
        return round(1e9 / self.settings.trigger_rate_hz)

    @property
    def _early_ns(self) -> int:
        return round(_EARLY_FRACTION * self._interval_ns)

    def _choose(
        self, forecast: Forecast | Reject, validity: Validity, now_ns: int, motion: GroundMotion
    ) -> _Draft | None:
        blur = None if isinstance(forecast, Reject) else self._blur.predict(forecast, self._latency, motion)
        if validity is Validity.CALM:
            return self._tick(Firing.CALM, blur, now_ns)
        if self.settings.trigger_policy == Policy.TIMER:
            return self._tick(Firing.TIMER, blur, now_ns)
        if isinstance(forecast, Reject):
            return self._tick(Firing.SKIP, None, now_ns, forecast)
        assert blur is not None  # there is a forecast
        if validity is not Validity.TRACKING:
            return self._tick(Firing.SKIP, blur, now_ns, _WHY[validity])
        return self._peak(self._instants(forecast, blur, now_ns), blur, now_ns)

    def _tick(self, firing: Firing, blur: BlurForecast | None, now_ns: int, reject: Reject | None = None) -> _Draft:
        """Draft of the timer: expose when due, whatever the wing does. An open tick is not put off."""
        exposure_ns = self._due_from(now_ns)
        held = self._draft
        if held is not None and not held.at_peak and held.exposure_ns >= max(self._earliest(now_ns), self._due_ns):
            exposure_ns = held.exposure_ns
        return _Draft(firing, exposure_ns, 0, blur_at_px(blur, exposure_ns) if blur else 0.0, reject, at_peak=False)

    def _instants(self, forecast: Forecast, blur: BlurForecast, now_ns: int) -> list[PlannedInstant]:
        """Instants at which TRG_AIM aims, in order of time."""
        self._activity.add(forecast)
        if self.settings.trigger_aim == Aim.BLUR:
            return still_instants(blur, now_ns)
        return deflection_peaks(forecast, blur, self._activity.dominating, self._factors_radpm, now_ns)

    def _peak(self, instants: list[PlannedInstant], blur: BlurForecast, now_ns: int) -> _Draft | None:
        """Take the best instant of this turn, or the timer where none comes in it."""
        if self._slips_away(instants, now_ns):
            return None
        due_ns = self._due_from(now_ns)
        give_up_ns = due_ns + self._interval_ns - self._early_ns
        spacing_ns = _spacing(instants)
        turn_ns = max(self._earliest(now_ns), self._due_ns - self._early_ns, self._after_last(spacing_ns))
        end_ns = self._due_ns + self._interval_ns - self._early_ns  # unlike the other, it stands still
        coming = [instant for instant in instants if turn_ns <= instant.t_host_ns <= give_up_ns]
        if coming:
            in_turn = [instant for instant in coming if instant.t_host_ns <= end_ns]
            return self._judge(self._best(in_turn or coming[:1], now_ns), spacing_ns)
        if int(blur.t_host_ns[-1]) < end_ns:
            return None
        return self._stand_in(blur, due_ns)

    def _slips_away(self, instants: list[PlannedInstant], now_ns: int) -> bool:
        """Whether the open plan's peak is so near that no changed plan can reach it."""
        instant = self._held(instants)
        return instant is not None and instant.t_host_ns < self._earliest(now_ns)

    def _held(self, instants: list[PlannedInstant]) -> PlannedInstant | None:
        """Find the peak of the open plan among new ones."""
        if self._draft is None or not self._draft.at_peak:
            return None
        held = self._draft
        nearest = min(instants, key=lambda instant: abs(instant.t_host_ns - held.exposure_ns), default=None)
        if nearest is None or abs(nearest.t_host_ns - held.exposure_ns) >= held.spacing_ns // 2:
            return None
        return nearest

    def _best(self, instants: list[PlannedInstant], now_ns: int) -> PlannedInstant:
        """Instant of least blur among those that may be fired at, or an earlier one of hardly more; of peaks the first.

        A plan to fire is not moved from or to an instant whose command may come before another plan arrives.
        """
        held, near_ns = self._held(instants), self._earliest(now_ns) + _SLOW_PIPE_NS
        if held is not None and self._open is not None and self._open.firing is not Firing.SKIP:
            if held.t_host_ns < near_ns:
                return held
            instants = [instant for instant in instants if instant.t_host_ns >= near_ns]
        allowed = [instant for instant in instants if self._refusal(instant) is None]
        if not allowed or self.settings.trigger_aim == Aim.DEFLECTION:
            return (allowed or instants)[0]
        enough_px = max(_HARDLY_MORE * min(instant.blur_px for instant in allowed), _STILL_PX)
        return next(instant for instant in allowed if instant.blur_px <= enough_px)

    def _refusal(self, instant: PlannedInstant) -> Reject | None:
        if instant.blur_px > self.settings.trigger_blur_px:
            return Reject.BLUR_TOO_LARGE
        is_uncertain = instant.sigma_ns > self.settings.trigger_sigma_s * 1e9
        if self.settings.trigger_aim == Aim.BLUR and is_uncertain:
            # the blur holds it already: it matters where it shows, and as long as a better instant may come
            is_uncertain = instant.blur_px > _STILL_PX and instant.t_host_ns < self._waits_ns + self._interval_ns
        return Reject.PEAK_UNCERTAIN if is_uncertain else None

    def _judge(self, instant: PlannedInstant, spacing_ns: int) -> _Draft:
        reject = self._refusal(instant)
        firing = Firing.SKIP if reject else Firing.PEAK
        return _Draft(firing, instant.t_host_ns, instant.sigma_ns, instant.blur_px, reject, True, spacing_ns)

    def _stand_in(self, blur: BlurForecast, due_ns: int) -> _Draft:
        """Draft of the timer if no peak comes in its turn: where blur is least, skipped if that is too large."""
        window = (blur.t_host_ns >= due_ns) & (blur.t_host_ns <= due_ns + self._early_ns)
        worst = np.where(window, blur.rms_px.max(axis=1), np.inf)
        exposure_ns = int(blur.t_host_ns[np.argmin(worst)]) if window.any() else due_ns
        held = self._draft
        if held is not None and not held.at_peak and held.exposure_ns >= due_ns:
            exposure_ns = held.exposure_ns  # or a late tick would be put off again and again
        blur_px = blur_at_px(blur, exposure_ns)
        poor = blur_px > self.settings.trigger_blur_px
        firing, reject = (Firing.SKIP, Reject.BLUR_TOO_LARGE) if poor else (Firing.TIMER, None)
        return _Draft(firing, exposure_ns, 0, blur_px, reject, at_peak=False)

    def _earliest(self, now_ns: int) -> int:
        """Give the earliest exposure that a new plan can still reach."""
        return now_ns + MARGIN_NS + self._latency.lead_ns

    def _due_from(self, now_ns: int) -> int:
        return max(self._due_ns, self._earliest(now_ns))

    def _after_last(self, spacing_ns: int) -> int:
        """Give the first instant that cannot be the last peak with a new estimate of its time."""
        if self._last is None:
            return 0
        return self._last.exposure_ns + min(max(3 * self._last.sigma_ns, MARGIN_NS), spacing_ns // 2)


_WHY = {
    Validity.SETTLING: Reject.NOT_SETTLED,
    Validity.AMBIGUOUS: Reject.MODE_AMBIGUOUS,
    Validity.INCONSISTENT: Reject.CONTRADICTED,
    Validity.STALE: Reject.STALE,
    Validity.SATURATED: Reject.SATURATED,
}


def _spacing(instants: list[PlannedInstant]) -> int:
    if len(instants) < 2:
        return _ANY_SPACING_NS
    gaps = [later.t_host_ns - earlier.t_host_ns for earlier, later in itertools.pairwise(instants)]
    return sorted(gaps)[len(gaps) // 2]


def _same(held: _Draft, new: _Draft) -> bool:
    """Whether a draft refines the open plan: the same peak, or the same tick."""
    near = abs(held.exposure_ns - new.exposure_ns) < held.spacing_ns // 2
    return held.at_peak == new.at_peak and (near or not new.at_peak)

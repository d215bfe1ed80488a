"""The planner in the pipeline: forecasts from the tracker, latency from the exposures of the cameras."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from companion.core.tracking.tracker import WingTracker
from companion.core.trigger.blur import GroundMotion
from companion.core.trigger.latency import LatencyModel
from companion.core.trigger.planner import HORIZON_NS, STEP_NS, Planner
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import ClockName, MatchSet, OutputRecord, Reject, Shot, Side, Validity

_PLAN_PERIOD_NS = 40_000_000  # the tracker's own period: a plan between has no newer state (derived)
_BLIND_SHOTS, _BLIND_NS = 5, 10_000_000_000  # shots and time without a pair of images that mean a loose line (choice)


@dataclass(slots=True)
class Scheduling:
    """Planner and latency of one airframe; plans at most every ``_PLAN_PERIOD_NS``."""

    planner: Planner
    latency: LatencyModel
    next_plan_ns: int = 0
    unseen: int = 0  # shots since the last pair of images
    unseen_since_ns: int = 0

    @classmethod
    def create(cls, airframe: Airframe, settings: Settings) -> Scheduling:
        """For an airframe that has both cameras."""
        latency = LatencyModel(airframe)
        return cls(Planner(airframe, settings, latency), latency)

    def adopt(self, settings: Settings) -> None:
        """Use changed settings from now on."""
        self.planner.settings = settings

    def tick(
        self, tracker: WingTracker, validity: Validity | None, motion: GroundMotion, now_host_ns: int
    ) -> Iterator[OutputRecord]:
        """Give the plan in force, if one is due to be made."""
        if validity is None or now_host_ns < self.next_plan_ns:
            return
        self.next_plan_ns = now_host_ns + _PLAN_PERIOD_NS
        ahead_ns = now_host_ns - tracker.newest_ns
        nearly_due = self.planner.commands_before(self.next_plan_ns + _PLAN_PERIOD_NS)
        forecast = tracker.forecast(HORIZON_NS + ahead_ns, STEP_NS, previews=nearly_due)
        plan = self.planner.plan(forecast, validity, now_host_ns, motion)
        if plan is not None:
            yield plan

    def fired(self, shot: Shot) -> None:
        """Add a shot."""
        if not self.unseen:
            self.unseen_since_ns = shot.fired_host_ns
        self.unseen += 1
        self.latency.shot(shot)
        self.planner.fired(shot)

    def blind(self, now_host_ns: int) -> bool:
        """Whether shots have brought no pair of images for a while: a loose line, a camera or its process gone."""
        return self.unseen >= _BLIND_SHOTS and now_host_ns - self.unseen_since_ns >= _BLIND_NS

    def exposed(self, matches: MatchSet, stamp_sigma_s: float) -> Reject | None:
        """Learn from measured exposures whose stamps are on the host's clock, with the one-sigma of the worse stamp.

        ``STAMP_OUTLIER`` means a wrong stamp: an exposure is off its camera's usual latency, or its shot cannot have
        caused it. None without a shot.
        """
        self.unseen = 0
        verdict = None
        wrong = {Reject.INCONSISTENT}
        if self.latency.fired(matches.plan_id):
            wrong.add(Reject.UNPAIRED)  # before its command by more than its stamp errs, or half a second after
        for side, clock, t_ns in zip(Side, matches.clocks, matches.mid_exposure_ns, strict=True):
            if clock is not ClockName.HOST:
                continue
            refused = self.latency.exposure(side, matches.plan_id, int(t_ns), stamp_sigma_s)
            if refused in wrong and self.latency.regular(side):
                verdict = Reject.STAMP_OUTLIER
        return verdict

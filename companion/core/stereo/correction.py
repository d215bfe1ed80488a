"""From matches to ranges: the queue of pairs, and the steps that each takes once the smoother has passed it."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Protocol

import numpy as np

from companion.core.stereo.consistency_gate import MatchVerdict, RangeGate, ground_reject, range_slack_mps, withheld
from companion.core.stereo.epipolar_states import YAW
from companion.core.stereo.exposure import CameraExposure, TipMotion, bent_pose, exposures, slope_change_sigma_rad
from companion.core.stereo.extrinsics_drift import ExtrinsicsDriftFilter
from companion.core.stereo.flow import LEAST_FLOW, LONGEST_NS, FlightBetween, FlowView
from companion.core.stereo.geometry import Rig, check_orientation
from companion.core.stereo.lens_residual import LensAxes
from companion.core.stereo.ranging import TIMING_SIGMA_S, PairConditions, correct
from companion.core.stereo.rotation import exp_rotation
from companion.core.stereo.triangulation import Rays, match_rays
from companion.core.stereo.vehicle_motion import TurnTrack, VehicleMotion, VehicleTrack, turn_covariance
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import (
    ClockName,
    CorrectedRange,
    Deflection,
    Floats,
    MatchSet,
    Notice,
    OutputRecord,
    Reject,
    Rejected,
    RelativeRotation,
    Side,
)
from companion.units import Severity

_CONFIRMING_FLOW = 40  # features of a pair whose flow measures its toe well (choice; over fields there are 160)
_AHEAD_NS = 50_000_000  # choice: an exposure stamped so far in the future has a wrong stamp
_QUEUE_DEPTH = 64  # pairs: several seconds at any rate, so that only a stalled smoother fills it (choice)
_LEFT_ASIDE = "the view moves unlike the velocity told (moving surface, wrong velocity?): else calibrate the cameras"
_KNOCKED = "matches contradict the sensors (camera knocked, stamps wrong?): the toe is learnt anew"

# of variances: one of 5,000 good calibrations looks so old (choice; chi-square of four terms)
_WORN_RATIO = 4.0


class BendSource(Protocol):
    """Source of the wing's bend at past instants: the wing tracker."""

    @property
    def distrust(self) -> Reject | None:
        """Reason not to trust the bend now; None without one."""

    def smooth(self, t_host_ns: int) -> Deflection | Reject:
        """The wing at a past instant."""


class _EarlierPair(NamedTuple):
    """The pair before, if its matches agreed: the wing and the left camera's rate at its left exposure."""

    pair_id: int
    left_bend: Deflection
    rate_radps: Floats


class PendingPair(NamedTuple):
    """A matched pair, the reason not to trust its stamps (or None), and the one-sigma of each stamp, s."""

    matches: MatchSet
    stamps: Reject | None
    timing_sigma_s: float

    @property
    def exposed_ns(self) -> int:
        """The later of both exposures."""
        return int(self.matches.mid_exposure_ns.max())


@dataclass(slots=True)
class Correction:
    """Matched pairs that wait until the smoother has passed their exposures."""

    airframe: Airframe
    rig: Rig
    gate: RangeGate
    settings: Settings
    drift_filter: ExtrinsicsDriftFilter
    pending: deque[PendingPair] = field(default_factory=deque)
    vehicle: VehicleTrack = field(default_factory=VehicleTrack)
    turns: TurnTrack = field(default_factory=TurnTrack)
    last_trusted: CorrectedRange | None = None
    _distrusted: bool = False
    _worn_told: bool = False
    _earlier: _EarlierPair | None = None

    @classmethod
    def create(cls, airframe: Airframe, settings: Settings) -> Correction:
        """For an airframe that has both cameras."""
        down = airframe.looks_down
        rig = Rig.from_airframe(airframe)
        check_orientation(rig, airframe)
        return cls(
            airframe, rig, RangeGate(float(down), lasting_surface=down), settings, ExtrinsicsDriftFilter(rig, airframe)
        )

    def add(
        self, matches: MatchSet, stamps: Reject | None = None, timing_sigma_s: float = TIMING_SIGMA_S
    ) -> Iterator[OutputRecord]:
        """Queue a pair, with the reason not to trust its stamps, if any. A full queue refuses its oldest pair."""
        if any(clock is not ClockName.HOST for clock in matches.clocks):
            yield Rejected(Reject.CLOCK_UNSYNCED, "camera frames", matches.matched_host_ns)
            return
        self.pending.append(PendingPair(matches, stamps, timing_sigma_s))
        if len(self.pending) > _QUEUE_DEPTH:
            dropped = self.pending.popleft().matches
            yield Rejected(Reject.QUEUE_FULL, f"pair {dropped.pair_id}", matches.matched_host_ns)

    def due(self, tracker: BendSource, now_host_ns: int) -> Iterator[OutputRecord]:
        """Correct every pair whose exposures lie a full lag behind the newest samples of the tracker."""
        ready_ns = now_host_ns - int((self.settings.smoother_lag_s + self.settings.reorder_window_s) * 1e9)
        while self.pending and not ready_ns < (exposed_ns := self.pending[0].exposed_ns) <= now_host_ns + _AHEAD_NS:
            waiting = self.pending.popleft()
            if exposed_ns > now_host_ns:  # it would hold up all behind it
                yield Rejected(Reject.STAMP_OUTLIER, f"pair {waiting.matches.pair_id}", now_host_ns)
            else:
                yield from self._correct(waiting, tracker, now_host_ns)

    def _correct(self, waiting: PendingPair, tracker: BendSource, now_host_ns: int) -> Iterator[OutputRecord]:
        matches, middle_ns = waiting.matches, int(waiting.matches.mid_exposure_ns.sum()) // 2
        reason = tracker.distrust or waiting.stamps or ground_reject(self.vehicle.on_ground(middle_ns))
        self._doubtful(tracker.distrust)
        left, right = (tracker.smooth(int(t_ns)) for t_ns in matches.mid_exposure_ns)
        if isinstance(left, Reject) or isinstance(right, Reject):
            refused = left if isinstance(left, Reject) else right
            assert isinstance(refused, Reject)
            yield Rejected(refused, f"pair {matches.pair_id}", now_host_ns)
            return
        yield left
        yield right
        motion = self.vehicle.motion(middle_ns)
        turned = self._turned(waiting, (left, right), motion, use_matches=reason is None)
        yield turned
        joint, attitude_rad = self.drift_filter.joint_covariance, self.vehicle.attitude(middle_ns)
        conditions = PairConditions(waiting.timing_sigma_s, motion, turned, joint, attitude_rad)
        answer = correct(matches, left, right, self.rig, self.airframe, self.settings, conditions)
        if self.drift_filter.verdict is not MatchVerdict.AGREE or self.drift_filter.flow_contradicts:
            reason = reason or Reject.MATCHES_CONTRADICT
        lasting_m = self._lasting_m(turned, answer.range.range_m)
        sound = withheld(answer.range, reason)
        judged = self._judged(sound, lasting_m, attitude_rad, toe_confirmed=turned.flow >= _CONFIRMING_FLOW)
        if judged.trusted:
            self.last_trusted = judged
        yield judged
        if self.gate.jumped and self.settings.hold_slow:
            self._reopen()
        if self.drift_filter.verdict is MatchVerdict.KNOCKED:
            self.gate.reopened()
            yield Notice(Severity.WARNING, _KNOCKED, now_host_ns)
        yield from self._worn_lenses(now_host_ns)
        if answer.sectors is not None and reason is None:
            yield answer.sectors

    def _worn_lenses(self, now_host_ns: int) -> Iterator[Notice]:
        """Notice, once, that the lenses are worse than their calibration states, or that the flow contradicts them."""
        ratio = self.drift_filter.lens_ratio
        undecided = self.drift_filter.flow_contradicts and not self.drift_filter.flow_left_aside
        if ratio > _WORN_RATIO and not self._worn_told and not undecided:
            self._worn_told = True
            times = float(np.sqrt(ratio))
            lenses = f"lenses are off by {times:.0f} times their sigma: calibrate the cameras"
            text = _LEFT_ASIDE if self.drift_filter.flow_left_aside else lenses
            yield Notice(Severity.WARNING, text, now_host_ns)

    def _judged(
        self,
        measured: CorrectedRange,
        lasting_m: float,
        attitude_rad: tuple[float, float] | None,
        *,
        toe_confirmed: bool,
    ) -> CorrectedRange:
        """The range after :class:`RangeGate`, which predicts it by attitude and the newest climb rate."""
        newest = self.vehicle.newest
        climb_mps, airspeed_mps = (0.0, 0.0) if newest is None else (newest.climb_mps, newest.airspeed_mps)
        slack_mps = range_slack_mps(self.airframe.looks_down, airspeed_mps, toe_confirmed=toe_confirmed)
        return self.gate.judge(measured, climb_mps, slack_mps, lasting_m, attitude_rad)

    def _lasting_m(self, turned: RelativeRotation, range_m: float) -> float:
        """The part of a range's sigma that neighbouring ranges share, m: the slow toe's."""
        return range_m**2 / self.rig.baseline_m * float(np.sqrt(turned.slow_covariance[YAW, YAW]))

    def _doubtful(self, reason: Reject | None) -> None:
        """Reopen the drift filter after a time of distrust: the tracker may be wrong by more than its sigma then.

        Pairs for which the tracker has no bend count as well, if it is distrusted meanwhile.
        """
        if reason is None and self._distrusted and self.drift_filter.has_matches:
            self._reopen()
        self._distrusted = reason is not None

    def _reopen(self) -> None:
        self.drift_filter.reopen()
        self.gate.reopened()

    def _turned(
        self, waiting: PendingPair, bend: tuple[Deflection, Deflection], motion: VehicleMotion, *, use_matches: bool
    ) -> RelativeRotation:
        """Relative rotation from the matches, or its prediction where bend or stamps are not trusted."""
        moving = exposures(self.rig, TipMotion.from_airframe(self.airframe), *bend, motion.velocity_mps)
        waiting = waiting._replace(matches=waiting.matches.features())
        matches = waiting.matches
        rays = match_rays(self.rig, moving, matches)
        use_matches = use_matches and bool(self.settings.hold_slow)
        flow = self._flow(waiting, rays, moving, bend[Side.LEFT]) if use_matches else None
        turned = self.drift_filter.update(
            matches, rays, bend, moving, waiting.timing_sigma_s, motion, flow=flow, use_matches=use_matches
        )
        agrees = use_matches and self.drift_filter.verdict is MatchVerdict.AGREE
        rate_radps = moving[Side.LEFT].rate_radps
        self._earlier = _EarlierPair(matches.pair_id, bend[Side.LEFT], rate_radps) if agrees else None
        return turned

    def _flow(
        self, waiting: PendingPair, rays: Rays, moving: tuple[CameraExposure, CameraExposure], later: Deflection
    ) -> FlowView | None:
        """Features that the left image of the pair before shows too; None where the flight between is not known."""
        matches, earlier = waiting.matches, self._earlier
        flow = matches.flow
        if flow is None or earlier is None or flow.earlier_pair_id != earlier.pair_id or matches.row_time_ns:
            return None
        index = flow.index
        if len(index) < LEAST_FLOW or np.any((index < 0) | (index >= len(matches.sigma_px))):
            return None
        between = self._flown(earlier.left_bend, later)
        if between is None:
            return None
        rates_radps = np.stack([earlier.rate_radps, moving[Side.LEFT].rate_radps])
        between = replace(between, camera_rates_radps=rates_radps, stamp_sigma_s=waiting.timing_sigma_s)
        lens, tips = self.rig.left.lens, TipMotion.from_airframe(self.airframe)
        return FlowView(
            index,
            rays.at(index),
            self.rig.slope_sigma_rad(Side.RIGHT, matches.right_px[index], matches.sigma_px[index]),
            lens.unproject(flow.earlier_px),
            lens.unproject(matches.left_px[index]),
            self.rig.slope_sigma_rad(Side.LEFT, flow.earlier_px, flow.sigma_px),
            bent_pose(self.rig.left, tips, earlier.left_bend),
            bent_pose(self.rig.left, tips, later),
            between,
            self.drift_filter.body_from_epipolar.T,
            LensAxes.exposed(moving, self.drift_filter.body_from_epipolar.T),
        )

    def _flown(self, earlier: Deflection, later: Deflection) -> FlightBetween | None:
        """Motion of the body between two exposures; None where it is not known, or they lie far apart."""
        from_ns, until_ns = earlier.t_host_ns, later.t_host_ns
        motion = self.vehicle.motion((from_ns + until_ns) // 2)
        turn_rad = self.turns.between(from_ns, until_ns) if 0 < until_ns - from_ns <= LONGEST_NS else None
        if turn_rad is None or not motion.over_ground:
            return None
        passed_s = 1e-9 * (until_ns - from_ns)
        moved_m = exp_rotation(0.5 * turn_rad) @ motion.velocity_mps * passed_s
        bend_turn_rad = self.rig.left.turn_rad(slope_change_sigma_rad(earlier, later, Side.LEFT))
        if not np.isfinite(bend_turn_rad).all():
            return None
        covariance = turn_covariance(turn_rad, passed_s, self.airframe.root) + np.outer(bend_turn_rad, bend_turn_rad)
        return FlightBetween(passed_s, turn_rad, moved_m, motion.covariance, covariance)

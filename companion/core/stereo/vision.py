"""From frames to matches: the work of the vision process. No wing state is needed here."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from companion.core.stereo.filling import filled
from companion.core.stereo.flow_matching import EarlierView, flow_since
from companion.core.stereo.geometry import Rig
from companion.core.stereo.matching import match_pair
from companion.core.stereo.pairing import FramePairer
from companion.core.stereo.search import Search, trim_search
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import Firing, Frame, FramePair, MatchSet, ParameterChange, Reject, Rejected, Side, TriggerPlan

_LATE_FRAMES = 8  # a frame that is so far back in number, and earlier, is late; the camera has not begun anew (choice)
_MAX_PLANS = 32  # largest number of plans kept, more than arrive between two frames (choice)


@dataclass(slots=True)
class FrameChoice:
    """Choice of the pair nearest each planned instant, for cameras that run free.

    A pair is taken if it lies within half the time between two pairs of the planned instant: no other is nearer.
    """

    plans: deque[TriggerPlan] = field(default_factory=lambda: deque(maxlen=_MAX_PLANS))
    last_ns: int | None = None

    def plan(self, plan: TriggerPlan) -> None:
        """Add a planned instant. It replaces earlier plans of its number, and of the same or a later instant."""
        replaced = [earlier for earlier in self.plans if earlier.plan_id == plan.plan_id]
        for earlier in replaced:
            self.plans.remove(earlier)
        while self.plans and self.plans[-1].exposure_host_ns >= plan.exposure_host_ns:
            self.plans.pop()
        if plan.firing is not Firing.SKIP:
            self.plans.append(plan)

    def takes(self, pair: FramePair) -> bool:
        """Whether the pair is the nearest to a planned instant; each plan gets one pair."""
        t_ns = (pair.left.mid_exposure_ns + pair.right.mid_exposure_ns) // 2
        period_ns = 0 if self.last_ns is None else t_ns - self.last_ns
        self.last_ns = t_ns
        while self.plans and self.plans[0].exposure_host_ns < t_ns - period_ns // 2:
            self.plans.popleft()
        if not self.plans or self.plans[0].exposure_host_ns > t_ns + period_ns // 2:
            return False
        self.plans.popleft()
        return True


@dataclass(slots=True)
class VisionState:
    """The pairer and the search of one camera pair, and each camera's newest frame.

    The search covers the motion of the images by trim bend, gusts and load factor, and ranges from the shortest to the
    longest of the settings. It depends on airframe and settings alone, so a recorded pair gives the same matches in
    replay, whatever the estimated wing state. ``choice`` is for cameras without a trigger. ``shown`` is the last pair,
    chosen or not.
    """

    airframe: Airframe
    settings: Settings
    rig: Rig
    search: Search
    pairer: FramePairer = field(default_factory=FramePairer)
    choice: FrameChoice | None = None
    newest: dict[Side, tuple[int, int]] = field(default_factory=dict)  # number and stamp
    earlier: EarlierView | None = None
    shown: FramePair | None = None

    @classmethod
    def create(
        cls, airframe: Airframe, settings: Settings, *, free_running: bool = False, first_pair: int = 0
    ) -> VisionState:
        """Create the state for an airframe with both cameras; ``first_pair`` goes on from an ended process."""
        rig = Rig.from_airframe(airframe)
        pairer, choice = FramePairer(next_id=first_pair), FrameChoice() if free_running else None
        return cls(airframe, settings, rig, trim_search(rig, airframe, settings), pairer, choice)

    def adopt(self, change: ParameterChange) -> None:
        """Use a changed setting from the next pair on."""
        self.settings = self.settings.replace(change.name, change.value)
        self.search = trim_search(self.rig, self.airframe, self.settings)

    def match(self, pair: FramePair, now_host_ns: int) -> MatchSet:
        """Features, their flow since the left image of the last pair, and for a forward pair dense filling."""
        matches = match_pair(pair, self.rig, self.search, now_host_ns)
        if self.earlier is not None:
            matches = replace(matches, flow=flow_since(self.earlier, pair, matches))
        self.earlier = EarlierView(pair.pair_id, pair.left.mid_exposure_ns, pair.left.image)
        if self.settings.fill and self.airframe.looks_forward:
            return filled(matches, pair, self.rig, self.search)
        return matches

    def frozen(self, pair: FramePair, now_host_ns: int) -> list[Rejected]:
        """The refusal of a pair of which either image repeats the last one bit for bit, under a new stamp.

        Noise alone makes two exposures differ. Images of a single grey are equal too, and have no matches anyway.
        """
        last, self.shown = self.shown, pair
        if last is None or not (_is_again(last.left, pair.left) or _is_again(last.right, pair.right)):
            return []
        return [Rejected(Reject.FROZEN, f"pair {pair.pair_id}", now_host_ns)]

    def missing(self, frame: Frame) -> list[Rejected]:
        """Frames missing in one camera's numbering: exposures whose images were lost, or never made."""
        number, at_ns = self.newest.get(frame.side, (frame.sequence - 1, frame.mid_exposure_ns))
        if number - _LATE_FRAMES <= frame.sequence < number and frame.mid_exposure_ns < at_ns:
            return []
        count = frame.sequence - number - 1
        self.newest[frame.side] = frame.sequence, frame.mid_exposure_ns
        if count <= 0:
            return []
        return [Rejected(Reject.FRAME_LOST, f"{frame.side.name.lower()} frames", frame.mid_exposure_ns, count)]


def vision_step(
    state: VisionState, record: Frame | ParameterChange | TriggerPlan, now_host_ns: int
) -> list[MatchSet | Rejected]:
    """Take a frame, a changed setting or a plan. Give the matches of each completed pair, or its refusal."""
    if isinstance(record, ParameterChange):
        state.adopt(record)
        return []
    if isinstance(record, TriggerPlan):
        if state.choice is not None:
            state.choice.plan(record)
        return []
    lost = state.missing(record)
    pairs, lonely = state.pairer.add(record)
    said: list[MatchSet | Rejected] = [*lost]
    for pair in pairs:
        frozen = state.frozen(pair, now_host_ns)
        if state.choice is None or state.choice.takes(pair):
            said += frozen or [state.match(pair, now_host_ns)]
    return [*said, *lonely]


def _is_again(last: Frame, frame: Frame) -> bool:
    """Whether a frame has the last one's image, and that is not of a single grey."""
    return np.array_equal(last.image, frame.image) and int(np.ptp(frame.image)) > 0

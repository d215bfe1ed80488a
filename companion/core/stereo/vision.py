"""Frames in, matches out: what the vision process does with every image. No wing state is needed here."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.core.stereo.geometry import Rig
from companion.core.stereo.matching import Matcher
from companion.core.stereo.pairing import FramePairer
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import ClockName, Frame, FramePair, MatchSet, Rejected


@dataclass(slots=True)
class VisionState:
    """The pairer and the matcher of one camera pair."""

    matcher: Matcher
    pairer: FramePairer = field(default_factory=FramePairer)

    @classmethod
    def create(cls, airframe: Airframe, settings: Settings) -> VisionState:
        """For an airframe that has both cameras."""
        return cls(Matcher(Rig.from_airframe(airframe), airframe, settings))


def vision_step(state: VisionState, frame: Frame) -> list[MatchSet | Rejected]:
    """Take one frame; give the matches of every pair that it completes."""
    pairs, lonely = state.pairer.add(frame)
    return [*(match_pair(state.matcher, pair) for pair in pairs), *lonely]


def match_pair(matcher: Matcher, pair: FramePair, matched_host_ns: int = 0) -> MatchSet:
    """Match one pair in raw pixels. ``matched_host_ns`` is filled in by whoever owns a clock."""
    left_px, right_px, sigma_px = matcher.match(pair.left.image, pair.right.image)
    return MatchSet(
        pair_id=pair.pair_id,
        plan_id=pair.left.plan_id,
        clocks=(ClockName(pair.left.clock), ClockName(pair.right.clock)),
        mid_exposure_ns=np.array([pair.left.mid_exposure_ns, pair.right.mid_exposure_ns], dtype=np.int64),
        exposure_ns=pair.left.exposure_ns,
        row_time_ns=pair.left.row_time_ns,
        left_px=left_px,
        right_px=right_px,
        sigma_px=sigma_px,
        matched_host_ns=matched_host_ns,
    )

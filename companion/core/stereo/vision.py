"""Frames in, matches out: what the vision process does with every image. No wing state is needed here."""

from __future__ import annotations

from dataclasses import dataclass, field

from companion.core.stereo.geometry import Rig
from companion.core.stereo.matching import match_pair
from companion.core.stereo.pairing import FramePairer
from companion.core.stereo.search import Search, trim_search
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import Frame, MatchSet, Rejected


@dataclass(slots=True)
class VisionState:
    """The pairer and the search of one camera pair.

    The search is opened as far as trim bend, gusts and load factor can move the images, so that it depends on the
    airframe alone: a recorded pair gives the same matches in replay, whatever the wing was believed to do.
    """

    rig: Rig
    search: Search
    pairer: FramePairer = field(default_factory=FramePairer)

    @classmethod
    def create(cls, airframe: Airframe, settings: Settings) -> VisionState:
        """For an airframe that has both cameras."""
        rig = Rig.from_airframe(airframe)
        return cls(rig, trim_search(rig, airframe, settings))


def vision_step(state: VisionState, frame: Frame, now_host_ns: int) -> list[MatchSet | Rejected]:
    """Take one frame; give the matches of every pair that it completes, stamped with the time that is given."""
    pairs, lonely = state.pairer.add(frame)
    return [*(match_pair(pair, state.rig, state.search, now_host_ns) for pair in pairs), *lonely]

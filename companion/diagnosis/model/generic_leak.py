"""A channel that leaks into the other, a law that nobody has named."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import Effect, Group, parameter
from companion.records import Station


@dataclass(frozen=True, slots=True)
class GenericLeak(Effect):
    """One side also shows a share of what the other side does."""

    group: ClassVar[Group] = Group.SENSING
    station: ClassVar[Station]

    leaked_ratio: float = parameter("", 0.1, "of the other side's motion")

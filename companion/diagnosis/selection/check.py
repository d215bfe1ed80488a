"""One test of what a model leaves."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Check:
    """One statistic in standard deviations from what the model expects, and the limit beyond which it is no chance."""

    name: str
    z: float
    limit: float

    @property
    def passed(self) -> bool:
        """True if it may be chance."""
        return abs(self.z) < self.limit

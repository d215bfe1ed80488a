"""Outcomes of a diagnosis, and one test of what a model leaves."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class DiagnosisVerdict(enum.StrEnum):
    """Outcomes of a diagnosis."""

    ADEQUATE = "adequate"
    EXPLAINED = "explained"
    UNEXPLAINED = "unexplained"
    NOT_IDENTIFIABLE = "not-identifiable"


@dataclass(frozen=True, slots=True)
class Check:
    """One statistic in standard deviations from what the model expects, and the limit beyond which it is no chance."""

    name: str
    z: float
    limit: float

    @property
    def passed(self) -> bool:
        """True if the statistic lies within its limit."""
        return abs(self.z) < self.limit

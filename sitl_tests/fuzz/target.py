"""Target of the fuzzer, which makes an input from a random generator and runs it."""

from __future__ import annotations

import enum
from collections import Counter
from typing import Protocol

import numpy as np


class Ending(enum.StrEnum):
    """How a case may end; anything else is a finding."""

    DATA = "data"
    REFUSAL = "refusal"


LIMIT_S = 10.0
"""Processor time in which a reader has to end."""


class Violation(AssertionError):
    """A property does not hold though nothing was raised."""


class Target(Protocol):
    """One kind of input.

    Attributes
    ----------
    name : str
    counts : Counter
        What the cases met with beside their endings; for the report alone.
    limit_s : float
        Processor time of one case; more is a finding.
    """

    name: str
    counts: Counter[str]
    limit_s: float

    def warm(self) -> None:
        """Load and compile whatever the first case would otherwise be charged for."""
        ...

    def case(self, rng: np.random.Generator) -> bytes:
        """Make an input; equal generators give equal inputs."""
        ...

    def run(self, data: bytes) -> Ending:
        """Use the input as a user would; raises for a finding."""
        ...

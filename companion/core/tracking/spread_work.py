"""Computation cut into stages, so that none of them holds up a turn of the service."""

from __future__ import annotations

from collections.abc import Generator
from typing import Generic, TypeVar

Result = TypeVar("Result")
Stages = Generator[None, None, Result]
"""Work that pauses after each stage and returns its result."""

SPREAD_S = 0.4  # chosen: forty turns of 10 ms, more than any work here has stages


class SpreadWork(Generic[Result]):
    """Work whose stages are run when there is time; its owner takes the result at a fixed instant of the samples.

    What the stages read must be fixed when the work begins: then the result does not depend on when they run.
    """

    def __init__(self, stages: Stages[Result]) -> None:
        self._stages = stages
        self._results: list[Result] = []

    def work(self) -> bool:
        """Run a stage; whether any was left."""
        if self._results:
            return False
        try:
            next(self._stages)
        except StopIteration as end:
            self._results.append(end.value)
        return True

    def finish(self) -> Result:
        """Run all stages that are left and give the result."""
        while self.work():
            pass
        return self._results[0]

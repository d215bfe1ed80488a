"""Exposure instants that wander about their stamps."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

from companion.core.wing.effect import CameraView, Effect, Group, parameter
from companion.records import Side


@dataclass(frozen=True, slots=True)
class ExposureJitter(Effect):
    """Mid-exposure wanders with standard deviation ``jitter_s``; given as its square, which may come out negative.

    A trigger that wanders moves both cameras ``together`` (1), cameras of their own mind each by itself (0).
    """

    name: ClassVar[str] = "exposure-jitter"
    group: ClassVar[Group] = Group.CAMERA
    adds_toe_variance: ClassVar[bool] = True
    one_way: ClassVar[bool] = True
    own_law: ClassVar[str] = "range residual growing with rates of both cameras"
    advice: ClassVar[str] = "stamp exposures in hardware (a strobe line)"

    jitter2_us2: float = parameter("us^2", 4e6, "square of the standard deviation of the exposure instant")
    together: float = parameter("", 0.4, "share of the square that both cameras have in common", default=0.5)

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        """Wander."""
        del side, t_s
        shared = min(max(self.together, 0.0), 1.0)
        return dataclasses.replace(view, jitter_s=max(self.jitter2_us2, 0.0) ** 0.5 * 1e-6, jitter_shared=shared)

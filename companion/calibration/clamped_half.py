"""Rigid motion and clamped bend of a half wing, told from each other by one fit of all measured points.

A test shows a free wing: its root moves with the mode. Points out on the wing show that motion and the bend of all that
lies inboard of them, so the motion of the innermost points is not that of the root. Here the root's motion is fitted
together with a bend and a twist that are clamped at the centreline:

    ``w = heave - pitch aft + (c_2 y^2 + c_3 y^3) - (t_1 y + t_2 y^2) (aft - middle)``

``y`` is the span station, ``middle`` the line halfway between the two measured edges. An antisymmetric mode has
``roll y`` in place of heave and pitch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.calibration.vibration import Point
from companion.records import Floats

_BEND = np.array([2, 3])  # powers of a clamped bend: as many as an edge's cubic has beside a rigid motion (choice)
_TWIST = np.array([1, 2])  # powers of a twist that is none at the root (choice)


@dataclass(frozen=True, slots=True)
class ClampedHalf:
    """The points' fields, and the linear maps that a least-squares fit is.

    Attributes
    ----------
    rigid : (n, r) float64
        Motion of each point per unit of each rigid coefficient.
    solution : (r + 4, n) float64
        From the points' motion to the coefficients: rigid, bend, twist.
    scale_m : float
        Unit of the span stations.
    """

    rigid: Floats
    solution: Floats
    scale_m: float

    @classmethod
    def of_points(cls, points: list[Point], sign: float) -> ClampedHalf:
        """Fields of the points of both halves, laid upon each other; ``sign`` is +1 symmetric, -1 antisymmetric."""
        span_m = np.array([abs(point.span_m) for point in points])
        aft_m = np.array([point.aft_m for point in points])
        leading, trailing = (edge_line(points, leading=leading) for leading in (True, False))
        middle_m = 0.5 * (np.interp(span_m, *leading) + np.interp(span_m, *trailing))
        scale_m = float(span_m.max())
        y, arm = span_m / scale_m, middle_m - aft_m
        rigid = np.stack([np.ones_like(y), -aft_m] if sign > 0.0 else [y], axis=-1)
        elastic = [y[:, np.newaxis] ** _BEND, y[:, np.newaxis] ** _TWIST * arm[:, np.newaxis]]
        return cls(rigid, np.linalg.pinv(np.column_stack([rigid, *elastic])), scale_m)

    @property
    def bent(self) -> Floats:
        """(n, n) from the points' motion to what of it is no rigid motion of the root."""
        return np.eye(len(self.rigid)) - self.rigid @ self.solution[: self.rigid.shape[1]]

    def factors(self, motion: Floats, place_m: float, reference_m: float) -> Floats:
        """Lift, slope and nose-up twist (3,) at a station per metre of lift at another, by the clamped fit alone."""
        bend, twist = np.split((self.solution @ motion)[self.rigid.shape[1] :], [len(_BEND)])
        place, reference = place_m / self.scale_m, reference_m / self.scale_m
        slope = bend @ (_BEND * place ** (_BEND - 1)) / self.scale_m
        moved = np.array([bend @ place**_BEND, slope, twist @ place**_TWIST])
        return np.asarray(moved / (bend @ reference**_BEND))


def edge_line(points: list[Point], *, leading: bool) -> Floats:
    """(2, k) span stations, ascending, and distance aft of one measured line of points."""
    return np.array(sorted((abs(p.span_m), p.aft_m) for p in points if p.leading is leading)).T

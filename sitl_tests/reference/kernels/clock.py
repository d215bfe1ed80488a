"""Clocks in plain numpy: ``native/clock.c``."""

from __future__ import annotations

import numpy as np

from companion.records import Floats, Ints


def mapped(t_ns: Ints, stamps: Ints, slopes: Floats) -> tuple[Ints, int, int, int]:
    """See :meth:`ClockMap.to_host`."""
    at = np.maximum(np.searchsorted(stamps[:, 0], t_ns, side="right") - 1, 0)
    elapsed = t_ns - stamps[:, 0][at]
    host = stamps[:, 1][at] + elapsed - (slopes[:, 0][at] * elapsed).astype(np.int64)
    low, high, first, last = host[t_ns.argmin()], host[t_ns.argmax()], at.min(), at.max()
    most = max(_bound_at_ns(slopes[first], stamps[first, 1], low), _bound_at_ns(slopes[last], stamps[last, 1], high))
    for k in range(first, last):
        most = max(most, _bound_at_ns(slopes[k], stamps[k, 1], stamps[k + 1, 1]))
    return host, low, high, most


def _bound_at_ns(slope: Floats, from_ns: int, host_ns: int) -> int:
    """See :meth:`Knot.bound_at_ns`."""
    return int(slope[1] + slope[2] * abs(host_ns - from_ns)) + 1


def centre(corners: Floats) -> tuple[float, float, float, float]:
    low, high = corners[0], corners[0]
    for k in range(1, len(corners)):
        offset, skew = corners[k]
        if offset < low[0] or (offset == low[0] and skew < low[1]):
            low = corners[k]
        if offset > high[0] or (offset == high[0] and skew > high[1]):
            high = corners[k]
    skew = 0.5 * (low[1] + high[1])
    half_skew = float(np.max(np.abs(corners[:, 1] - skew)))
    return 0.5 * (low[0] + high[0]), skew, 0.5 * (high[0] - low[0]), half_skew


def cut(corners: Floats, bounds: Floats, sign: float) -> Floats:
    """Cut the polygon by every bound, an upper one with ``sign`` 1, a lower with -1."""
    for k in range(len(bounds)):
        corners = _cut_once(corners, bounds[k, 0], bounds[k, 1], sign)
    return corners


def _cut_once(corners: Floats, at: float, value: float, sign: float) -> Floats:
    """Cut the polygon by one bound (Sutherland and Hodgman 1974)."""
    excess = sign * (corners[:, 0] + corners[:, 1] * at - value)
    inside = excess <= 0.0
    if inside.all():
        return corners
    polygon, count = np.empty((2 * len(corners), 2)), 0
    for i in range(len(corners)):
        if inside[i] != inside[i - 1]:
            fraction = excess[i - 1] / (excess[i - 1] - excess[i])
            polygon[count] = corners[i - 1] + fraction * (corners[i] - corners[i - 1])
            count += 1
        if inside[i]:
            polygon[count] = corners[i]
            count += 1
    return polygon[:count].copy()

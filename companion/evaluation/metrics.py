"""Scores of a flight whose truth is known: relative-toe errors, range errors by distance, trigger errors, blur.

Errors are scored as relative toe, ``e = B (1/Z_measured - 1/Z_true)``, because a metre rms is undefined once a range
passes infinity; metres are given as median and 95th percentile near stated distances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.records import Bools, Floats

FAST_HZ = 0.5  # between the trim bend and a wing's first mode (choice)
SETTLED_S = 15.0  # what is judged begins here: a new shaft may hold up learning until 12 s (choice)
UNANSWERED_S = 0.6  # before a flight's end: pairs whose smoothed state is still to come when it is over (choice)
DISTANCES_M = (20.0, 60.0, 100.0)  # chosen: a landing's end, the paper's far target, and beyond
_NEAR = 0.2  # a shot counts for a distance when its true range lies within this share of it (choice)


@dataclass(frozen=True, slots=True)
class Scored:
    """One way of ranging over all shots of a flight.

    Arrays (n,): exposure instant, true range, and measured inverse range, 1/m, zero or negative beyond infinity.
    """

    baseline_m: float
    t_s: Floats
    z_true_m: Floats
    inverse_m: Floats

    @property
    def toe_error_rad(self) -> Floats:
        """``B (1/Z_measured - 1/Z_true)``, (n,)."""
        return self.baseline_m * (self.inverse_m - 1.0 / self.z_true_m)

    @property
    def range_m(self) -> Floats:
        """Measured range, infinite where the axes no longer meet, (n,)."""
        with np.errstate(divide="ignore"):
            return np.where(self.inverse_m > 0, 1.0 / self.inverse_m, np.inf)

    def fast_toe_error_rad(self) -> Floats:
        """The part of the toe error above :data:`FAST_HZ`, (n,)."""
        return self.toe_error_rad - slow_part(self.t_s, self.toe_error_rad, FAST_HZ)


def is_wrong(range_m: Floats | float, sigma_m: Floats | float, true_m: Floats | float) -> Bools:
    """Whether ranges (n,) are off by more than both 5 sigma and 5 %; not where the true one is NaN."""
    off_m, true = np.abs(np.asarray(range_m) - true_m), np.asarray(true_m)
    wrong: Bools = (off_m > 5.0 * np.asarray(sigma_m)) & (off_m > 0.05 * true)
    return wrong


def rms(values: Sequence[float] | Floats) -> float:
    """Root mean square of values (n,), NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def slow_part(t_s: Floats, values: Floats, cutoff_hz: float) -> Floats:
    """Low-pass of unevenly spaced values (n,): local line fit under a Gaussian kernel, half power at ``cutoff_hz``."""
    # |exp(-(2 pi f s)^2 / 2)|^2 = 1/2 at the cut-off
    width_s = np.sqrt(np.log(2.0)) / (2.0 * np.pi * cutoff_hz)
    lag_s = t_s[None, :] - t_s[:, None]
    weight = np.exp(-0.5 * (lag_s / width_s) ** 2)
    s0, s1, s2 = weight.sum(1), (weight * lag_s).sum(1), (weight * lag_s**2).sum(1)
    b0, b1 = weight @ values, (weight * lag_s) @ values
    determinant = s0 * s2 - s1**2
    flat = determinant < 1e-12 * s0**2
    line = (s2 * b0 - s1 * b1) / np.where(flat, 1.0, determinant)
    result: Floats = np.where(flat, b0 / s0, line)
    return result


def spread(values: Floats, scale: float = 1.0) -> dict[str, float]:
    """Number, rms, and median and 95th percentile of the magnitude of values (n,); empty input gives only ``n``."""
    if not len(values):
        return {"n": 0}
    magnitude = np.abs(values) * scale
    return {
        "n": len(values),
        "rms": rms(magnitude),
        "median": float(np.median(magnitude)),
        "p95": float(np.percentile(magnitude, 95)),
    }


def near(z_true_m: Floats, distance_m: float) -> Bools:
    """Mask (n,) of the shots that count for a distance."""
    mask: Bools = np.abs(z_true_m - distance_m) <= _NEAR * distance_m
    return mask


def toe_summary(scored: Scored) -> dict[str, object]:
    """Relative-toe errors in mrad: all, fast part, and per distance."""
    error = scored.toe_error_rad
    per = {f"{d:g}": spread(error[near(scored.z_true_m, d)], 1e3) for d in DISTANCES_M}
    return {**spread(error, 1e3), "fast": spread(scored.fast_toe_error_rad(), 1e3), "per_distance": per}


def range_summary(scored: Scored) -> dict[str, object]:
    """Range errors in metres per distance; ``beyond`` counts ranges past infinity, which enter as infinite."""
    result: dict[str, object] = {}
    for distance_m in DISTANCES_M:
        mask = near(scored.z_true_m, distance_m)
        error = np.abs(scored.range_m[mask] - scored.z_true_m[mask])
        finite = np.isfinite(error)
        entry: dict[str, float | int | None] = {"n": int(mask.sum()), "beyond": int((~finite).sum())}
        for name, rank in (("median", 50), ("p95", 95)):
            value = float(np.percentile(error, rank, method="lower")) if len(error) else float("nan")
            entry[name] = value if np.isfinite(value) else None
        entry["rms"] = rms(error) if len(error) and finite.all() else None
        result[f"{distance_m:g}"] = entry
    return result

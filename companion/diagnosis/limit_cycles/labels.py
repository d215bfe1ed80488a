"""Recordings whose stated airspeed disagrees with that of their vibration.

The airspeed follows from the amplitude of a limit cycle, or from the growth or decay of a vibration that is still
small.
"""

from __future__ import annotations

from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass

import numpy as np

from companion.diagnosis.limit_cycles.small_damping import NOISY, SMALL, damping_over_airspeed
from companion.diagnosis.limit_cycles.tracks import VibrationTrack
from companion.records import Floats
from companion.units import MAD_TO_SIGMA

_FEWEST = 7  # limit cycles of which one can be judged: with six others three residuals are left (choice)
_FAR = 6.0  # chosen: sigmas of the airspeed by the others, from which a label is wrong
_LEAST = 0.06  # least error relative to the airspeed: less is drift of the rig between days (choice)
_LEAST_ABSOLUTE = 0.5 * np.pi  # variance of a median by that of a mean, of normal errors (derived)
_DEGREE = 2  # of the airspeed over the logarithm of the amplitude (choice)
_REWEIGHTED = 30  # chosen: steps to the least absolute deviation, which have settled by then
_FEWEST_WINDOWS = 3  # of a recording that is judged by its growth (choice)
_FEWEST_GROWING = 3  # recordings, which can judge a fourth (choice)
_RELATED = 2.0  # factor on the variance, because gusts of the tunnel outlast a window (choice)


@dataclass(frozen=True, slots=True)
class LabelDoubt:
    """A recording whose vibration is that of another airspeed than it says.

    ``implied_mps`` is the airspeed by the vibration, ``sigma_mps`` its sigma, ``by`` the property that gave it.
    """

    recording: int
    name: str
    stated_mps: float
    implied_mps: float
    sigma_mps: float
    by: str = "limit cycle"


@dataclass(frozen=True, slots=True)
class _Growth:
    """Windows of a recording while its vibration is small: amplitude by the largest, damping ratio, (w,)."""

    recording: int
    airspeed_mps: float
    amplitude: Floats
    damping: Floats


def doubtful_labels(tracks: Sequence[VibrationTrack]) -> tuple[LabelDoubt, ...]:
    """Recordings whose airspeed is not that of their limit cycle, or of their growth or decay."""
    by_cycle = _doubtful_cycles(tracks)
    aside = {entry.recording for entry in by_cycle}
    return (*by_cycle, *_doubtful_growths(tracks, _growths(tracks, aside)))


def _growths(tracks: Sequence[VibrationTrack], aside: AbstractSet[int]) -> list[_Growth]:
    first = [next(iter(entry.amplitude.values())) for entry in tracks]
    largest = max((float(a.max()) for a in first if len(a)), default=0.0)
    growths = []
    for i, (entry, a) in enumerate(zip(tracks, first, strict=True)):
        small = ~entry.steady & (a < SMALL * largest)
        if i not in aside and entry.airspeed_mps and small.sum() >= _FEWEST_WINDOWS:
            damping = -entry.growth_radps / (2.0 * np.pi * entry.frequency_hz)
            growths.append(_Growth(i, float(entry.airspeed_mps), a[small] / largest, damping[small]))
    return growths


def _doubtful_growths(tracks: Sequence[VibrationTrack], growths: Sequence[_Growth]) -> list[LabelDoubt]:
    """The recording furthest from the fit to the others, then the furthest of the rest."""
    if len(growths) <= _FEWEST_GROWING:
        return []
    doubts = []
    for k, judged in enumerate(growths):
        expected, sigma = _airspeed_by_growth(judged, [*growths[:k], *growths[k + 1 :]])
        off = abs(judged.airspeed_mps - expected)
        if off > max(_FAR * sigma, _LEAST * abs(expected)):
            name, stated = tracks[judged.recording].name, judged.airspeed_mps
            doubts.append((off / sigma, k, LabelDoubt(judged.recording, name, stated, expected, sigma, "growth")))
    if not doubts:
        return []
    _, worst, furthest = max(doubts)
    return [furthest, *_doubtful_growths(tracks, [*growths[:worst], *growths[worst + 1 :]])]


def _airspeed_by_growth(judged: _Growth, others: Sequence[_Growth]) -> tuple[float, float]:
    """Airspeed and sigma where the others have a recording's damping ratio."""
    speeds = np.concatenate([np.full(len(entry.amplitude), entry.airspeed_mps) for entry in others])
    if np.ptp(speeds) == 0.0:
        return judged.airspeed_mps, np.inf
    a, zeta = (np.concatenate([getattr(entry, name) for entry in others]) for name in ("amplitude", "damping"))
    fitted = damping_over_airspeed(speeds, a, zeta)
    square = np.clip(judged.amplitude, *NOISY) ** 2
    measured = float(np.average(judged.damping - fitted.values[2] * judged.amplitude**2, weights=square))
    expected, sigma = fitted.airspeed_mps(measured, fitted.variance / float(square.sum()))
    return expected, float(np.sqrt(_RELATED)) * sigma


def _doubtful_cycles(tracks: Sequence[VibrationTrack]) -> tuple[LabelDoubt, ...]:
    """Limit cycles whose amplitude is another airspeed's as the others have it, robust against other wrong labels."""
    steady = [i for i, entry in enumerate(tracks) if entry.steady.any() and entry.airspeed_mps is not None]
    stated = np.array([float(tracks[i].airspeed_mps or 0.0) for i in steady])
    log_amplitude = np.array([_features(tracks[i]) for i in steady])
    return tuple(
        LabelDoubt(steady[k], tracks[steady[k]].name, float(stated[k]), expected, scatter)
        for k, expected, scatter in _furthest_first(stated, log_amplitude, list(range(len(steady))))
    )


def _furthest_first(stated: Floats, log_amplitude: Floats, rows: list[int]) -> list[tuple[int, float, float]]:
    """The row furthest from the fit to the others, then the furthest of the rest; each with its airspeed and sigma.

    The largest and the smallest amplitude are not judged, because the error of an extrapolation is not known.
    """
    if len(rows) < _FEWEST:
        return []
    doubts = []
    for k in sorted(rows, key=lambda row: float(log_amplitude[row]))[1:-1]:
        others = [row for row in rows if row != k]
        expected, sigma = _airspeed_by_amplitude(log_amplitude[k], log_amplitude[others], stated[others])
        off = abs(stated[k] - expected)
        if off > max(_FAR * sigma, _LEAST * abs(expected)):
            doubts.append((off / max(sigma, 1e-9), k, expected, sigma))
    if not doubts:
        return []
    _, worst, expected, sigma = max(doubts)
    return [(worst, expected, sigma), *_furthest_first(stated, log_amplitude, [row for row in rows if row != worst])]


def _airspeed_by_amplitude(judged: float, log_amplitude: Floats, stated: Floats) -> tuple[float, float]:
    """Airspeed and sigma at an amplitude's logarithm as others (n,) have it.

    The fit passes through as many points as it has coefficients: the scatter is that of the rest.
    """
    design = _design(log_amplitude, log_amplitude)
    coefficients = _least_absolute(design, stated)
    residual = np.sort(np.abs(stated - design @ coefficients))[_DEGREE + 1 :]
    row = _design(np.array([judged]), log_amplitude)[0]
    leverage = float(row @ np.linalg.pinv(design.T @ design) @ row)
    scatter = MAD_TO_SIGMA * float(np.median(residual))
    return float(row @ coefficients), scatter * float(np.sqrt(1.0 + _LEAST_ABSOLUTE * leverage))


def _features(entry: VibrationTrack) -> float:
    first = next(iter(entry.amplitude.values()))
    return float(np.log(first[entry.steady].mean()))


def _design(values: Floats, about: Floats) -> Floats:
    return np.asarray(np.vander((values - about.mean()) / (float(about.std()) or 1.0), _DEGREE + 1))


def _least_absolute(design: Floats, values: Floats) -> Floats:
    weight = np.ones(len(values))
    for _ in range(_REWEIGHTED):
        root = np.sqrt(weight)
        coefficients = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
        least = 1e-3 * (float(np.median(np.abs(values))) or 1.0)  # in still air all are 0
        weight = 1.0 / np.maximum(np.abs(values - design @ coefficients), least)
    return np.asarray(coefficients)

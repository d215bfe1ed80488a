"""A drift of the first modes: the rate at which all frequencies of a stretch grow.

A stretch long enough to tell the gust's colour is too long for a wing whose frequency drifts: the peak is smeared, and
what is fitted is the frequency of its middle. Where the logarithm of the frequency grows by ``r`` each second, the
vibration is steady in a time that runs as ``exp(r t)``. The stretch is put on that time, and of the rates the likeliest
is taken; by as much as it is likely that the wing drifts at all.
"""

from __future__ import annotations

import numpy as np

from companion.core.tracking.adaptation.periodogram import Stretch
from companion.core.tracking.adaptation.whittle import Prior, slopes
from companion.core.tracking.parameters import DAMPING, FREQUENCY, FREQUENCY_2, PARAMETERS
from companion.records import Floats

_SIGMA_PER_S = 0.01  # of a wing that drifts
_DOUBT = 2.0  # against it: most wings do not drift, and one looks every second
_FASTEST_PER_S = 0.03
_STEP_PER_S = 0.01
_LEAST_PER_S = 2e-4  # moves nothing
_NO_GROWTH = 1e-6
_TAPS = 16
_FRACTIONS = 512
_BETA = 8.0


def evened(samples: Floats, rate_per_s: float, step_s: float) -> Floats:
    """Samples (n,) on the time in which what grows by the rate is steady; as long, and as many, as before."""
    if abs(rate_per_s) < _LEAST_PER_S:
        return samples
    count = len(samples)
    total = rate_per_s * count * step_s
    share = (np.arange(count) + 0.5) / count  # of the whole in evened time
    place = count * np.log1p(share * np.expm1(total)) / total - 0.5
    before = np.floor(place)
    fraction = np.rint((place - before) * _FRACTIONS).astype(np.int64)
    first = np.clip(before.astype(np.int64) - (_TAPS // 2 - 1), 0, count - _TAPS)
    beside = np.lib.stride_tricks.sliding_window_view(samples, _TAPS)[first]
    return np.asarray(np.einsum("nk,nk->n", beside, np.take(_WEIGHTS, fraction, axis=0)))


def at_end(logs: Floats, rate_per_s: float, length_s: float) -> Floats:
    """Parameters (p,) at the end of a stretch from those that it has when evened."""
    return logs + _growth(rate_per_s, length_s) * growing(len(logs))


def when_evened(logs: Floats, rate_per_s: float, length_s: float) -> Floats:
    """The way back of :func:`at_end`."""
    return logs - _growth(rate_per_s, length_s) * growing(len(logs))


def _growth(rate_per_s: float, length_s: float) -> float:
    total = rate_per_s * length_s
    return float(np.log(total / -np.expm1(-total))) if abs(total) > _NO_GROWTH else 0.5 * total


def growing(size: int) -> Floats:
    """One for each frequency among ``size`` parameters."""
    grows = np.zeros(size)
    grows[FREQUENCY::PARAMETERS], grows[FREQUENCY_2::PARAMETERS] = 1.0, 1.0
    return grows


def likeliest(
    pieces: list[Stretch], apart_s: float, prior: Prior, logs: Floats, rate_per_s: float
) -> tuple[float, float]:
    """One scoring step from a rate to the likeliest, drawn to none by as much as there may be no drift.

    Parameters
    ----------
    pieces : list of Stretch
        Short stretches, one after the other; short, so that their own smear is small.
    apart_s : float
        From one piece to the next.
    prior : Prior
        Of the parameters.
    logs : (p,) float64
        Parameters in the middle of all pieces; each family's frequencies grow at the rate.
    rate_per_s : float
        Where the step begins.

    Returns
    -------
    float, float
        The rate, and its sigma: that there may be no drift is part of it. None of either where a mode rings on for
        longer than a piece: it is a line there, whose few bins hang together and pass for many witnesses of a drift.
        A line that does drift is smeared over the whole stretch, and is fitted with the damping to be looked at.
    """
    if _rings_on(logs, apart_s):
        return 0.0, 0.0
    size = len(logs)
    silent = prior._replace(sigma=np.full(size, np.inf))
    gradient, information = np.zeros(size + 1), np.zeros((size + 1, size + 1))
    into = np.eye(size + 1)[:, :size]  # how a piece's parameters hang on those of the middle and the rate
    for number, piece in enumerate(pieces):
        into[size] = (number - 0.5 * (len(pieces) - 1)) * apart_s * growing(size)
        slope, known = slopes(piece, silent, logs + rate_per_s * into[size])
        gradient += into @ slope
        information += into @ known @ into.T
    gradient += np.append((logs - prior.mean) / prior.sigma**2, rate_per_s / _SIGMA_PER_S**2)
    information += np.diag(np.append(prior.sigma, _SIGMA_PER_S) ** -2.0)
    step = np.linalg.solve(information, -gradient)[size]
    sigma = np.sqrt(np.linalg.inv(information)[size, size])
    found = rate_per_s + float(np.clip(step, -_STEP_PER_S, _STEP_PER_S))
    evidence = 0.5 * (found / sigma) ** 2 + np.log(sigma / _SIGMA_PER_S) - _DOUBT
    believed = 1.0 / (1.0 + np.exp(-evidence))
    spread = np.sqrt(believed * (sigma**2 + (1.0 - believed) * found**2))
    return float(np.clip(believed * found, -_FASTEST_PER_S, _FASTEST_PER_S)), float(spread)


def _rings_on(logs: Floats, length_s: float) -> bool:
    """Whether a first mode decays by less than ``e`` in this time."""
    rate_hz = np.exp(logs[FREQUENCY::PARAMETERS] + logs[DAMPING::PARAMETERS])
    return bool(np.min(2.0 * np.pi * rate_hz) * length_s < 1.0)


def _windowed_sinc() -> Floats:
    """Weights of the taps for every fraction of a step, (fractions + 1, taps)."""
    away = np.arange(_FRACTIONS + 1)[:, None] / _FRACTIONS - (np.arange(_TAPS) - (_TAPS // 2 - 1))
    inside = np.sqrt(np.clip(1.0 - (away / (_TAPS / 2)) ** 2, 0.0, None))
    weights = np.sinc(away) * np.i0(_BETA * inside)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


_WEIGHTS = _windowed_sinc()

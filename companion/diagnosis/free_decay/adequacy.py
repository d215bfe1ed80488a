"""Tests of the innovations: white, of the expected size, steady; each statistic against draws of the model.

Under the model the innovations over their own standard deviation are independent and standard normal. The spread of any
statistic, and its false-alarm rate, are therefore those of such draws at the same samples. Only samples between
impulses are judged, because the shape of an impulse is not modelled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from companion.diagnosis.free_decay.likelihood import FreeDecayFit, filter_all
from companion.diagnosis.selection.check import Check
from companion.records import Bools, Floats

LIMIT = 5.5  # sigmas: one in 10^7, for the many checks of a page (choice)
LAGS = 20  # samples, a few cycles at the rate of a free decay (choice)
_DRAWS = 300  # of white noise: the spread of a statistic is then known to 4 % (choice)
_BLOCKS = 12  # of a recording, for a change of its noise (choice)
_QUIET = 4.0  # times the 10th percentile of the innovations' variance, up to which no impulse is near (choice)
_NAMES = ("innovations' size", "innovations' neighbours", "outliers", "unsteadiness")


@dataclass(frozen=True, slots=True)
class Whitened:
    """Innovations over their standard deviation (n,), and which of them lie between impulses."""

    values: Floats
    quiet: Bools


def whitened(fitted: FreeDecayFit) -> list[Whitened]:
    """Innovations over their standard deviation, by recording."""
    rows = [fitted.values[None, :]] * len(fitted.state.recordings)
    innovations = []
    for filtered in filter_all(fitted.state, rows):
        variance = filtered.variance[0]
        quiet = variance < _QUIET * float(np.percentile(variance, 10))
        innovations.append(Whitened(filtered.innovation[0] / np.sqrt(variance), quiet))
    return innovations


def checks(fitted: FreeDecayFit, seed: int = 20250101) -> list[Check]:
    """All statistics, the worst first; of each kind the worst recording's is kept."""
    rng = np.random.default_rng(seed)
    worst: dict[str, Check] = {}
    for record, white in zip(fitted.state.recordings, whitened(fitted), strict=True):
        for name, z in judged(white, rng).items():
            if name not in worst or abs(z) > abs(worst[name].z):
                worst[name] = Check(f"{name} ({record.name})", z, LIMIT)
    return sorted(worst.values(), key=lambda entry: -abs(entry.z))


def judged(white: Whitened, rng: np.random.Generator) -> dict[str, float]:
    """Statistics of one recording's whitened innovations, each as a standard normal by draws."""
    real = _statistics(white.values, white.quiet)
    drawn = np.stack([_statistics(rng.standard_normal(len(white.values)), white.quiet) for _ in range(_DRAWS)])
    return dict(zip(_NAMES, ((real - drawn.mean(0)) / drawn.std(0)).tolist(), strict=True))


def autocorrelation(values: Floats, quiet: Bools) -> Floats:
    """At lags 1 to :data:`LAGS`, (LAGS,), of pairs of values (m,) that both lie between impulses."""
    still = np.where(quiet, values, 0.0)
    power = float(still @ still) / int(quiet.sum())
    pairs = [max(int(np.sum(quiet[lag:] & quiet[:-lag])), 1) for lag in range(1, LAGS + 1)]
    return np.array([float(still[lag:] @ still[:-lag]) / (power * pairs[lag - 1]) for lag in range(1, LAGS + 1)])


def _statistics(values: Floats, quiet: Bools) -> Floats:
    still = values[quiet]
    power = np.mean(still**2)
    blocks = np.array([np.mean(block**2) for block in np.array_split(still, _BLOCKS)])
    # each is near normal in its root or logarithm, so that few draws tell its spread
    return np.array(
        [
            np.log(power),
            np.sqrt(len(still) * np.sum(autocorrelation(values, quiet) ** 2)),
            np.log(np.mean(still**4) / power**2),
            np.log(blocks.std() / blocks.mean()),
        ]
    )

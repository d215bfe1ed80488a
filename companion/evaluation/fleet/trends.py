"""Sentences on a fleet: whose mode drifts, whose sensor ages, and which single flight stands out of its aircraft's.

Flights of an aircraft are compared in the order of their files' names. A drift is the change of the median from the
first to the last third of them, whose flights scatter about either median by one amount (those between count for
nothing: a step falls among them). A median's sigma is 1.25 times that of a mean, for the normal law. A drift is named
where Student's t leaves it the chance of three sigmas, for all figures of an aircraft together. A single flight leaves
the median by three sigmas of its own and the median's together. A sensor without any noise is stuck: its noise counts
for no median.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t as student

_SIGMAS = 3.0  # by which a change or a flight is no chance (choice)
_CHANCE = 0.0027  # that any figure of an aircraft that stays as it is drifts: beyond three sigmas (choice)
_MOST = 20  # sentences that are read; the table has the rest (choice)
_FEWEST = 3  # flights of an aircraft that have a median worth the name (choice)
_THIRDS_FEWEST = 9  # flights that have thirds with medians (choice)
_MEDIAN_SIGMA = 1.2533  # of a median, per sigma of a mean (sqrt(pi / 2); derived)
_DRIFT_RATIO = 0.005  # of its aircraft's median: a twentieth of what an airframe file believes of a mode (choice)
_SLOW_RATIO = 0.02  # of its aircraft's median: a sensor that comes slower has lost samples (choice)
_NOISE_RATIO = 0.25  # of its aircraft's median: a sensor that is noisier is loose, warm or worn (choice)
_STUCK_NOISE = 1e-9  # (m/s^2)/sqrt(Hz): below any accelerometer's; rounding leaves this of a constant value (choice)
_EFFECT = "effect: "  # begins the column of an effect that a diagnosis named
_LOSSES = {
    "cut": "cut off while recording",
    "incomplete": "records are missing (a damaged file, or a disk that was too slow)",
}
_STATIONS = ("root", "left", "right")

Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True, slots=True)
class _Figure:
    """A column that is followed over an aircraft's flights: what it is called, and the least change worth a word."""

    column: str
    name: str
    unit: str
    least_ratio: float
    sigma_column: str = ""
    worse: int = 0
    """1 where only a rise is worse, -1 where only a fall is, 0 for both."""

    def values(self, flights: Rows) -> list[tuple[Mapping[str, Any], float]]:
        """The flights that have it, each with its value; the noise of a stuck sensor is none."""
        measured = [(row, float(row[self.column])) for row in flights if row.get(self.column) is not None]
        return [(row, value) for row, value in measured if self not in _NOISES or value > _STUCK_NOISE]

    def matters(self, change: float, usual: float) -> bool:
        """Whether a change from the usual value is large enough, in the direction that is worse."""
        return abs(change) > self.least_ratio * abs(usual) and change * self.worse >= 0.0


_MODES = tuple(
    _Figure(f"{mode}_hz", f"{mode} mode", "Hz", _DRIFT_RATIO, f"{mode}_sigma_hz")
    for mode in ("symmetric", "antisymmetric")
)
_DAMPINGS = tuple(
    _Figure(f"{mode}_damping", f"{mode} mode's damping", "of critical", _DRIFT_RATIO, f"{mode}_damping_sigma")
    for mode in ("symmetric", "antisymmetric")
)
_RATES = tuple(
    _Figure(f"{place}_rate_hz", f"{place} sensor's rate", "Hz", _SLOW_RATIO, worse=-1) for place in _STATIONS
)
_NOISES = tuple(
    _Figure(f"{place}_noise", f"{place} sensor's noise", "m/s²/√Hz", _NOISE_RATIO, worse=1) for place in _STATIONS
)
_SENSORS = (*_RATES, *_NOISES)
_FIGURES = (*_MODES, *_DAMPINGS, *_SENSORS)


def sentences(rows: Rows) -> list[str]:
    """Everything that is said of a fleet: what stands out, what files lack, and whose flights are unremarkable."""
    said = findings(rows)
    rest = [f"and {len(said) - _MOST} more"] if len(said) > _MOST else []
    return [*said[:_MOST], *rest, *losses(rows), *unremarkable(rows)]


def findings(rows: Rows) -> list[str]:
    """All sentences: effects that recur, stuck sensors, drifts, then single flights; each kind's clearest first."""
    stuck: list[tuple[float, str]] = []
    drifts: list[tuple[float, str]] = []
    singles: list[tuple[float, str]] = []
    recurring: list[tuple[float, str]] = []
    for airframe, flights in _by_aircraft(rows).items():
        recurring += _recurring_effects(airframe, flights)
        stuck += _stuck_sensors(airframe, flights)
        complete = [row for row in flights if not row.get("incomplete")]  # no sensor lost what a file lacks
        measured = {figure: complete if figure in _SENSORS else flights for figure in _FIGURES}
        tried = sum(len(figure.values(judged)) >= _THIRDS_FEWEST for figure, judged in measured.items())
        for figure, judged in measured.items():
            drift = _drift(airframe, judged, figure, tried)
            if drift is not None:
                drifts.append(drift)
            else:
                singles += _outliers(airframe, judged, figure)
    return [text for kind in (recurring, stuck, drifts, singles) for _, text in sorted(kind, key=_clearest)]


def losses(rows: Rows) -> list[str]:
    """Sentences about files that lack a part."""
    named = {words: [Path(row["file"]).name for row in rows if row.get(state)] for state, words in _LOSSES.items()}
    return [f"{words}, and judged by what is there: {', '.join(names)}" for words, names in named.items() if names]


def unremarkable(rows: Rows) -> list[str]:
    """For each airframe without a sentence of its own: from how many flights nothing was seen, or that they are few."""
    said = findings(rows)
    return [
        f"{airframe}: {_nothing(len(flights))}"
        for airframe, flights in _by_aircraft(rows).items()
        if not any(sentence.startswith(f"{airframe}: ") for sentence in said)
    ]


def _nothing(flights: int) -> str:
    if flights < _FEWEST:
        return f"too few flights for a usual value ({flights}; {_FEWEST} are needed, {_THIRDS_FEWEST} for a drift)"
    if flights < _THIRDS_FEWEST:
        outlier = f"none of {flights} flights leaves their median by three sigma"
        return f"{outlier}; too few for a drift ({_THIRDS_FEWEST} are needed)"
    return f"nothing drifts over {flights} flights, and none leaves their median by three sigma"


def _by_aircraft(rows: Rows) -> dict[str, list[Mapping[str, Any]]]:
    flights: dict[str, list[Mapping[str, Any]]] = defaultdict(list)
    for row in rows:
        if row.get("airframe"):
            flights[row["airframe"]].append(row)
    return flights


def _clearest(entry: tuple[float, str]) -> float:
    return -entry[0]


def _recurring_effects(airframe: str, flights: Rows) -> Iterator[tuple[float, str]]:
    """Number of flights and sentence of each effect that a diagnosis named in more than one flight."""
    for column in dict.fromkeys(name for row in flights for name in row if name.startswith(_EFFECT)):
        values = [float(row[column]) for row in flights if row.get(column) is not None]
        if len(values) > 1:
            what = f"{column.removeprefix(_EFFECT)} named in {len(values)} of {len(flights)} flights"
            low, middle, high = np.percentile(values, [0, 50, 100])
            yield len(values), f"{airframe}: {what}, median {middle:.3g} ({low:.3g} to {high:.3g})"


def _stuck_sensors(airframe: str, flights: Rows) -> Iterator[tuple[float, str]]:
    """Number of flights and sentence of each sensor that sent one value all the time."""
    for place, figure in zip(_STATIONS, _NOISES, strict=True):
        noises = [(row, row.get(figure.column)) for row in flights]
        still = [row for row, noise in noises if noise is not None and noise <= _STUCK_NOISE]
        if still:
            where = f"in {len(still)} of {len(flights)} flights, first in {Path(still[0]['file']).name}"
            yield len(still), f"{airframe}: {place} sensor is stuck: it has no noise at all {where}"


def _drift(airframe: str, flights: Rows, figure: _Figure, tried: int) -> tuple[float, str] | None:
    """Clearness in sigmas and sentence of a change from the first to the last third, ``tried`` figures beside it."""
    values = np.array([value for _, value in figure.values(flights)])
    if len(values) < _THIRDS_FEWEST:
        return None
    third = len(values) // 3
    ends = np.stack([values[:third], values[-third:]])
    medians = np.median(ends, axis=1)
    first, last = medians.tolist()
    freedom = ends.size - len(ends)
    scatter = float(np.sqrt(np.sum((ends - medians[:, None]) ** 2) / freedom))
    sigma = max(_MEDIAN_SIGMA * scatter * float(np.sqrt(2.0 / third)), 1e-9 * abs(first), 1e-12)
    sigmas = _SIGMAS * abs(last - first) / (sigma * float(student.isf(0.5 * _CHANCE / tried, freedom)))
    if sigmas < _SIGMAS or not figure.matters(last - first, first):
        return None
    change = f"went from {first:.4g} to {last:.4g} {figure.unit}"
    change += f" ({100 * (last / first - 1):+.1f} %)" if first else ""  # of nothing there is no percentage
    return sigmas, f"{airframe}: {figure.name} {change} between the first and the last third of {len(values)} flights"


def _outliers(airframe: str, flights: Rows, figure: _Figure) -> Iterator[tuple[float, str]]:
    """Clearness and sentence of each flight that left its aircraft's median."""
    measured = figure.values(flights)
    if len(measured) < _FEWEST:
        return
    usual = float(np.median([value for _, value in measured]))
    sigmas_of_fits = [row.get(figure.sigma_column) for row, _ in measured]
    if not figure.sigma_column:
        sigmas_of_fits = [figure.least_ratio * abs(usual) / _SIGMAS] * len(measured)
    stated = [float(sigma) for sigma in sigmas_of_fits if sigma is not None]
    if not stated:
        return
    of_usual = _MEDIAN_SIGMA * float(np.median(stated)) / float(np.sqrt(len(stated))) if figure.sigma_column else 0.0
    for (row, value), sigma in zip(measured, sigmas_of_fits, strict=True):
        if sigma is None:
            continue  # nothing says how well it is known
        sigmas = abs(value - usual) / max(float(np.hypot(float(sigma), of_usual)), 1e-9)
        if sigmas > _SIGMAS and figure.matters(value - usual, usual):
            where = f"in {Path(row['file']).name}"
            yield sigmas, f"{airframe}: {figure.name} {value:.4g}, usually {usual:.4g} {figure.unit}, {where}"

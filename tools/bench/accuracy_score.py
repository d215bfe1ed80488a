"""Score one cell: the tracker's errors beside the reference's, seed by seed."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from companion.records import Floats
from tools.bench.accuracy_belief import believed_airframe
from tools.bench.accuracy_cases import Cell
from tools.bench.accuracy_drive import LAG_S, LOCK_S, START_S, TrackerOutput, drive, instants
from tools.bench.accuracy_peaks import issues_of, miss_s
from tools.reference.imu import samples
from tools.reference.oracle import Oracle
from tools.reference.truth import TruthRun, simulate

_INDEPENDENT_S = 2.0  # between instants whose errors are taken as independent
_SEEDS_AT_ONCE = 3  # what the reference holds in memory


@dataclass(frozen=True, slots=True)
class Score:
    """One run. Mean squares are per mode [symmetric, antisymmetric] in units of the mode's rms, tracker then reference.

    Attributes
    ----------
    causal, smoothed : (2, 2) float64
        Rows tracker and reference, columns modes.
    slope_rad2 : (2,) float64
        Mean square error of the smoothed relative slope (left plus right), the toe of a pair that looks down.
    slope_nees : float
        Mean square of the tracker's over its variance.
    slope_inside : (3,) float64
        Shares of the tracker's inside 1, 2 and 3 sigma.
    peak : (2, 2) float64
        Mean square of the peak time, in periods.
    nees : (2, 2, 2) float64
        Causal and smoothed; tracker and reference; modes.
    lock : (2,) float64
        Relative frequency error at 5 s over sqrt(zeta / (omega T)).
    refused : float
        Share of the requests that were refused.
    """

    suite: str
    label: str
    seed: int
    frequency_hz: float
    gust: str
    causal: Floats
    smoothed: Floats
    slope_rad2: Floats
    slope_nees: float
    slope_inside: Floats
    peak: Floats
    nees: Floats
    lock: Floats
    refused: float


def as_row(score: Score) -> dict[str, Any]:
    """Score as a part file holds it."""
    return {name: np.asarray(value).tolist() for name, value in dataclasses.asdict(score).items()}


def from_row(row: dict[str, Any]) -> Score:
    """Score that :func:`as_row` laid out."""
    return Score(**{name: np.array(value) if isinstance(value, list) else value for name, value in row.items()})


def score_cell(cell: Cell) -> list[Score]:
    """Fly all seeds of a cell."""
    scores: list[Score] = []
    for first in range(0, len(cell.seeds), _SEEDS_AT_ONCE):
        scores += _score_some(cell, cell.seeds[first : first + _SEEDS_AT_ONCE])
    return scores


def _score_some(cell: Cell, seeds: tuple[int, ...]) -> list[Score]:
    run = simulate(cell.spec, seeds)
    values = samples(run)
    oracle = Oracle(cell.spec, samples(run, moving=False))
    at_s = instants(cell.spec.duration_s)
    causal, smoothed = oracle.causal(at_s), oracle.smoothed(at_s, LAG_S)
    scores = []
    for s, seed in enumerate(seeds):
        issues = issues_of(run, s, START_S)
        output = drive(believed_airframe(cell.spec, seed, cell.perturbation), run, values, s, issues)
        truth = _Truth(run, s, at_s)
        curves: list[list[Floats | None]] = [output.forecasts, []]
        for issue in issues:
            curves[1].append(oracle.forecast(issue.t_s, s, issue.count)[:, issue.mode])
        peak = np.array([[_peak(issues, c, mode) for mode in (0, 1)] for c in curves])
        reference = (causal.q_m[s], causal.q_sigma_m[s], smoothed.q_m[s], smoothed.q_sigma_m[s])
        slope_error = (output.slope.sum(axis=1) - truth.slope, smoothed.slope_rad[s].sum(axis=1) - truth.slope)
        slope_z = (slope_error[0] / output.slope_sigma)[np.isfinite(slope_error[0])]
        mode = cell.spec.symmetric
        scores.append(
            Score(
                suite=cell.suite,
                label=cell.label,
                seed=seed,
                frequency_hz=mode.frequency_hz,
                gust=cell.spec.gust.name,
                causal=np.stack([truth.square(output.causal, truth.q), truth.square(reference[0], truth.q)]),
                smoothed=np.stack([truth.square(output.smoothed, truth.q), truth.square(reference[2], truth.q)]),
                slope_rad2=np.array([np.nanmean(error**2) for error in slope_error]),
                slope_nees=float(np.nanmean(slope_z**2)),
                slope_inside=np.array([np.mean(np.abs(slope_z) < bound) for bound in (1.0, 2.0, 3.0)]),
                peak=peak,
                nees=_nees(output, reference, truth),
                lock=_lock(output, run),
                refused=float(np.isnan(output.smoothed).mean() / 2 + np.isnan(output.causal).mean() / 2),
            )
        )
    return scores


class _Truth:
    """The truth of one seed at the judged instants."""

    def __init__(self, run: TruthRun, s: int, at_s: Floats) -> None:
        self.q = run.total_at(at_s)[s, :2].T
        self.rms = np.array([mode.rms_m for mode in run.spec.modes[:2]])
        self.slope = run.slope_at(at_s)[s].sum(axis=0)

    def square(self, estimate: Floats, q: Floats) -> Floats:
        """Mean square error per mode, in units of its rms."""
        if np.isnan(estimate).all():
            return np.full(2, np.nan)
        return np.asarray(np.nanmean(((estimate - q) / self.rms) ** 2, axis=0))


def _peak(issues: list, curves: list[Floats | None], mode: int) -> float:  # type: ignore[type-arg]
    misses = [
        miss_s(issue, curve) / (4 * issue.quarter_s)
        for issue, curve in zip(issues, curves, strict=True)
        if curve is not None and issue.mode == mode
    ]
    return float(np.mean(np.square(misses))) if misses else float("nan")


def _nees(output: TrackerOutput, reference: tuple[Floats, Floats, Floats, Floats], truth: _Truth) -> Floats:
    every = round(_INDEPENDENT_S / (output.instants_s[1] - output.instants_s[0]))
    pairs = (
        ((output.causal - truth.q) / output.causal_sigma, (reference[0] - truth.q) / reference[1]),
        ((output.smoothed - truth.q) / output.smoothed_sigma, (reference[2] - truth.q) / reference[3]),
    )
    return np.array([[np.nanmean(z[::every] ** 2, axis=0) for z in pair] for pair in pairs])


def _lock(output: TrackerOutput, run: TruthRun) -> Floats:
    modes = run.spec.modes[:2]
    grown = np.exp(run.spec.drift_per_s * LOCK_S)
    limit = [np.sqrt(m.damping / (2 * np.pi * m.frequency_hz * LOCK_S)) for m in modes]
    true = np.array([m.frequency_hz * grown for m in modes])
    return np.asarray((output.frequency_hz / true - 1) / limit)

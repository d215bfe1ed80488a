"""Fly one seed through a tracker, and note what it said when."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.core.tracking.tracker import WingTracker
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import Deflection, Floats, ModeState, Reject
from tools.bench.accuracy_peaks import Issue
from tools.reference.imu import EPOCH_HOST_NS, chunks
from tools.reference.truth import TruthRun

LAG_S = 0.5
START_S = 10.0
EVERY_S = 0.1
LOCK_S = 5.0
_CHUNKS_S = (0.044, 0.056)
_GRID_S = 0.004
_MARGIN_S = 0.004  # samples that have arrived beyond the newest processed instant


@dataclass(slots=True)
class TrackerOutput:
    """Answers of the tracker: deflections (n, 2) with trim, and their sigmas; NaN where it refused.

    ``smoothed`` is at the instants themselves, known ``LAG_S`` later; ``slope`` is [left, right]. ``forecasts`` has one
    predicted curve (count,) in steps of 1 ms for each issue, None where refused.
    """

    instants_s: Floats
    causal: Floats
    causal_sigma: Floats
    smoothed: Floats
    smoothed_sigma: Floats
    slope: Floats
    slope_sigma: Floats
    frequency_hz: Floats = field(default_factory=lambda: np.full(2, np.nan))
    forecasts: list[Floats | None] = field(default_factory=list)


def instants(duration_s: float) -> Floats:
    """Instants that are judged; the last leaves room for the lag."""
    count = int((duration_s - LAG_S - 0.1 - START_S) / EVERY_S)
    return START_S + EVERY_S * np.arange(count)


def drive(
    airframe: Airframe, run: TruthRun, values: tuple[Floats, Floats, Floats], seed_index: int, issues: list[Issue]
) -> TrackerOutput:
    """Run a fresh tracker over one seed."""
    settings = Settings(smoother_lag_s=LAG_S)
    tracker = WingTracker(airframe, settings)
    window_ns = round(settings.reorder_window_s * 1e9)
    at_s = instants(run.spec.duration_s)
    output = TrackerOutput(at_s, *(np.full((len(at_s), 2), np.nan) for _ in range(5)), np.full(len(at_s), np.nan))
    causal_at = {round(t / _GRID_S): i for i, t in enumerate(at_s)}
    smooth_at = {round((t + LAG_S) / _GRID_S): i for i, t in enumerate(at_s)}
    issue_at: dict[int, list[int]] = {}
    for number, issue in enumerate(issues):
        issue_at.setdefault(round(issue.t_s / _GRID_S), []).append(number)
    output.forecasts = [None] * len(issues)
    ends = _ends(run.spec.duration_s, issue_at)
    lock = round(LOCK_S / _GRID_S)
    for end_s, batches in chunks(run, values, seed_index, [end * _GRID_S + _MARGIN_S for end in ends]):
        for batch in batches:
            tracker.add(batch)
        step = round((end_s - _MARGIN_S) / _GRID_S)
        now_ns = EPOCH_HOST_NS + step * round(_GRID_S * 1e9)
        state = tracker.advance(now_ns + window_ns)
        if state is None:
            continue
        if step == lock:
            output.frequency_hz[:] = state.symmetric.frequency_hz, state.antisymmetric.frequency_hz
        if step in causal_at:
            _note_causal(output, causal_at[step], state, now_ns)
        if step in smooth_at:
            _note_smoothed(output, smooth_at[step], tracker.smooth(now_ns - round(LAG_S * 1e9)))
        for number in issue_at.get(step, ()):
            output.forecasts[number] = _forecast(tracker, issues[number], now_ns)
    return output


def _ends(duration_s: float, issue_at: dict[int, list[int]]) -> list[int]:
    """Chunk ends in steps of the grid: 44 and 56 ms in turn, and wherever a forecast is called for."""
    pattern = [round(c / _GRID_S) for c in _CHUNKS_S]
    last = round((duration_s - _MARGIN_S) / _GRID_S)
    ends, at, turn = set(issue_at), 0, 0
    while at < last:
        at += pattern[turn % 2]
        turn += 1
        ends.add(at)
    return sorted(end for end in ends if 0 < end <= last)


def _note_causal(output: TrackerOutput, i: int, state: ModeState, now_ns: int) -> None:
    if state.t_host_ns != now_ns:
        raise RuntimeError(f"the tracker speaks of {state.t_host_ns}, not of {now_ns}")
    output.causal[i], output.causal_sigma[i] = state.q_m, state.q_sigma_m


def _note_smoothed(output: TrackerOutput, i: int, deflection: Deflection | Reject) -> None:
    if isinstance(deflection, Reject):
        return
    output.smoothed[i], output.smoothed_sigma[i] = deflection.q_m, np.sqrt(np.diag(deflection.covariance)[:2])
    output.slope[i] = deflection.slope_rad
    output.slope_sigma[i] = np.sqrt(deflection.covariance[4:6, 4:6].sum())


def _forecast(tracker: WingTracker, issue: Issue, now_ns: int) -> Floats | None:
    predicted = tracker.forecast(issue.count * 1_000_000, 1_000_000)
    if isinstance(predicted, Reject):
        return None
    if int(predicted.t_host_ns[0]) != now_ns + 1_000_000:
        raise RuntimeError("the forecast does not begin at the newest instant")
    return np.asarray(predicted.q_m[:, issue.mode])

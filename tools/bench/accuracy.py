"""Tracker accuracy against a reference that knows the truth: ``python -m tools.bench accuracy``.

Every row is pooled over its seeds: the mean over cells (equal truths) of the ratio of mean squares, tracker over
reference, square root taken. The spread is the 10th to 90th percentile of the ratio of single seeds. The seeds are a
fixed list. Each truth leaves a part file: a run that was stopped goes on where it was; parts of different commits
never mix.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from companion.errors import SpanwiseError
from companion.evaluation.fleet.campaign import work_off
from companion.records import Floats
from tools.bench.accuracy_cases import FREQUENCIES_HZ, SHAPES, SUITES, Cell, cells
from tools.bench.accuracy_score import Score, as_row, from_row, score_cell
from tools.bench.publish_results import commit

SEEDS, QUICK_SEEDS = 50, 6
DURATION_S = 40.0


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table; ``target`` is (lowest, highest), None where the figure only informs."""

    name: str
    value: float
    low: float
    high: float
    target: tuple[float, float] | None
    runs: int

    @property
    def verdict(self) -> str:
        """pass, MISS, or nothing where there is no target."""
        if self.target is None:
            return ""
        return "pass" if self.target[0] <= self.value <= self.target[1] else "MISS"


@dataclass(frozen=True, slots=True)
class CellTask:
    """One truth with its seeds as a task: its part file lies in the suite's folder."""

    cell: Cell
    folder: Path

    @property
    def name(self) -> str:
        """Truth and seeds."""
        return f"{self.cell.label}, seeds {self.cell.seeds}"

    @property
    def result_file(self) -> Path:
        """Part file of the truth; no seed flies twice."""
        return self.folder / self.cell.suite / f"{'_'.join(map(str, self.cell.seeds))}.json"


def score_task(task: CellTask) -> dict[str, Any]:
    """Fly one task, in a worker."""
    return {"file": task.name, "scores": [as_row(score) for score in score_cell(task.cell)]}


def score(suites: list[str], seeds: int, duration_s: float, jobs: int, folder: Path) -> list[Score]:
    """Fly the suites; the order of the scores does not depend on ``jobs``.

    Raises
    ------
    SpanwiseError
        A truth failed.
    """
    tasks = [CellTask(cell, folder) for suite in suites for cell in cells(suite, seeds, duration_s)]
    rows = work_off(tasks, score_task, jobs)
    failed = [f"{row['file']}: {row['failed']}" for row in rows if row.get("failed")]
    if failed:
        raise SpanwiseError("; ".join(failed))
    return [from_row(entry) for row in rows for entry in row["scores"]]


def table(scores: list[Score]) -> list[Row]:
    """Pool the scores into rows."""
    rows: list[Row] = []
    for suite in SUITES:
        of_suite = [s for s in scores if s.suite == suite]
        if of_suite:
            rows += list(_suite_rows(suite, of_suite))
    return rows


def _suite_rows(suite: str, of_suite: list[Score]) -> Iterator[Row]:
    bound = 1.10 if suite.startswith("priors") else 1.05
    peak_bound = 1.15 if suite.startswith("drift") else bound
    groups: list[tuple[str, list[Score], float]] = [("all", of_suite, bound)]
    if suite == "vertical":
        slow = [s for s in of_suite if s.frequency_hz < 6]
        fast = [s for s in of_suite if s.frequency_hz >= 6]
        groups = [("below 6 Hz", slow, 1.10), ("above 6 Hz", fast, 1.05)]
    for name, of_group, limit in groups:
        yield _ratio_row(f"{suite}: deflection causal, {name}", of_group, lambda s: s.causal, (0.0, limit))
        yield _ratio_row(f"{suite}: deflection smoothed, {name}", of_group, lambda s: s.smoothed, (0.0, limit))
    yield _ratio_row(f"{suite}: peak time 20 ms ahead", of_suite, lambda s: s.peak, (0.0, peak_bound))
    yield _slope_row(f"{suite}: smoothed relative slope, mrad", of_suite, (0.0, 0.18) if suite == "slope" else None)
    for gusts, of_gusts, limit in (
        ("white gusts", [s for s in of_suite if s.gust.startswith("white")], 1.10),
        ("coloured gusts", [s for s in of_suite if not s.gust.startswith("white")], bound),
    ):
        if of_gusts:
            yield _slope_ratio_row(f"{suite}: relative slope over the reference's, {gusts}", of_gusts, (0.0, limit))
    yield _mean_row(f"{suite}: relative slope, NEES", of_suite, lambda s: np.array([s.slope_nees]), (0.8, 1.25))
    for sigmas, wanted in ((1, None), (2, None), (3, (0.99, 1.0))):
        yield _mean_row(f"{suite}: relative slope, share inside {sigmas} sigma", of_suite, _inside(sigmas), wanted)
    target = (0.9, 1.1)
    yield _mean_row(f"{suite}: NEES causal", of_suite, lambda s: s.nees[0, 0], target)
    yield _mean_row(f"{suite}: NEES smoothed", of_suite, lambda s: s.nees[1, 0], target)
    yield _mean_row(f"{suite}: NEES smoothed of the reference", of_suite, lambda s: s.nees[1, 1], None)
    if not suite.startswith("drift"):
        yield _lock_row(f"{suite}: frequency error at 5 s / sqrt(zeta/(omega T))", of_suite)
    yield _mean_row(f"{suite}: share refused", of_suite, lambda s: np.array([s.refused]), (0.0, 0.0))
    if suite in ("six-axis", "vertical"):
        yield from _details(suite, of_suite)


def _details(suite: str, of_suite: list[Score]) -> Iterator[Row]:
    for frequency in FREQUENCIES_HZ:
        for shape in SHAPES:
            of_shape = [s for s in of_suite if s.frequency_hz == frequency and s.gust == shape.name]
            if of_shape:
                name = f"{suite}: {frequency:g} Hz {shape.name}"
                yield _ratio_row(f"{name}: causal", of_shape, lambda s: s.causal, None)
                yield _ratio_row(f"{name}: smoothed", of_shape, lambda s: s.smoothed, None)
                yield _ratio_row(f"{name}: peak", of_shape, lambda s: s.peak, None)


def _ratio_row(
    name: str, scores: list[Score], squares: Callable[[Score], Floats], target: tuple[float, float] | None
) -> Row:
    """Pool ratios of (tracker, reference) x columns: sums over a truth's seeds first, then the mean over truths."""
    sums: dict[str, Floats] = {}
    for s in scores:
        sums[s.label] = sums.get(s.label, np.zeros(())) + squares(s)
    ratios = np.array([total[0] / total[1] for total in sums.values()])
    singles = np.array([np.sqrt(squares(s)[0] / squares(s)[1]) for s in scores])
    return Row(name, float(np.sqrt(np.mean(ratios))), *_spread(singles), target, len(scores))


def _slope_ratio_row(name: str, scores: list[Score], target: tuple[float, float] | None) -> Row:
    """Pool ratios of the relative slope's mean squares; both columns are alike, for all modes make it together."""
    return _ratio_row(name, scores, lambda s: s.slope_rad2[:, np.newaxis], target)


def _inside(sigmas: int) -> Callable[[Score], Floats]:
    """The share of a run's relative slopes that lie inside 1, 2 or 3 sigma, (1,)."""
    return lambda score: score.slope_inside[sigmas - 1 : sigmas]


def _slope_row(name: str, scores: list[Score], target: tuple[float, float] | None) -> Row:
    squares = np.array([s.slope_rad2[0] for s in scores])
    return Row(name, float(1e3 * np.sqrt(squares.mean())), *_spread(1e3 * np.sqrt(squares)), target, len(scores))


def _mean_row(
    name: str, scores: list[Score], value: Callable[[Score], Floats], target: tuple[float, float] | None
) -> Row:
    values = np.array([value(s) for s in scores])
    return Row(name, float(values.mean()), *_spread(values.mean(axis=1)), target, len(scores))


def _lock_row(name: str, scores: list[Score]) -> Row:
    values = np.array([s.lock for s in scores])
    return Row(name, float(np.sqrt(np.mean(values**2))), *_spread(np.abs(values)), (0.0, 3.0), len(scores))


def _spread(values: Floats) -> tuple[float, float]:
    low, high = np.nanpercentile(values, [10, 90]) if np.isfinite(values).any() else (np.nan, np.nan)
    return float(low), float(high)


def show(rows: list[Row]) -> str:
    """Lay the rows out as text."""
    lines = [f"{'':62s} {'value':>8s} {'10 %':>8s} {'90 %':>8s}  {'target':12s} runs"]
    for row in rows:
        target = "" if row.target is None else f"{row.target[0]:g} .. {row.target[1]:g}"
        values = f"{row.value:8.3f} {row.low:8.3f} {row.high:8.3f}"
        lines.append(f"{row.name:62s} {values}  {target:12s} {row.runs:4d}  {row.verdict}")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Run the bench; exit with 1 where a target is missed."""
    parser = argparse.ArgumentParser(prog="tools.bench.accuracy", description=__doc__)
    parser.add_argument("--seeds", type=int, default=SEEDS, help="runs of a suite; twice as many of the pooled ones")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_SEEDS} seeds: a look, not a verdict")
    parser.add_argument("--cases", nargs="+", choices=SUITES, default=list(SUITES), metavar="CASE")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--parts", type=Path, help="folder of the part files (default: out/accuracy/COMMIT)")
    parser.add_argument("--json", type=Path, help="write the rows here as well")
    options = parser.parse_args(arguments)
    seeds = QUICK_SEEDS if options.quick else options.seeds
    folder = options.parts or Path("out/accuracy") / commit()
    rows = table(score(options.cases, seeds, DURATION_S, options.jobs, folder))
    print(show(rows))
    if options.json:
        listed = [dataclasses.asdict(row) | {"verdict": row.verdict} for row in rows]
        options.json.write_text(json.dumps(listed, indent=1) + "\n")
    return int(any(row.verdict == "MISS" for row in rows))


if __name__ == "__main__":
    sys.exit(main())

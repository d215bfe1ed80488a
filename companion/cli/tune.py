"""``spanwise tune``: parameter values proposed from a recording, with what each would have changed."""

from __future__ import annotations

import argparse
import dataclasses
import json
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.steps.numbers import integer
from companion.cli.steps.options import named_value
from companion.cli.terminal.progress import say
from companion.errors import NOTHING_TO_ESTIMATE, AirframeNeeded, RecordingError
from companion.evaluation.tuning import JUDGED, ParameterTrial, TrialOutcome, try_out, usual_trials, verdict_of
from companion.params.settings import Settings

_MOST_WORKERS = 64  # more than there are trials (choice)
_HEADS = ("trial", "planned", "skipped", "ranges", "trusted", "sigma", "scatter", "delay", "")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("recording", type=Path, help="a recording of Spanwise with ranges")
    parser.add_argument(
        "--try", action="append", default=[], metavar="NAME=VALUE", dest="tries",
        help="a value to try in place of the usual ones; may be repeated",
    )  # fmt: skip
    workers = min(os.cpu_count() or 1, _MOST_WORKERS)
    parser.add_argument("--workers", type=integer(1, _MOST_WORKERS), default=workers, help="replays at a time")
    parser.add_argument("--json", action="store_true", help="the result as JSON on standard output")


def execute(options: argparse.Namespace) -> int:
    """Replay the flight with each value, and say which would have been better; 3 where no range was trusted."""
    settings = _settings(options.recording)
    trials = [ParameterTrial((named_value("--try", text),)) for text in options.tries] or usual_trials(settings)
    for trial in trials:
        trial.over(settings)
    began_s = time.monotonic()
    rows = [_row(ParameterTrial(()), try_out(options.recording, ParameterTrial(())), None)]
    flown = TrialOutcome(**rows[0]["outcome"])
    _show(rows[0], options)
    if not flown.trusted:
        print("spanwise tune: no range of this flight was trusted; spanwise report says why", file=sys.stderr)
        return NOTHING_TO_ESTIMATE
    each_s = time.monotonic() - began_s
    say(f"{len(trials)} trials, two replays each: {waits(each_s * len(trials) / options.workers)}")
    is_complete = _try_all(options, trials, flown, rows)
    together, holds = proposal(rows, settings), False
    if len(together.changes) > 1 and is_complete:
        rows.append(_row(together, try_out(options.recording, together), flown))
        _show(rows[-1], options)
        holds = rows[-1]["proposed"]
    values = dict(together.changes) if holds or len(together.changes) == 1 else _best_single(rows)
    result = {"recording": str(options.recording), "trials": rows, "proposal": values}
    print(json.dumps(result, indent=2) if options.json else _sentence(result))
    return 0


def _settings(path: Path) -> Settings:
    """Settings of a recording of ours; another log has no ranges to try them on, whatever its aircraft."""
    try:
        return open_recording(path, None).settings
    except AirframeNeeded as error:
        raise RecordingError(f"{path}: tune needs a recording of Spanwise (.mcap) with ranges") from error


def _try_all(
    options: argparse.Namespace, trials: list[ParameterTrial], flown: TrialOutcome, rows: list[dict[str, Any]]
) -> bool:
    """Add and show a row for each trial; False where Ctrl-C ended them, which leaves those that are done."""
    began = len(rows)
    try:
        for trial, outcome in _tried(options.recording, trials, options.workers):
            rows.append(_row(trial, outcome, flown))
            _show(rows[-1], options)
    except KeyboardInterrupt:
        if len(rows) == began:
            raise
        say(f"stopped: proposing by {len(rows) - began} of {len(trials)} trials")
        return False
    return True


def _tried(path: Path, trials: list[ParameterTrial], workers: int) -> Iterator[tuple[ParameterTrial, TrialOutcome]]:
    """Outcomes in the order of the trials, whatever the number of processes."""
    if workers == 1:
        for trial in trials:
            yield trial, try_out(path, trial)
        return
    at_once = (signal.SIGINT, signal.SIG_DFL)  # Ctrl-C ends a worker, which would begin its next trial otherwise
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=signal.signal, initargs=at_once) as pool:
        futures = [pool.submit(try_out, path, trial) for trial in trials]
        try:
            for trial, future in zip(trials, futures, strict=True):
                yield trial, future.result()
        except KeyboardInterrupt:
            for worker in multiprocessing.active_children():  # the pool would wait for every trial that is left
                worker.terminate()
            raise


def _row(trial: ParameterTrial, outcome: TrialOutcome, flown: TrialOutcome | None) -> dict[str, Any]:
    is_better, why = (False, "") if flown is None else verdict_of(flown, outcome)
    return {
        "trial": trial.text,
        "changes": dict(trial.changes),
        "outcome": dataclasses.asdict(outcome),
        "proposed": is_better,
        "why": why,
    }


def proposal(rows: list[dict[str, Any]], settings: Any) -> ParameterTrial:
    """Join the proposed values, of each parameter the one with the most trusted ranges, then the smallest sigma.

    Values that contradict each other are not joined: the trial is empty.
    """
    best: dict[str, dict[str, Any]] = {}
    for row in _better_singles(rows):
        (name,) = row["changes"]
        if name not in best or _merit(row) > _merit(best[name]):
            best[name] = row
    joined = ParameterTrial(tuple((name, row["changes"][name]) for name, row in best.items()))
    return joined if joined.over(settings).conflict() is None else ParameterTrial(())


def _merit(row: dict[str, Any]) -> tuple[int, float]:
    return row["outcome"]["trusted"], -row["outcome"]["sigma_ratio"]


def _best_single(rows: list[dict[str, Any]]) -> dict[str, float]:
    """The best proposed value alone, where joined ones contradict each other, do not hold up, or were not tried."""
    singles = _better_singles(rows)
    return dict(max(singles, key=_merit)["changes"]) if singles else {}


def _better_singles(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [row for row in rows if row["proposed"] and len(row["changes"]) == 1]


def _show(row: dict[str, Any], options: argparse.Namespace) -> None:
    """One line of the table as soon as it is known."""
    out = sys.stderr if options.json else sys.stdout
    if not row["changes"]:
        print(_line(_HEADS), file=out)
    got = row["outcome"]
    counts = (got[name] for name in ("shots", "skipped", "ranges", "trusted"))
    figures = (f"{100 * got['sigma_ratio']:.2f} %", f"{got['scatter_ratio']:.2f}", f"{1e3 * got['delay_s']:.0f} ms")
    mark = "better: " if row["proposed"] else ""
    cells = (row["trial"], *counts, *(figures if got["trusted"] else ("-", "-", "-")), mark + row["why"])
    print(_line(cells), file=out, flush=True)


def waits(seconds: float) -> str:
    """How long something will take, in words."""
    return f"about {seconds:.0f} s" if seconds < 90.0 else f"about {seconds / 60.0:.0f} min"


def _line(cells: tuple[object, ...]) -> str:
    name, *figures, why = cells
    return f"  {name!s:28s}" + "".join(f"{cell!s:>9s}" for cell in figures) + f"  {why}"


def _sentence(result: dict[str, Any]) -> str:
    values = result["proposal"]
    note = (
        "ranges are of the pairs that were flown; another trigger setting would have made others (planned; some "
        "are not fired). Sigma is the median of sigma over range, scatter the differences of neighbours in their "
        f"sigmas. {JUDGED}"
    )
    if not values:
        return f"nothing to change: no trial betters one figure and worsens none\n({note})"
    settings = " ".join(f"--set {name}={value:g}" for name, value in values.items())
    return f"proposed: {settings}  (or as MAVLink parameters)\n({note})"

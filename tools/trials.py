"""Blind trials of the diagnosis: effects hidden by an independent simulator, found by ``companion.diagnosis``.

    python -m tools.trials                          one recording for every effect, a few with nothing hidden
    python -m tools.trials --acceptance             all that is promised, some hours; the same again goes on
    python -m tools.trials --leave-out              what is hidden is taken from the catalogue
    python -m tools.trials --pairs 20 --each 0      two effects at once
    python -m tools.trials --curve 2 4 6 8          how strong an effect must be to be found
    python -m tools.trials --generator stranger     any of these by the other hand, with --outside what no catalogue has
    python -m tools.trials --snr 10 --seed 5 --add  more of them, at 10 dB, beside those of earlier runs
    python -m tools.trials --show                   tabulate what earlier runs have left in the folder

Labels are sealed by hash before the first diagnosis. Each judgement is a task as a fleet's file is, for ``--workers``
processes or the Dask cluster of ``--scheduler``, and leaves a part file. Parts, a summary, a table (RESULTS.md) and a
confusion matrix go to out/trials; ``--publish`` also writes the last two into sitl_tests/trials, the other hand's alone
into its own.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from companion.evaluation.fleet.campaign import work_off
from tools.trial_generators import FIRST, GENERATORS, STRANGER
from tools.trial_plan import STRONG, Trial, acceptance, nothing, outside, several, singles, strangers_acceptance
from tools.trial_report import draw, summary, table
from tools.trial_results import commit, results
from tools.trial_tasks import PARTS, Batch, JudgementTask, judge_task, parts
from tools.trial_truths.strengths import IN_SAMPLES

_BATCH = 60
_PUBLISHED = Path(__file__).resolve().parents[1] / "sitl_tests" / "trials"
Rows = list[dict[str, Any]]


def run(
    batches: Sequence[Sequence[Trial]],
    seed: int,
    folder: Path,
    duration_s: float = 60.0,
    workers: int = 1,
    scheduler: str = "",
) -> Rows:
    """Fly and diagnose every batch; a row for each judgement, in the plan's order.

    Each judgement leaves a part in ``folder``; those that have theirs there are not made again.
    """
    code = commit()
    tasks = [
        JudgementTask(Batch(tuple(trials), seed, number, duration_s), place, leave_out, folder.resolve(), code)
        for number, trials in enumerate(batches)
        for place, trial in enumerate(trials)
        for leave_out in trial.judged
    ]
    rows = work_off(tasks, judge_task, workers, scheduler, _said)
    return [row for row in rows if not row.get("failed")]


def _plan(options: argparse.Namespace) -> list[list[Trial]]:
    hand = GENERATORS[options.generator]
    if options.acceptance:
        return acceptance(options.seed) if hand is FIRST else strangers_acceptance(options.seed)
    rng = np.random.default_rng(options.seed)
    judged = (options.leave_out,)
    trials: list[Trial] = []
    for _ in range(options.each):
        names = [name for name in options.only or hand.names if name not in IN_SAMPLES or not options.curve]
        for size in options.curve or [None]:
            strength = (size, size) if size else tuple(options.strength)
            kind = "curve" if size else "single"
            trials += singles(rng, options.snr, names, strength, judged, options.oracle, kind, hand)
    trials += [*several(rng, 2, options.pairs, hand=hand), *several(rng, 3, options.triples, hand=hand)]
    trials += [trial for _ in range(options.outside) for trial in outside(rng, hand)]
    if not (options.leave_out or options.curve):
        trials += nothing(rng, options.nothing, options.snr, hand=hand)
    trials = [trials[i] for i in rng.permutation(len(trials))]
    return [trials[first : first + _BATCH] for first in range(0, len(trials), _BATCH)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the trials that were asked for and write what came out."""
    parser = _parser()
    options = parser.parse_args(arguments)
    names = GENERATORS[options.generator].names
    if unknown := sorted(set(options.only) - set(names)):
        parser.error(f"--only {' '.join(unknown)}: {options.generator} hides only {', '.join(sorted(names))}")
    options.out.mkdir(parents=True, exist_ok=True)
    if not options.show:
        goes_on = options.add or options.acceptance
        batches = _plan(options)
        with (options.out / "seals.txt").open("a" if goes_on else "w", encoding="utf-8") as seals:
            seals.write("\n".join(trial.label.seal for batch in batches for trial in batch) + "\n")
        if not goes_on:
            shutil.rmtree(options.out / PARTS, ignore_errors=True)
        run(batches, options.seed, options.out, options.duration, options.workers, options.scheduler)
    rows = parts(options.out)
    figures = summary(rows)
    (options.out / "summary.json").write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    (options.out / "RESULTS.md").write_text(results(rows), encoding="utf-8")
    draw(rows, options.out / "confusion.png")
    if options.publish:
        # a table of one truth alone does not replace that of the other
        alone = all(row.get("generator") == STRANGER.name for row in rows)
        for name in ("RESULTS.md", "confusion.png"):
            shutil.copyfile(options.out / name, (_PUBLISHED / STRANGER.name if alone else _PUBLISHED) / name)
    print(table(rows, figures))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--acceptance", action="store_true", help="all that is promised; goes on where it was left")
    parser.add_argument("--each", type=int, default=1, help="recordings for every effect")
    parser.add_argument("--nothing", type=int, default=8, help="recordings with nothing hidden")
    parser.add_argument("--pairs", type=int, default=0, help="recordings with two effects")
    parser.add_argument("--triples", type=int, default=0, help="recordings with three effects")
    parser.add_argument("--only", nargs="*", default=[], help="effects to hide, of all")
    parser.add_argument("--generator", choices=sorted(GENERATORS), default=FIRST.name, help="whose truth")
    parser.add_argument("--outside", type=int, default=0, help="times everything that no catalogue has")
    parser.add_argument("--strength", type=float, nargs=2, default=STRONG, help="in posterior sigmas")
    parser.add_argument("--curve", type=float, nargs="*", default=[], help="exact strengths instead, in sigmas")
    parser.add_argument("--snr", type=float, default=20.0, help="dB")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--duration", type=float, default=60.0, help="seconds of each recording")
    parser.add_argument("--leave-out", action="store_true", help="take what is hidden from the catalogue")
    parser.add_argument("--oracle", action="store_true", help="also measure the gain of the true effect")
    parser.add_argument("--add", action="store_true", help="beside the rows that are in the folder")
    parser.add_argument("--show", action="store_true", help="fly nothing: tabulate the rows that are in the folder")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--scheduler", default="", metavar="ADDRESS", help="a Dask cluster in place of processes")
    parser.add_argument("--publish", action="store_true", help="write RESULTS.md and confusion.png beside the trials")
    parser.add_argument("--out", type=Path, default=Path("out/trials"))
    return parser


def _said(row: dict[str, Any]) -> str:
    wanted = row["verdict"] == "unexplained" if row["left_out"] else row["right"]
    return f"{row['verdict']}, as wanted" if wanted else f"{row['verdict']}, not as wanted"


if __name__ == "__main__":
    raise SystemExit(main())

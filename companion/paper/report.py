"""All sections in order, and the three files of the report."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import Any

from companion.paper import (
    beam_tables,
    digest,
    equations,
    fig_4,
    misprints,
    own_experiments,
    random_drive,
    range_tables,
    setups,
    triggering,
    untried,
    wing_shapes,
)
from companion.paper.experiments import Outcome, run
from companion.paper.findings import Section
from companion.paper.report_html import html
from companion.paper.report_markdown import markdown
from companion.paper.scores import Results, summary
from companion.paper.trials import REPEATED, Pace, Trial, trials
from companion.reporting.numbers import finite


def make_sections(pace: Pace, jobs: int, say: Callable[[str], None], seeds: Sequence[int]) -> list[Section]:
    """Run the whole audit, the experiments in ``jobs`` processes meanwhile; ``say`` is told the progress.

    Everything is run with the first of ``seeds``, what is to be repeated with the others too.
    """
    # spawned, for a fork would copy the threads' locks of whatever was imported
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        wait_for_results = _begin(pool, pace, say, seeds)
        random = random_drive.section()
        closed = [
            beam_tables.section(),
            range_tables.section(),
            equations.section(),
            fig_4.section(),
            wing_shapes.section(),
            random,
        ]
        say("tables, equations and figures")
        results = wait_for_results()
    return [
        digest.section(results, random.data),
        misprints.section(),
        *closed,
        setups.section(results),
        own_experiments.section(results),
        triggering.section(results),
        untried.section(results),
    ]


def _begin(pool: Executor, pace: Pace, say: Callable[[str], None], seeds: Sequence[int]) -> Callable[[], Results]:
    """Begin with all experiments; give what waits for their results."""
    seed, *others = seeds
    running = [pool.submit(run, trial, pace, seed) for trial in trials()]
    repeated = [trial for trial in trials() if trial.key in REPEATED]
    again = {(trial.key, other): pool.submit(at_peaks, trial, pace, other) for other in others for trial in repeated}

    def wait_for_results() -> Results:
        outcomes: list[Outcome] = []
        for future in running:
            outcomes.append(future.result())
            say(f"experiment {len(outcomes)} of {len(running)}: {outcomes[-1].trial.title}")
        draws: dict[str, dict[int, dict[str, Any]]] = {}
        for (key, other), scores in again.items():
            draws.setdefault(key, {})[other] = scores.result()
            say(f"again with seed {other}: {key}")
        return Results.of(outcomes, seed, draws)

    return wait_for_results


def at_peaks(trial: Trial, pace: Pace, seed: int) -> dict[str, Any]:
    """Run an experiment with another seed; give its scores at peaks alone."""
    return summary(run(trial, pace, seed), True)


def plain(sections: Sequence[Section]) -> dict[str, Any]:
    """Every number by section, for JSON; what is not finite becomes null."""
    return {
        section.key: {"title": section.title, "findings": list(section.findings), **finite(section.data)}
        for section in sections
    }


def write(sections: Sequence[Section], folder: Path) -> list[Path]:
    """Write ``report.html``, ``report.md`` and ``numbers.json``; give their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {
        "report.html": html(sections),
        "report.md": markdown(sections),
        "numbers.json": json.dumps(plain(sections), indent=1) + "\n",
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return [folder / name for name in texts]

"""All sections in order, and the three files of the report."""

from __future__ import annotations

import json
import math
import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from companion.cli.audit import (
    beam_tables,
    equations,
    experiment_report,
    fig_4,
    random_drive,
    range_tables,
    wing_shapes,
)
from companion.cli.audit.experiments import Outcome, Pace, run, trials
from companion.cli.audit.findings import Section
from companion.cli.audit.report_html import html
from companion.cli.audit.report_markdown import markdown


def make_sections(pace: Pace, jobs: int, told: Callable[[str], None]) -> list[Section]:
    """Run the whole audit, the experiments in ``jobs`` processes meanwhile; ``told`` hears what is done."""
    # spawned, for a fork would copy the threads' locks of whatever was imported
    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        running = [pool.submit(run, trial, pace) for trial in trials()]
        closed = [
            beam_tables.section(),
            range_tables.section(),
            equations.section(),
            fig_4.section(),
            wing_shapes.section(),
            random_drive.section(),
        ]
        told("tables, equations and figures")
        outcomes: list[Outcome] = []
        for future in running:
            outcomes.append(future.result())
            told(f"experiment {len(outcomes)} of {len(running)}: {outcomes[-1].trial.title}")
    return [*closed, *experiment_report.sections(outcomes)]


def plain(sections: Sequence[Section]) -> dict[str, Any]:
    """Every number by section, for JSON; what is not finite becomes null."""
    return {
        section.key: {"title": section.title, "findings": list(section.findings), **_finite(section.data)}
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


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value

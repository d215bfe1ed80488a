"""One judgement of a blind trial as a task of the fleet's runner."""

from __future__ import annotations

import functools
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tools.trial_judge import judge_trial
from tools.trial_plan import Trial
from tools.trial_truths.cases import Tables

PARTS = "judgements"


@dataclass(frozen=True, slots=True)
class Batch:
    """Trials that are flown together: what one records depends on the others and on its place among them."""

    trials: tuple[Trial, ...]
    seed: int
    number: int
    duration_s: float

    def __hash__(self) -> int:
        """Hash of the seals and the seed."""
        return hash((self.seed, self.number, self.duration_s, *(trial.label.seal for trial in self.trials)))


@dataclass(frozen=True, slots=True)
class JudgementTask:
    """One recording of a batch judged in one way; ``commit`` is that of the code which judges."""

    batch: Batch
    place: int
    leave_out: bool
    folder: Path
    commit: str

    @property
    def trial(self) -> Trial:
        """The trial that is judged."""
        return self.batch.trials[self.place]

    @property
    def name(self) -> str:
        """Generator, place in the plan, seal and way of judging; nothing of what is hidden."""
        place = f"{self.batch.seed}-{self.batch.number:03d}-{self.place:03d}"
        how = "left-out" if self.leave_out else "all"
        return f"{self.trial.generator}-{place}-{self.trial.label.seal[:12]}-{how}"

    @property
    def result_file(self) -> Path:
        """Where the row lies once it is made."""
        return self.folder / PARTS / f"{self.name}.json"


def judge_task(task: JudgementTask) -> dict[str, Any]:
    """Judge one trial, in a worker that has flown its batch."""
    row = judge_trial(task.trial, _recordings(task.batch)[task.place], task.leave_out)
    return {**row, "seed": task.batch.seed, "commit": task.commit}


def parts(folder: Path) -> list[dict[str, Any]]:
    """Rows of all judgements in a folder that did not fail, in the order of their plans."""
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted((folder / PARTS).glob("*.json"))]
    return [row for row in rows if not row.get("failed")]


@functools.lru_cache(maxsize=1)
def _recordings(batch: Batch) -> list[Tables]:
    """All recordings of a batch, flown once for the tasks that follow each other in a worker."""
    trials = batch.trials
    return trials[0].hand.fly(
        [trial.label for trial in trials],
        [trial.snr_db for trial in trials],
        batch.seed + batch.number,
        batch.duration_s,
        [trial.corner_hz for trial in trials],
    )

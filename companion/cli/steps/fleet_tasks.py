"""The work on one file of a fleet, in a worker: the same commands as for a single file."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from typing import Any

from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.main import main
from companion.errors import NOTHING_TO_ESTIMATE, RecordingError
from companion.evaluation.fleet.file_task import FileTask
from companion.evaluation.fleet.rows import diagnosis_row, flattened, flight_row, identification_row, tuning_row
from companion.evaluation.flight_log import gather
from companion.evaluation.pages.flight_report import render
from companion.params.files import load_airframe

NO_PAGES = "--no-pages"  # among a task's words: no page for its file
_MOST_SAID = 400  # chosen: characters of a reason: a cell of the table stays legible


def work(task: FileTask) -> dict[str, Any]:
    """Result of one file.

    Raises
    ------
    RecordingError
        The command refused the file; its sentence is the reason.
    """
    (task.folder / "pages").mkdir(parents=True, exist_ok=True)
    row = _report(task) if task.words[0] == "report" else _command(task)
    return {"file": task.name} | row | {"cut": _is_cut(task.path)}


def _is_cut(path: Path) -> bool:
    """Whether the recorder did not finish the file, where its format tells."""
    return path.suffix.lower() == ".mcap" and McapRecording(path).cut


def _report(task: FileTask) -> dict[str, Any]:
    named = _airframe(task)
    recording = open_recording(task.path, load_airframe(named) if named else None)
    log = gather(recording.records())
    row = flight_row(recording, log) | {"incomplete": isinstance(recording, McapRecording) and not recording.complete}
    if NO_PAGES in task.words:
        return row
    page = f"pages/{task.key}.html"
    (task.folder / page).write_text(render(recording, log), encoding="utf-8")
    return {"page": page} | row


def _airframe(task: FileTask) -> str | None:
    """Name that follows --airframe among the task's words."""
    words = task.words
    return words[words.index("--airframe") + 1] if "--airframe" in words else None


def _command(task: FileTask) -> dict[str, Any]:
    command, *words = (word for word in task.words if word != NO_PAGES)
    verbs = ["identify", "flight"] if command == "identify" else [command]
    printed, said = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(said):
        try:
            code = main([*verbs, str(task.path), *words, *_ending(task)])
        except SystemExit as end:  # argparse refused an option
            code = int(end.code or 0)
    if code not in (0, NOTHING_TO_ESTIMATE):
        raise RecordingError(said.getvalue().strip()[-_MOST_SAID:] or f"spanwise {command} ended with {code}")
    if code == NOTHING_TO_ESTIMATE and not printed.getvalue():
        return {"code": code, "result": said.getvalue().strip().rpartition("\n")[2][-_MOST_SAID:]}
    return _row_of(task, code, printed.getvalue())


def _row_of(task: FileTask, code: int, printed: str) -> dict[str, Any]:
    """Row of what the command printed or wrote; a result without its figures stays as it is printed."""
    command = task.words[0]
    if command == "identify":
        folder = f"pages/{task.key}"
        result = json.loads((task.folder / folder / "modes.json").read_text(encoding="utf-8"))
        return {"page": f"{folder}/spectra.png", "code": code} | identification_row(result)
    try:
        result = json.loads(printed)
    except ValueError:
        return {"code": code, "result": printed.strip()[:_MOST_SAID]}
    if command == "tune":
        return {"code": code} | tuning_row(result)
    page = f"pages/{task.key}.html"
    linked = {"page": page} if (task.folder / page).exists() else {}
    return linked | {"code": code} | (diagnosis_row(result) if "causes" in result else flattened(result))


def _ending(task: FileTask) -> list[str]:
    """Options that make a command give its result as JSON."""
    if task.words[0] == "identify":
        return ["--out", str(task.folder / "pages" / task.key)]
    if task.words[0] == "tune":
        return ["--json", "--workers", "1"]  # a file is a worker's: the others have files of their own
    page = ["--html", str(task.folder / "pages" / f"{task.key}.html")]
    return ["--json", "-", *([] if NO_PAGES in task.words else page)]

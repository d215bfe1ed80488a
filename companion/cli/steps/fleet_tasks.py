"""The work on one file of a fleet, in a worker: the same commands as for a single file."""

from __future__ import annotations

import contextlib
import io
import json
from typing import Any

from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.main import main
from companion.errors import NOTHING_TO_ESTIMATE, RecordingError
from companion.evaluation.fleet.file_task import FileTask
from companion.evaluation.fleet.rows import flattened, flight_row
from companion.evaluation.flight_log import gather
from companion.evaluation.pages.flight_report import render
from companion.params.files import load_airframe

_MOST_SAID = 400  # characters of a reason


def work(task: FileTask) -> dict[str, Any]:
    """Result of one file.

    Raises
    ------
    RecordingError
        The command refused the file; its sentence is the reason.
    """
    command = task.words[0]
    row: dict[str, Any] = {"file": str(task.path)}
    return row | (_report(task) if command == "report" else _command(task))


def _report(task: FileTask) -> dict[str, Any]:
    named = dict(zip(task.words[1::2], task.words[2::2], strict=True)).get("--airframe")
    recording = open_recording(task.path, load_airframe(named) if named else None)
    log = gather(recording.records())
    pages = task.folder / "pages"
    pages.mkdir(exist_ok=True)
    (pages / f"{task.key}.html").write_text(render(recording, log), encoding="utf-8")
    return {"page": f"pages/{task.key}.html"} | flight_row(recording, log)


def _command(task: FileTask) -> dict[str, Any]:
    command, *words = task.words
    verbs = ["identify", "flight"] if command == "identify" else [command]
    printed, said = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(said):
        try:
            code = main([*verbs, str(task.path), *words, *_ending(task)])
        except SystemExit as end:  # argparse refused an option
            code = int(end.code or 0)
    if code not in (0, NOTHING_TO_ESTIMATE):
        raise RecordingError(said.getvalue().strip()[-_MOST_SAID:] or f"spanwise {command} ended with {code}")
    try:
        result = json.loads(printed.getvalue())
    except ValueError:
        result = {"result": printed.getvalue().strip()[:_MOST_SAID]}
    return {"code": code} | flattened(result if isinstance(result, dict) else {"results": result})


def _ending(task: FileTask) -> list[str]:
    """Options that make a command give its result as JSON."""
    if task.words[0] == "identify":
        return ["--out", str(task.folder / "pages" / task.key)]
    return ["--json", "-"] if task.words[0] == "diagnose" else ["--json"]

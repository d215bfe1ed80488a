"""``spanwise fleet``: report, diagnose, identify or tune many flights, a process a file, into one table and page.

On an existing Dask cluster with ``--scheduler``; the results are the same.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from companion.adapters.recordings.recording_factory import SUFFIXES, recordings_in
from companion.cli.steps.fleet_tasks import NO_PAGES, work
from companion.cli.steps.numbers import integer
from companion.cli.steps.options import check_output, make_folder
from companion.errors import NOTHING_TO_ESTIMATE, ConfigError, MissingExtra
from companion.evaluation.fleet import page
from companion.evaluation.fleet.campaign import work_off
from companion.evaluation.fleet.cluster import require_dask
from companion.evaluation.fleet.file_task import tasks_of, without_copies
from companion.evaluation.fleet.parquet import write_parquet
from companion.evaluation.fleet.rows import as_csv
from companion.evaluation.fleet.runner import Row
from companion.evaluation.fleet.trends import sentences
from companion.reporting.page import printable
from companion.reporting.plotting import require_report

KINDS = ("report", "diagnose", "identify", "tune")
SOME_FAILED = 1  # exit code of bad input: a script notices, table and page of the other files are written (convention)
_MOST_WORKERS = 256  # more than any machine has use for (choice)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("kind", choices=KINDS, help="what is done with each file, as by the command of this name")
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOGS", help="recordings, and folders of them")
    parser.add_argument("--airframe", metavar="NAME", help="needed for logs that are not our own")
    parser.add_argument("--workers", type=integer(1, _MOST_WORKERS), default=os.cpu_count() or 1, help="processes")
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        default="",
        help="of a Dask cluster, such as tcp://192.168.1.5:8786, in place of processes here (extra fleet); its workers "
        "have this Spanwise, one thread each, logs and --out at the same paths",
    )
    parser.add_argument(
        "--no-pages",
        action="store_true",
        help="report, diagnose: no page for each file, which is most of a report's cost",
    )
    parser.add_argument("--out", type=Path, default=Path("out/fleet"), metavar="FOLDER", help="table, page and parts")


def execute(options: argparse.Namespace) -> int:
    """Process the files that have no result yet, write table and page of all; 1 where one failed, 3 where all did."""
    require_report()
    if options.scheduler:
        require_dask()
    if options.kind == "tune" and options.airframe:
        raise ConfigError("fleet tune: only recordings of Spanwise can be tuned, and they hold their airframe")
    paths, copies = without_copies(_files(options.logs))
    for copy, original in copies:
        print(printable(f"{copy} is a copy of {original}: it counts once"), file=sys.stderr)
    make_folder(options.out)
    check_output(options.out / "fleet.html", "--out")
    check_output(options.out / "fleet.csv", "--out")
    words = (options.kind, *(("--airframe", options.airframe) if options.airframe else ()))
    words += (NO_PAGES,) if options.no_pages else ()
    tasks = tasks_of(paths, words, options.out)
    ordered = work_off(tasks, work, options.workers, options.scheduler, _done)
    tables = _write_tables(ordered, options.out)
    (options.out / "fleet.html").write_text(page.render(options.kind, ordered), encoding="utf-8")
    good = [row for row in ordered if not row.get("failed")]
    for sentence in sentences(good):
        print(f"  {sentence}")
    print(f"{len(good)} of {len(ordered)} files; wrote {options.out / 'fleet.html'}, {tables}")
    if not good:
        return NOTHING_TO_ESTIMATE
    return SOME_FAILED if len(good) < len(ordered) else 0


def _write_tables(rows: list[Row], folder: Path) -> str:
    """Write the rows as CSV and, where its library is installed, as Parquet; say what was written."""
    (folder / "fleet.csv").write_text(as_csv(rows), encoding="utf-8")
    try:
        write_parquet(rows, folder / "fleet.parquet")
    except MissingExtra as absent:
        return f"fleet.csv ({absent})"
    return "fleet.csv, fleet.parquet"


def _files(logs: list[Path]) -> list[Path]:
    files: list[Path] = []
    for path in logs:
        if not path.exists():
            raise ConfigError(f"{path}: no such file or folder")
        files += recordings_in(path) if path.is_dir() else [path]
    if not files:
        kinds = f"{', '.join(SUFFIXES)}, or a folder with accel.csv"
        raise ConfigError(f"no recording ({kinds}) in {', '.join(map(str, logs))}")
    return files


def _done(row: Row) -> str:
    return f"{Path(row['file']).name} done{', though it was cut off' if row.get('cut') else ''}"

"""Landings that an autopilot flies by rigid stereo, by Spanwise and by the true range, in calm and in gusts.

The true range is also flown with one false reading of 0.1 s during the descent, far too long or far too short.

``--write`` puts table and picture into sitl_tests/README.md. What an earlier run left in ``--out`` is not flown again:
begin with an empty folder after a change of the code.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from companion.cli.steps.landing_demo import sentence
from companion.cli.steps.landing_tasks import LandingTask, fly_task, landing_tasks
from companion.evaluation.fleet.campaign import work_off
from companion.evaluation.fleet.runner import stored
from companion.evaluation.landing.landing_rows import RANGE_FINDERS, RangeKind, Row, figures
from companion.evaluation.landing.landing_table import markdown
from companion.evaluation.pages.landing_picture import draw_landings

ROOT = Path(__file__).resolve().parents[2]
PAGE, PICTURE = ROOT / "sitl_tests" / "README.md", ROOT / "sitl_tests" / "landing.png"
_MARKS = ("<!-- landings: begin (generated) -->", "<!-- landings: end -->")
_IMAGES_HZ = 5.0  # of every range finder that has cameras
_SOFT_MPS = 1.5  # sink at touch-down that the gear is asked to take in gusts (choice)


def main(arguments: list[str]) -> int:
    """Fly, print the table; 1 where Spanwise's landings are not those of the true range."""
    parser = argparse.ArgumentParser(prog="landing", description=__doc__)
    parser.add_argument("--flights", type=int, default=10, help="landings of each kind")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes")
    parser.add_argument("--out", type=Path, default=Path("out/bench-landing"), help="where parts are left")
    parser.add_argument("--by", nargs="+", choices=list(RangeKind), default=list(RangeKind), help="range finders")
    parser.add_argument("--only-ready", action="store_true", help="table of what earlier runs left; fly nothing")
    parser.add_argument("--write", action="store_true", help="table and picture into sitl_tests/README.md")
    options = parser.parse_args(arguments)
    tasks = _tasks(options.flights, [RangeKind(kind) for kind in options.by], options.out)
    ready = sum(stored(task) is not None for task in tasks)
    if options.only_ready:
        tasks = [task for task in tasks if stored(task) is not None]
    rows = [row for row in work_off(tasks, fly_task, options.workers, describe=sentence) if not row.get("failed")]
    print(f"{len(rows)} of {len(tasks)} landings, {ready} of them flown by an earlier run; pairs at {_IMAGES_HZ:g} Hz:")
    print("rendered for Spanwise, perfect matches without images for rigid stereo\n")
    print(markdown(rows))
    if options.write:
        write_landings(rows, PICTURE, _MARKS)
    return int(not _spanwise_lands(rows, options.flights))


def _tasks(flights: int, kinds: list[RangeKind], folder: Path) -> list[LandingTask]:
    changes = (f"TRG_RATE={_IMAGES_HZ:g}",)
    seeds = range(1, flights + 1)
    return [task for seed in seeds for task in landing_tasks("nadir-2m", (seed,), kinds, folder, changes)]


def _spanwise_lands(rows: list[Row], flights: int) -> bool:
    """Whether all landings by Spanwise were flown, flared where they should, and met the ground softly."""
    summed = figures([row for row in rows if row["range"] == RangeKind.SPANWISE])
    softly = not len(summed.sink_mps) or float(summed.sink_mps.max()) < _SOFT_MPS
    return summed.landed == 2 * flights and summed.high_flares == summed.no_flare == 0 and softly


def write_landings(rows: list[Row], picture: Path, marks: tuple[str, str]) -> None:
    """Replace the picture, and the block between the marks in sitl_tests/README.md."""
    draw_landings([row for row in rows if row["range"] in RANGE_FINDERS], picture)
    before, begin, rest = PAGE.read_text(encoding="utf-8").partition(marks[0])
    _, end, after = rest.partition(marks[1])
    if not (begin and end):
        raise ValueError(f"{PAGE.name} has no marks {' and '.join(marks)}")
    PAGE.write_text(f"{before}{begin}\n{markdown(rows)}\n{end}{after}", encoding="utf-8")

"""``spanwise demo --landing``: the same landings by four range finders, a table and a picture."""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

from companion.cli.steps.landing_tasks import fly_task, landing_tasks
from companion.cli.terminal.progress import say
from companion.cli.terminal.status_view import console
from companion.errors import NOTHING_TO_ESTIMATE, ConfigError
from companion.evaluation.fleet.campaign import work_off
from companion.evaluation.landing.landing_rows import RANGE_FINDERS, Row
from companion.evaluation.landing.landing_table import HEADS, cells
from companion.evaluation.pages.landing_picture import draw_landings
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.sim.flight.worlds import IDEAL

_SHORT_HEADS = ("air", "range finder", "n", "flare", "high", "none", "sink", "place", "around")  # a terminal is narrow
_ENOUGH = 10  # landings of a kind, as the published tables have (choice)


def land(airframe: Airframe, settings: Settings, options: argparse.Namespace) -> int:
    """Fly ``options.flights`` landings from ``options.seed`` on with each range finder, and show them.

    Raises
    ------
    ConfigError
        The cameras do not look down, or an option belongs to the other flights of the demo.
    """
    if options.realtime or options.live or options.world != IDEAL.name:
        raise ConfigError(
            "demo --landing flies in lock-step in the ideal world: leave out --realtime, --live and --world"
        )
    if not airframe.looks_down:
        raise ConfigError(f"airframe '{airframe.name}' does not look down; a landing needs the range to the ground")
    shutil.rmtree(options.out / "parts", ignore_errors=True)
    seeds = range(options.seed, options.seed + options.flights)
    changes = [f"{name}={value!r}" for name, value in settings.changed().items()]
    tasks = landing_tasks(options.airframe, seeds, RANGE_FINDERS, options.out, changes)
    flown = [row for row in work_off(tasks, fly_task, options.workers, describe=sentence) if not row.get("failed")]
    write_landings(flown, options.out)
    if options.json:
        print((options.out / "landings.json").read_text(encoding="utf-8"), end="")
    else:
        print_table(flown)
    say(f"wrote {options.out / 'landings.json'}" + (f" and {options.out / 'landing.png'}" if flown else ""))
    return 0 if flown else NOTHING_TO_ESTIMATE


def sentence(row: Row) -> str:
    """One landing that was flown, in a line."""
    air = "gusts" if row["gusts"] else "calm"
    text = f"seed {row['seed']}, {air}, {row['range']}: {row['outcome']}"
    if row["flare"] is not None:
        text += f", flare at {row['flare']['height_m']:.1f} m (intended {row['flare']['intended_m']:.1f})"
    if row["touch"] is not None:
        text += f", touch-down at {row['touch']['sink_mps']:.2f} m/s {row['touch']['north_m']:+.0f} m from the point"
    return text + (f" ({row['why']})" if row["why"] else "")


def write_landings(rows: Sequence[Row], folder: Path) -> None:
    """Write rows and picture."""
    (folder / "landings.json").write_text(json.dumps(list(rows)) + "\n", encoding="utf-8")
    if rows:
        draw_landings(rows, folder / "landing.png")


def print_table(rows: Sequence[Row]) -> None:
    """Print the table; medians with the extremes in parentheses, and what its short heads mean."""
    from rich.table import Table  # an extra

    table = Table(title="landings: median (least to most)", title_justify="left")
    for head in _SHORT_HEADS:
        table.add_column(head)
    for row in cells(rows):
        table.add_row(*row)
    console().print(table)
    for short, head in zip(_SHORT_HEADS, HEADS, strict=True):
        if short != head:
            print(f"  {short}: {head}")
    if len({row["seed"] for row in rows}) < _ENOUGH:
        print("  differences between so few landings are chance: --flights 10 shows more")

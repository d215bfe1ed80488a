"""``spanwise paper``: reproduce and audit the paper, table by table and figure by figure, with the code that flies."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path

from companion.cli.steps.numbers import integer
from companion.cli.steps.options import check_output, make_folder
from companion.errors import ConfigError
from companion.paper.report import make_sections, plain, write
from companion.paper.trials import FULL, QUICK, SEEDS
from companion.reporting.plotting import require_report


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--out", type=Path, default=Path("out/paper"), metavar="FOLDER", help="default: out/paper")
    parser.add_argument("--quick", action="store_true", help="shorter experiments, with fewer shots")
    parser.add_argument(
        "--jobs", type=integer(1, 1000), default=os.cpu_count() or 1, metavar="N", help="processes; default: all cores"
    )
    parser.add_argument(
        "--seeds",
        type=_seeds,
        metavar="N,N,...",
        help="of the simulated wings and drives; the first one's experiments are all reported, the others show how far "
        f"booms and wings differ (default: {','.join(map(str, SEEDS))}; with --quick: {SEEDS[0]})",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="the numbers also here; - for standard output")


def execute(options: argparse.Namespace) -> int:
    """Compute everything, write the report, say where it is."""
    require_report()
    check_output(options.json, "--json")
    make_folder(options.out)
    begun_s = time.monotonic()
    pace = QUICK if options.quick else FULL
    sections = make_sections(
        pace,
        options.jobs,
        lambda text: print(f"  {text}", file=sys.stderr, flush=True),
        options.seeds or SEEDS[: 1 if options.quick else None],
    )
    try:
        paths = write(sections, options.out)
        if options.json is not None and str(options.json) != "-":
            options.json.write_text(json.dumps(plain(sections), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"cannot write the report to {error.filename}: {error.strerror}") from error
    if str(options.json) == "-":
        print(json.dumps(plain(sections), indent=1))
        return 0
    for section in sections:
        print(f"{section.title}\n  {section.findings[0]}")
    print(f"\n{sections[0].data['sentence']}")
    print(f"\n{', '.join(str(path) for path in paths)}: written in {time.monotonic() - begun_s:.0f} s")
    return 0


def _seeds(text: str) -> tuple[int, ...]:
    """Seeds as they are given, each once."""
    try:
        seeds = tuple(dict.fromkeys(int(entry) for entry in text.split(",")))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is no list of whole numbers, such as 5,6,7") from None
    if min(seeds) < 0:
        raise argparse.ArgumentTypeError(f"'{text}': a seed is not negative")
    return seeds

"""``spanwise params``: the settings table, and the page generated from it."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

from companion.cli.steps.options import check_ending, check_output
from companion.errors import ConfigError
from companion.params.document import parameters_page
from companion.params.metadata import apm_pdef_xml
from companion.params.settings import tunables
from companion.params.toml import read_text

_PAGE = Path("config/PARAMETERS.md")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    what = parser.add_mutually_exclusive_group()
    what.add_argument("--write", action="store_true", help=f"write {_PAGE}")
    what.add_argument("--check", action="store_true", help=f"fail when {_PAGE} is not what --write would write")
    what.add_argument("--json", action="store_true", help="the table as JSON")
    what.add_argument("--xml", type=Path, metavar="FILE", help="write apm.pdef.xml (MAVProxy: param set_xml_filepath)")


def execute(options: argparse.Namespace) -> int:
    """List, write or check."""
    if options.write:
        check_output(_PAGE, "--write")
        _PAGE.write_text(parameters_page(), encoding="utf-8")
        print(f"wrote {_PAGE}")
    elif options.xml is not None:
        check_output(options.xml, "--xml")
        check_ending(options.xml, "--xml", ".xml")
        options.xml.write_text(apm_pdef_xml(), encoding="utf-8")
        print(f"wrote {options.xml}")
    elif options.check:
        _check()
    elif options.json:
        print(json.dumps([asdict(row) for row in tunables()], indent=2))
    else:
        for row in tunables():
            print(f"{row.name:16s} {row.default:>8g} {row.unit:4s} {row.doc}")
    return 0


def _check() -> None:
    if not _PAGE.is_file():
        raise ConfigError(f"no {_PAGE} here: --check is for a checkout of the sources")
    if read_text(_PAGE) != parameters_page():
        raise ConfigError(f"{_PAGE} is stale: run 'spanwise params --write' and commit it")
    print(f"{_PAGE} is fresh")

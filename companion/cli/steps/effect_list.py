"""The catalogue of effects as a table below ``--help``."""

from __future__ import annotations

import argparse
import textwrap

from companion.core.wing.effect import Effect, Group
from companion.core.wing.effects import catalogue

_WIDTH = 118  # characters of a terminal that is not narrow (choice)
_INDENT = 44  # chosen: characters: name and size of an effect fit before its summary


def add_effect_list(parser: argparse.ArgumentParser, heading: str) -> None:
    """Print every effect of the catalogue below a command's options, by the place where it acts.

    The heading says what the names are good for in this command; its ``{count}`` becomes their number.
    """
    effects = catalogue()
    lines = [*textwrap.wrap(heading.format(count=len(effects)), _WIDTH)]
    for group in Group:
        lines += ["", f"{group}:"]
        lines += [_row(effect) for effect in effects.values() if effect.group is group]
    parser.epilog = "\n".join(lines)


def _row(effect: type[Effect]) -> str:
    first = effect.parameters()[0]
    size = "a recorded channel" if effect.follows_channel else f"{first.sigma:g} {first.unit or 'as a ratio'}"
    summary = (effect.__doc__ or "").splitlines()[0]
    head = f"  {effect.name:22s}{size:{_INDENT - 24}s}"
    return textwrap.fill(head + summary, _WIDTH, subsequent_indent=" " * _INDENT)

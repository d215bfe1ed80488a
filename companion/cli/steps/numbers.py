"""Argument types of numbers: a value outside its range is wrong usage (exit code 2); the message names the range."""

from __future__ import annotations

import argparse
from collections.abc import Callable

_LONGEST_S = 1e6  # chosen: eleven days: beyond it a number is a slip


def number(above: float, most: float, unit: str) -> Callable[[str], float]:
    """A number in this range, the lower end left out; for argparse."""

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{text}' is not a number ({unit})") from None
        if not above < value <= most:
            raise argparse.ArgumentTypeError(f"{text} {unit}: must be above {above:g} and at most {most:g}")
        return value

    return parse


def integer(least: int, most: int) -> Callable[[str], int]:
    """A whole number in this range; for argparse."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError(f"'{text[:40]}' is not a whole number") from None
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{text[:40]}: must be {least} to {most}")
        return value

    return parse


seed = integer(0, 2**31 - 1)
seconds = number(0.0, _LONGEST_S, "seconds")
flight_seconds = number(1.0, _LONGEST_S, "seconds")  # a simulated flight has a beginning and an end

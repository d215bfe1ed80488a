"""Trigger line of a ``--trigger`` option: ``kind:where`` becomes a picklable function that opens it."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable

from companion.adapters.triggers.gpio import GpioTrigger
from companion.adapters.triggers.mavlink import LinkFiring, MavlinkTrigger
from companion.adapters.triggers.oak import OakTrigger, SoftLine
from companion.adapters.triggers.serial_board import SerialBoardTrigger
from companion.errors import ConfigError
from companion.ports import Trigger

SPELLINGS = (
    "none (the cameras run free; the frame nearest the plan is taken)",
    "mavlink (the autopilot's own cameras, IMAGE_START_CAPTURE), mavlink:relay,0 or mavlink:servo,9,1900",
    "serial:/dev/ttyACM0 or serial:/dev/ttyUSB0,115200 (the trigger board)",
    "gpio:/dev/gpiochip0,17 or gpio:/dev/gpiochip0,17,low (libgpiod; low is active low)",
    "oak or oak:41,38 (DepthAI cameras pull their own FSYNC pin, 41; further pins are held high)",
)
_NUMBER = re.compile("[0-9]{1,9}")


def trigger_factory(spelling: str) -> Callable[[], Trigger] | None:
    """Give what opens the trigger, in the trigger process; None where nothing is to be fired.

    Raises
    ------
    ConfigError
        The spelling is none of :data:`SPELLINGS`. What opening raises, the factory raises.
    """
    kind, _, where = spelling.partition(":")
    words = [word.strip() for word in where.split(",")] if where else []
    if spelling == "none":
        return None
    if spelling == "mavlink":
        return MavlinkTrigger
    if spelling == "oak":
        return functools.partial(OakTrigger, SoftLine())
    if kind == "oak" and words and all(_NUMBER.fullmatch(word) for word in words):
        return functools.partial(OakTrigger, SoftLine(tuple(int(word) for word in words)))
    numbers = [int(word) for word in words[1:] if _NUMBER.fullmatch(word)]
    if kind == "mavlink" and (words[:1], len(words), len(numbers)) in ((["relay"], 2, 1), (["servo"], 3, 2)):
        return functools.partial(MavlinkTrigger, LinkFiring(words[0], *numbers))
    if kind == "serial" and len(words) in (1, 2) and len(numbers) == len(words) - 1 and 0 not in numbers:
        return functools.partial(SerialBoardTrigger, words[0], *numbers)
    if kind == "gpio" and len(words) in (2, 3) and _NUMBER.fullmatch(words[1]) and words[2:] in ([], ["low"]):
        return functools.partial(GpioTrigger, words[0], int(words[1]), active_low=words[2:] == ["low"])
    raise ConfigError(f"--trigger {spelling}: not a trigger; known are " + "; ".join(SPELLINGS))

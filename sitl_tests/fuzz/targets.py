"""All targets by name."""

from __future__ import annotations

from collections.abc import Callable

from sitl_tests.fuzz.commands import COMMANDS
from sitl_tests.fuzz.frames import DecoderTarget
from sitl_tests.fuzz.hostile import FlightTarget
from sitl_tests.fuzz.recordings import READERS
from sitl_tests.fuzz.target import Target
from sitl_tests.fuzz.texts import TEXTS

_TARGETS: dict[str, Callable[[], Target]] = {
    "decoder": DecoderTarget,
    "flight": FlightTarget,
    **COMMANDS,
    **READERS,
    **TEXTS,
}
NAMES = tuple(_TARGETS)


def make_target(name: str) -> Target:
    """The target of that name; raises KeyError for another."""
    return _TARGETS[name]()

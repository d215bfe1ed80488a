"""Choices of the person: links, airframe, cameras, trigger, USB ports; what was said is stored, the rest derived."""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.errors import LinkError, SetupError
from companion.params.links import LinkAddress, LinkKind, parse_link
from companion.setup.boards import CompanionBoard
from companion.setup.tree import Tree

_NODE_BAUD = 921600  # carries 1 kHz of a node (tools/wing_node; choice)
_ROUTED = "udpin:127.0.0.1:14550"
# convention: Raspberry Pi OS; it is another UART before the restart of a set-up than after
_ALIAS = "/dev/serial0"
_WORD = re.compile(r"[A-Za-z0-9_./:,+@=-]*")
_ROUTERS = ("usr/bin/mavlink-routerd", "usr/local/bin/mavlink-routerd")


@dataclass(frozen=True, slots=True)
class Choices:
    """Empty ``cameras`` or ``trigger``: none. With ``router`` mavlink-router has the first link, the autopilot's.

    ``program`` is what the service starts, empty where nobody named it.
    """

    links: tuple[str, ...]
    airframe: str = "/etc/spanwise/wing.toml"
    cameras: str = ""
    trigger: str = ""
    serial_left: str = "spanwise-left"
    serial_right: str = "spanwise-right"
    serial_trigger: str = "spanwise-trigger"
    router: bool = False
    program: str = ""

    def takes(self, device: str) -> bool:
        """Whether one of the links is on that device."""
        return any(link.split(",")[0] == device for link in self.links)

    @property
    def listening(self) -> tuple[str, ...]:
        """Links of the service itself."""
        return (_ROUTED, *self.links[1:]) if self.router else self.links


def answered(previous: dict[str, Any], overrides: dict[str, Any]) -> dict[str, Any]:
    """Choices that somebody made: those of now, else those of the last set-up. Nothing that a board suggests."""
    names = {field.name for field in dataclasses.fields(Choices)}
    return {name: value for name, value in {**previous, **overrides}.items() if name in names and value is not None}


def choices_for(board: CompanionBoard, tree: Tree, answers: dict[str, Any]) -> Choices:
    """The choices that somebody made (:func:`answered`), and the board's defaults for the others.

    Raises
    ------
    SetupError
        An answer that no file can hold: a blank, a quote, a link that is not one. And one that the service could not
        use: an airframe file that is not absolute, a Raspberry Pi's UART by its alias.
    """
    nodes = tuple(f"/dev/spanwise-{side},{_NODE_BAUD}" for side in ("left", "right"))
    fitting = Choices(
        (f"{board.uart},{_NODE_BAUD}", *nodes), router=any(tree.entry(name) is not None for name in _ROUTERS)
    )
    choices = dataclasses.replace(fitting, **answers)
    choices = dataclasses.replace(choices, links=tuple(choices.links))  # the manifest and the options have lists
    _check(choices)
    if board.boot_lines and choices.takes(_ALIAS):
        raise SetupError(f"links: {_ALIAS} is not always the UART of pins 8 and 10; give {board.uart}")
    return choices


def _check(choices: Choices) -> None:
    for name, value in dataclasses.asdict(choices).items():
        for word in value if isinstance(value, tuple) else (value,):
            if isinstance(word, str) and not _WORD.fullmatch(word):
                raise SetupError(f"{name} '{word}': letters, digits and _ . / : , + @ = - alone (no blanks, no quotes)")
    serials = [number for number in (choices.serial_left, choices.serial_right, choices.serial_trigger) if number]
    if len(set(serials)) < len(serials):
        raise SetupError(f"serial numbers {', '.join(serials)}: two adapters cannot have the same")
    if not choices.links:
        raise SetupError("links: give one at least")
    if not choices.airframe:
        raise SetupError("airframe: give a name, or the path of a file")
    if Path(choices.airframe).suffix and not Path(choices.airframe).is_absolute():
        raise SetupError(
            f"airframe '{choices.airframe}': the service starts in /; give the whole path, as /etc/spanwise/wing.toml"
        )
    try:
        addresses = [parse_link(link) for link in choices.links]
        heard = [parse_link(link) for link in choices.listening]
    except LinkError as error:
        raise SetupError(str(error)) from error
    if choices.router and addresses[0].kind is not LinkKind.SERIAL:
        raise SetupError(
            f"links: mavlink-router needs the autopilot's serial device first, not {choices.links[0]}; or --no-router"
        )
    for ends in (addresses, heard):
        _refuse_twice(ends)


def _refuse_twice(addresses: list[LinkAddress]) -> None:
    places = [address.host if address.kind is LinkKind.SERIAL else str(address) for address in addresses]
    for number, place in enumerate(places):
        if place in places[:number]:
            raise SetupError(f"links: {place} is there twice; each link needs a place of its own")

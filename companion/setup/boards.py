"""The companions that are known: where their UART is, and what else has it."""

from __future__ import annotations

from dataclasses import dataclass

from companion.errors import SetupError
from companion.setup.tree import Tree

_MODEL = "proc/device-tree/model"
_WANTS = "etc/systemd/system/multi-user.target.wants"
CONSOLE = r"console=(?:serial0|ttyAMA0|ttyS0)[^\s]*"
"""Words of the kernel's command line that open a console on the header's UART."""


@dataclass(frozen=True, slots=True)
class CompanionBoard:
    """A kind of companion.

    ``uart`` is the device to which the autopilot is wired, ``boot_lines`` lay it on the header's pins 8 and 10
    (``config.txt``). ``console`` is a pattern of the words of ``cmdline.txt`` that give it to a console, empty where
    there is no such file; ``other_services`` are links that start another service on it.
    """

    key: str
    name: str
    uart: str
    boot_lines: tuple[str, ...] = ()
    console: str = ""
    other_services: tuple[str, ...] = ()


BOARDS = (
    # its good UART serves Bluetooth, and the header has one whose rate follows the core's
    CompanionBoard(
        "pi4", "Raspberry Pi 4", "/dev/ttyAMA0", ("enable_uart=1", "dtoverlay=disable-bt"), CONSOLE,
        (f"{_WANTS}/hciuart.service",),
    ),
    # Bluetooth has one of its own; the first is the debug connector's unless the header's is asked for
    CompanionBoard("pi5", "Raspberry Pi 5", "/dev/ttyAMA0", ("enable_uart=1", "dtparam=uart0=on"), CONSOLE),
    CompanionBoard("jetson", "Jetson", "/dev/ttyTHS1", other_services=(f"{_WANTS}/nvgetty.service",)),
    CompanionBoard("plain", "a Linux computer", "/dev/ttyACM0"),
)  # fmt: skip
_WORDS = {"pi4": ("Raspberry Pi 4", "Raspberry Pi Compute Module 4"), "pi5": ("Raspberry Pi 5", "Compute Module 5"),
          "jetson": ("Jetson", "NVIDIA")}  # fmt: skip


def model(tree: Tree) -> str:
    """Model name from the device tree; empty where there is none."""
    return (tree.text(_MODEL) or "").rstrip("\0").strip()


def board_of(tree: Tree, named: str | None = None) -> CompanionBoard:
    """The board by its name, or by what the tree says of itself.

    Raises
    ------
    SetupError
        No board of that name.
    """
    by_key = {board.key: board for board in BOARDS}
    if named is not None:
        if named not in by_key:
            raise SetupError(f"no board '{named}'; known: {', '.join(by_key)}")
        return by_key[named]
    said = model(tree)
    fitting = [key for key, words in _WORDS.items() if any(word in said for word in words)]
    return by_key[fitting[0] if fitting else "plain"]


def boot_file(tree: Tree, name: str) -> str | None:
    """``config.txt`` or ``cmdline.txt``: in ``boot/firmware`` since Raspberry Pi OS 12, in ``boot`` before."""
    for folder in ("boot/firmware", "boot"):
        if tree.entry(f"{folder}/{name}") is not None:
            return f"{folder}/{name}"
    return None

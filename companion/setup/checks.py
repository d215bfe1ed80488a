"""Checks of the machine, each with the figure that it measured."""

from __future__ import annotations

import os
import platform
import re
import shutil
import stat
from dataclasses import dataclass
from pathlib import Path

from companion.setup.boards import CompanionBoard, model
from companion.setup.tree import Tree

GROUPS = ("dialout", "gpio", "video", "plugdev")
_PYTHON = (3, 11)  # convention: the oldest that the package takes (pyproject.toml)
_DISK_GB = 2.0  # a flight's recordings, for a start (choice)
_PRIVATE = ("/tmp", "/var/tmp")  # by definition of PrivateTmp in config/system/spanwise.service
_READABLE = "put it where every user may read, as /etc/spanwise/wing.toml, and name that with --airframe"
_MEMORY_GB = 1.5  # the service with its reserve, beside the system (choice)


@dataclass(frozen=True, slots=True)
class SystemCheck:
    """One line: what, the figure, and where something is to be mended, what to do."""

    name: str
    figure: str
    remedy: str = ""

    @property
    def passes(self) -> bool:
        """Whether nothing is to be done."""
        return not self.remedy


def checks(tree: Tree, board: CompanionBoard, program: str, person: str) -> list[SystemCheck]:
    """All of them; ``person`` is the user who works at the machine, empty where nobody is meant."""
    return [_board(tree, board), _python(), _disk(tree), _memory(tree), _groups(tree, person), _program(tree, program)]


def airframe_check(tree: Tree, airframe: str) -> SystemCheck:
    """Whether the service's own user can read the airframe; a file of it may be made later."""
    if not Path(airframe).suffix:
        return SystemCheck("airframe", f"{airframe}, one that is supplied")
    if any(Path(airframe).is_relative_to(folder) for folder in _PRIVATE):
        figure = f"{airframe}: the service has folders of its own in the place of {' and '.join(_PRIVATE)}"
        return SystemCheck("airframe", figure, _READABLE)
    path = tree.root / airframe.lstrip("/")
    inside = [*reversed(path.parents), *reversed(path.resolve().parents), path]
    for place in (place for place in inside if place.is_relative_to(tree.root)):
        if not place.exists():
            return SystemCheck("airframe", f"{airframe}: not there yet")
        if not (_is_open(place) if place.is_dir() else place.stat().st_mode & stat.S_IROTH):
            return SystemCheck("airframe", f"{airframe}: {place} is closed to other users", _READABLE)
    return SystemCheck("airframe", airframe)


def groups_there(tree: Tree) -> list[str]:
    """Those of :data:`GROUPS` that the tree has."""
    return [name for name in GROUPS if name in _groups_of(tree)]


def _board(tree: Tree, board: CompanionBoard) -> SystemCheck:
    """Kind and UART; a running system has devices, and may not have this one before a restart or without a cable."""
    said = model(tree)
    figure = f"{said or board.name}, UART {board.uart}" + (f", as {board.name}" if said else "")
    if tree.path("dev/null").exists() and not tree.path(board.uart.lstrip("/")).exists():
        figure += " (not there now; --link names another)"
    return SystemCheck("board", figure)


def _python() -> SystemCheck:
    wanted = ".".join(map(str, _PYTHON))
    figure = f"{platform.python_version()} ({wanted} or newer)"
    enough = tuple(map(int, platform.python_version_tuple()[:2])) >= _PYTHON
    return SystemCheck("python", figure, "" if enough else f"install Python {wanted}")


def _disk(tree: Tree) -> SystemCheck:
    free_gb = shutil.disk_usage(tree.root).free / 1e9
    remedy = "" if free_gb >= _DISK_GB else "make room: recordings need it"
    return SystemCheck("disk", f"{free_gb:.1f} GB free ({_DISK_GB:g} GB wanted)", remedy)


def _memory(tree: Tree) -> SystemCheck:
    match = re.search(r"^MemTotal:\s+(\d+) kB", tree.text("proc/meminfo") or "", re.MULTILINE)
    if match is None:
        return SystemCheck("memory", "not told by this tree")
    memory_gb = int(match[1]) * 1024 / 1e9
    remedy = "" if memory_gb >= _MEMORY_GB else "a board with 2 GB or more, or --no-standby in /etc/default/spanwise"
    return SystemCheck("memory", f"{memory_gb:.1f} GB ({_MEMORY_GB:g} GB wanted)", remedy)


def _groups_of(tree: Tree) -> dict[str, list[str]]:
    """Members by group."""
    rows = [line.split(":") for line in (tree.text("etc/group") or "").splitlines()]
    return {row[0]: [member for member in row[3].split(",") if member] for row in rows if len(row) == 4}


def _groups(tree: Tree, person: str) -> SystemCheck:
    members = _groups_of(tree)
    existing = groups_there(tree)
    absent = [name for name in GROUPS if name not in existing]
    if absent:
        add = " && ".join(f"sudo groupadd --system {name}" for name in absent)
        return SystemCheck(
            "groups", f"{len(existing)} of {len(GROUPS)} exist, not {', '.join(absent)}", f"{add}, then again"
        )
    outside = [name for name in existing if person and person not in members[name]]
    figure = f"{', '.join(existing)}: all exist"
    if outside:
        remedy = f"sudo usermod -aG {','.join(outside)} {person}, then log in again"
        return SystemCheck(
            "groups", f"{figure}, {person} is in {len(existing) - len(outside)} of {len(existing)}", remedy
        )
    return SystemCheck("groups", figure)


def _program(tree: Tree, program: str) -> SystemCheck:
    """The service runs as a user of its own, who must reach the program."""
    path = tree.root / program.lstrip("/").split(" ")[0]
    if not os.access(path, os.X_OK):
        return SystemCheck("program", f"{program}: not there", "install Spanwise there, or give --program")
    resolved = [path, *path.parents, *path.resolve().parents]
    closed = [folder for folder in resolved if folder.is_relative_to(tree.root) and not _is_open(folder)]
    if closed:
        remedy = "install it where every user may read, as in /opt/spanwise, and run setup from there"
        return SystemCheck("program", f"{program}: {closed[-1]} is closed to other users", remedy)
    return SystemCheck("program", program)


def _is_open(path: Path) -> bool:
    return bool(path.stat().st_mode & stat.S_IXOTH)

"""The cameras and the trigger line of ``spanwise vehicle``, by the folder that it was given: ``sim:FOLDER``."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

from companion.errors import ConfigError
from companion.ports import CameraPair, Trigger
from companion.sim.vision.cameras import SimCameraPair, SimTriggerLine

PREFIX = "sim:"
SPELLING = "sim:FOLDER (the simulated pair of spanwise vehicle --cameras FOLDER)"


def line_path(folder: Path) -> Path:
    """The local socket that takes trigger pulses."""
    return folder / "line"


def frames_path(folder: Path) -> Path:
    """The local socket that gives images."""
    return folder / "frames"


def simulated_cameras(spelling: str) -> Callable[[], CameraPair] | None:
    """The factory of a simulated pair, None where another kind is spelled."""
    folder = _folder("--cameras", spelling)
    return None if folder is None else functools.partial(SimCameraPair, frames_path(folder))


def simulated_trigger(spelling: str) -> Callable[[], Trigger] | None:
    """The factory of its trigger line, None where another kind is spelled."""
    folder = _folder("--trigger", spelling)
    return None if folder is None else functools.partial(SimTriggerLine, line_path(folder))


def opens_at_take_off(factory: Callable[[], object]) -> bool:
    """Whether a device is absent until the simulated vehicle flies, so that it cannot be tried beforehand."""
    return isinstance(factory, functools.partial) and factory.func is SimCameraPair


def _folder(option: str, spelling: str) -> Path | None:
    if not spelling.startswith(PREFIX):
        return None
    folder = Path(spelling.removeprefix(PREFIX))
    if not folder.is_dir():
        raise ConfigError(f"{option} {spelling}: no folder {folder}; start spanwise vehicle --cameras {folder} first")
    return folder

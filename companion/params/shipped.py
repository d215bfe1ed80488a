"""Paths of the files that travel with Spanwise: airframes and mappings."""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path


def shipped(folder: str) -> Traversable:
    """A folder of the configuration: inside the package as installed, beside it in a checkout."""
    package = resources.files("companion")
    inside = package / "config" / folder
    return inside if inside.is_dir() or not isinstance(package, Path) else package.parent / "config" / folder

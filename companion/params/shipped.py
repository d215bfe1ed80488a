"""The files that travel with Spanwise, airframes and mappings, and others like them by their path."""

from __future__ import annotations

from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from companion.params.toml import read_text


def shipped(folder: str) -> Traversable:
    """A folder of the configuration: inside the package as installed, beside it in a checkout."""
    package = resources.files("companion")
    inside = package / "config" / folder
    return inside if inside.is_dir() or not isinstance(package, Path) else package.parent / "config" / folder


def shipped_names(folder: str) -> list[str]:
    """Names of the ``.toml`` files in a folder of the configuration."""
    return sorted(
        entry.name.removesuffix(".toml") for entry in shipped(folder).iterdir() if entry.name.endswith(".toml")
    )


def read_shipped(folder: str, name_or_path: str) -> tuple[str, str] | None:
    """Text and origin of the shipped file of this name, or of the ``.toml`` file at a path; None for no file."""
    if name_or_path.endswith(".toml"):
        path = Path(name_or_path)
        return (read_text(path), str(path)) if path.is_file() else None
    if name_or_path not in shipped_names(folder):
        return None
    entry = shipped(folder) / f"{name_or_path}.toml"
    return entry.read_text(encoding="utf-8"), entry.name

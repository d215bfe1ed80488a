"""The record of a set-up, stored in the tree: each name with its content before and after, by which all is put back."""

from __future__ import annotations

import base64
import binascii
import json
from dataclasses import dataclass, field
from typing import Any

from companion.errors import SetupError
from companion.setup.tree import Entry, File, Symlink, Tree

NAME = "var/lib/spanwise-setup/manifest.json"
_FORMAT = 1  # version of the manifest (convention)


@dataclass(frozen=True, slots=True)
class Done:
    """One name: what it held before the first set-up, and what the last one left."""

    before: Entry | None
    after: Entry | None


@dataclass(frozen=True, slots=True)
class Manifest:
    """``done`` by name, ``folders`` that were made (outermost first), and what somebody answered."""

    done: dict[str, Done] = field(default_factory=dict)
    folders: tuple[str, ...] = ()
    choices: dict[str, Any] = field(default_factory=dict)
    board: str = ""


def load(tree: Tree) -> Manifest | None:
    """Give the tree's manifest; None where nothing was set up.

    Raises
    ------
    SetupError
        It cannot be read, is damaged, or is of a newer version.
    """
    entry = tree.entry(NAME)
    if entry is None:
        return None
    try:
        if not isinstance(entry, File):
            raise ValueError("a link")
        said = json.loads(entry.data)
        if said["format"] > _FORMAT:
            raise SetupError(f"{tree.root / NAME}: written by a newer Spanwise; update")
        done = {name: Done(_entry(record["before"]), _entry(record["after"])) for name, record in said["done"].items()}
        return Manifest(done, tuple(said["folders"]), dict(said["answers"]), str(said["board"]))
    except (ValueError, KeyError, TypeError, AttributeError, binascii.Error) as error:
        raise SetupError(f"{tree.root / NAME}: damaged ({error!r}); nothing is changed") from error


def as_file(manifest: Manifest) -> File:
    """The manifest's file, readable by root alone: a file of before may have been secret."""
    said = {
        "format": _FORMAT,
        "board": manifest.board,
        "answers": manifest.choices,
        "folders": list(manifest.folders),
        "done": {
            name: {"before": _said(record.before), "after": _said(record.after)}
            for name, record in manifest.done.items()
        },
    }
    return File(json.dumps(said, indent=1, sort_keys=True).encode() + b"\n", 0o600)


def _said(entry: Entry | None) -> dict[str, Any] | None:
    if isinstance(entry, Symlink):
        return {"link": entry.target}
    return None if entry is None else {"file": base64.b64encode(entry.data).decode(), "mode": entry.mode}


def _entry(said: dict[str, Any] | None) -> Entry | None:
    if said is None:
        return None
    if "link" in said:
        return Symlink(str(said["link"]))
    return File(base64.b64decode(said["file"], validate=True), said["mode"])

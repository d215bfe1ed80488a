"""Doing it, whole or not at all: the manifest first, then each change; what fails in the middle is taken back."""

from __future__ import annotations

import contextlib
from typing import Any

from companion.errors import SetupError
from companion.setup import manifest
from companion.setup.manifest import Manifest
from companion.setup.plan import UNIT, Change, put_back
from companion.setup.tree import Entry, Symlink, Tree

_ENABLED = "etc/systemd/system/multi-user.target.wants/spanwise.service"
_LEFT_BEHIND = (
    "etc/spanwise", f"{UNIT}.d", "var/lib/spanwise", "var/lib/private/spanwise", "var/cache/spanwise",
    "var/cache/private/spanwise",
)  # fmt: skip


def recorded(tree: Tree, changes: list[Change], previous: Manifest, answers: dict[str, Any], board: str) -> Manifest:
    """The manifest as it is after these changes.

    ``answers`` and the key of the ``board`` are what somebody said; all else is derived anew each time.
    """
    done = {change.name: change.done for change in changes if change.done is not None}
    written = [change.name for change in changes if change.changes and change.then is not None]
    made = [folder for name in [*written, manifest.NAME] for folder in tree.missing_folders(name)]
    folders = tuple(dict.fromkeys((*previous.folders, *made)))
    return Manifest(done, folders, answers, board)


def install(tree: Tree, changes: list[Change], after: Manifest) -> None:
    """Make the changes and write the manifest; where neither changes anything, nothing is written.

    Raises
    ------
    SetupError
        Something cannot be written; the tree is as before then, or the sentence says how to get there.
    """
    file = manifest.as_file(after)
    steps = [(change.name, change.then) for change in changes if change.changes]
    now = tree.entry(manifest.NAME)
    _all_or_nothing(tree, [*([] if file.same(now) else [(manifest.NAME, file)]), *steps])


def undone(tree: Tree, previous: Manifest) -> list[Change]:
    """The changes that put the tree back to before the first set-up; they disable the service too."""
    changes = [change for name, done in reversed(previous.done.items()) for change in put_back(tree, name, done)]
    enabled = tree.entry(_ENABLED)
    if isinstance(enabled, Symlink) and UNIT in previous.done:
        changes.append(Change(_ENABLED, enabled, None, "remove", None, "it was enabled"))
    return changes


def undo(tree: Tree, changes: list[Change], previous: Manifest) -> list[str]:
    """Put all back; give folders of the service that stay because they hold what is not ours.

    Raises
    ------
    SetupError
        As :func:`install`.
    """
    steps: list[tuple[str, Entry | None]] = [(change.name, change.then) for change in changes if change.changes]
    _all_or_nothing(tree, [*steps, (manifest.NAME, None)])
    for folder in reversed(previous.folders):
        tree.drop_folder(folder)
    return [name for name in _LEFT_BEHIND if (tree.root / name).exists()]


def _all_or_nothing(tree: Tree, steps: list[tuple[str, Entry | None]]) -> None:
    before: list[tuple[str, Entry | None]] = []
    made: list[str] = []
    try:
        for name, entry in steps:
            for folder in tree.missing_folders(name) if entry is not None else []:
                tree.make_folder(folder)
                made.append(folder)
            now = tree.entry(name)
            tree.put(name, entry)
            before.append((name, now))
    except BaseException:
        _take_back(tree, before, made)
        raise


def _take_back(tree: Tree, before: list[tuple[str, Entry | None]], made: list[str]) -> None:
    """The manifest was written first and goes last: where another cannot be put back, it stays for ``--undo``."""
    with contextlib.suppress(SetupError):
        for name, entry in reversed(before):
            tree.put(name, entry)
    for folder in reversed(made):
        tree.drop_folder(folder)

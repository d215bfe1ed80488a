"""The changes of a set-up: each name of the tree with its present and its wanted content, and in a word why."""

from __future__ import annotations

import re
from dataclasses import dataclass

from companion.params.links import parse_link
from companion.params.shipped import shipped
from companion.setup import boards
from companion.setup.boards import CompanionBoard
from companion.setup.checks import groups_there
from companion.setup.choices import Choices
from companion.setup.edits import Edit, block, without_words
from companion.setup.manifest import Done, Manifest
from companion.setup.tree import Entry, File, Tree, same

UNIT = "etc/systemd/system/spanwise.service"
DEFAULTS = "etc/default/spanwise"
RULES = "etc/udev/rules.d/80-spanwise.rules"
BUFFERS = "etc/sysctl.d/80-spanwise.conf"
ROUTER = "etc/mavlink-router/main.conf"
ROUTER_UNIT = "etc/systemd/system/mavlink-router.service.d/spanwise.conf"
BESIDE, SAVED = ".spanwise-new", ".spanwise-saved"
_MARK = re.compile(r"@([A-Z_]+)@")


@dataclass(frozen=True, slots=True)
class Change:
    """One name; ``done`` is what the manifest will say of it, None where it stays as it is without us."""

    name: str
    now: Entry | None
    then: Entry | None
    word: str
    done: Done | None
    note: str = ""

    @property
    def changes(self) -> bool:
        """Whether anything is written."""
        return not same(self.now, self.then)


def planned(tree: Tree, board: CompanionBoard, choices: Choices, program: str, previous: Manifest) -> list[Change]:
    """All changes of a set-up, in their order, those that change nothing too; what it no longer needs is put back."""
    files = _files(tree, board, choices, program)
    changes = [change for name, data in files.items() for change in _written(tree, name, data, previous)]
    if choices.takes(board.uart):
        changes += [_edited(tree, name, edit, previous) for name, edit in edits_of(tree, board).items()]
        changes += [_unlinked(tree, name, previous) for name in board.other_services]
    wanted = {change.name for change in changes}
    unused = [(name, done) for name, done in previous.done.items() if name not in wanted]
    return changes + [change for name, done in unused for change in put_back(tree, name, done)]


def edits_of(tree: Tree, board: CompanionBoard) -> dict[str, Edit]:
    """Files of the boot partition, with what is changed in them."""
    edits = {}
    config, words = boards.boot_file(tree, "config.txt"), boards.boot_file(tree, "cmdline.txt")
    if board.boot_lines and config is not None:
        edits[config] = block(board.boot_lines)
    if board.console and words is not None:
        edits[words] = without_words(board.console, "no console on the UART")
    return edits


def put_back(tree: Tree, name: str, done: Done) -> list[Change]:
    """Have a name hold what it held before; what the person has changed since is kept, out of the way of the system."""
    now = tree.entry(name)
    if same(now, done.before):
        return [Change(name, now, now, "keep", None, "as before")]
    if same(now, done.after) or now is None:
        return [Change(name, now, done.before, "remove" if done.before is None else "restore", None)]
    if isinstance(now, File) and isinstance(done.before, File):
        edit = block(()) if name.endswith("config.txt") else without_words(boards.CONSOLE, "")
        text = edit.backward(_text(now), _text(done.before))
        return [Change(name, now, _file(text, now), "restore", None, "with what you changed since")]
    if done.before is not None:
        return [Change(name, now, now, "keep", None, "changed since")]
    saved = f"{name}{SAVED}"
    return [
        Change(saved, tree.entry(saved), now, "write", None, "what you had changed"),
        Change(name, now, None, "remove", None),
    ]


def _files(tree: Tree, board: CompanionBoard, choices: Choices, program: str) -> dict[str, bytes]:
    """Files that are ours in full, rendered."""
    existing = groups_there(tree)
    values = {
        "BOARD": board.name,
        "PROGRAM": program,
        "GROUPS": " ".join(existing),
        "LINKS": " ".join(f"--connect {link}" for link in choices.listening),
        "AIRFRAME": choices.airframe,
        "CAMERAS": f"--cameras {choices.cameras}" if choices.cameras else "",
        "TRIGGER": f"--trigger {choices.trigger}" if choices.trigger else "",
        "SERIAL_LEFT": choices.serial_left,
        "SERIAL_RIGHT": choices.serial_right,
        "SERIAL_TRIGGER": choices.serial_trigger,
    }
    files = {
        UNIT: _rendered("spanwise.service", values),
        DEFAULTS: _rendered("spanwise.default", values),
        RULES: _known_groups(_rendered("80-spanwise.rules", values), existing),
        BUFFERS: _rendered("spanwise.sysctl", values),
    }
    if choices.router:
        files[ROUTER] = _rendered("mavlink-router.conf", values | {"AUTOPILOT": _autopilot(choices)})
        files[ROUTER_UNIT] = _rendered("mavlink-router.service.conf", values)
    return {name: text.encode() for name, text in files.items()}


def _rendered(template: str, values: dict[str, str]) -> str:
    """Fill the marks; a paragraph with a mark that has no value is left out."""
    text = (shipped("system") / template).read_text(encoding="utf-8")
    paragraphs = [paragraph for paragraph in text.split("\n\n") if set(_MARK.findall(paragraph)) <= values.keys()]
    return _MARK.sub(lambda mark: values[mark[1]], "\n\n".join(paragraphs))


def _known_groups(rules: str, existing: list[str]) -> str:
    """Rules of groups that the tree has: udev would give the others' devices to root alone."""
    absent = [f'GROUP="{group}"' for group in ("dialout", "gpio", "plugdev") if group not in existing]
    return "".join(f"{line}\n" for line in rules.splitlines() if not any(word in line for word in absent))


def _autopilot(choices: Choices) -> str:
    """Device and rate of the autopilot, as mavlink-router has them."""
    link = parse_link(choices.links[0])
    return f"Device = {link.host}\nBaud = {link.port}"


def _written(tree: Tree, name: str, data: bytes, previous: Manifest) -> list[Change]:
    """Write a file of ours; one that the person has changed, or had before, stays, and ours lies beside it."""
    now, done = tree.entry(name), previous.done.get(name)
    then = File(data)
    if now is None or (done is not None and same(now, done.after)):
        word = "write" if now is None else "keep" if same(now, then) else "update"
        return [Change(name, now, then, word, Done(None, then))]
    if same(now, then):
        return [Change(name, now, now, "keep", done)]
    unchanged = Change(name, now, now, "keep", done, "yours")
    if done is not None and same(done.after, then):
        return [unchanged]
    beside = f"{name}{BESIDE}"
    lies = tree.entry(beside)
    word = "keep" if same(lies, then) else "write"
    return [
        unchanged,
        Change(beside, lies, then, word, Done(None, then), f"ours, beside your {name.rsplit('/', 1)[1]}"),
    ]


def _edited(tree: Tree, name: str, edit: Edit, previous: Manifest) -> Change:
    now, done = tree.entry(name), previous.done.get(name)
    if not isinstance(now, File):
        return Change(name, now, now, "keep", None, "a link: edit it yourself")
    then = _file(edit.forward(_text(now)), now)
    if same(now, then):
        return Change(name, now, now, "keep", done)
    return Change(name, now, then, "edit", Done(done.before if done is not None else now, then), edit.note)


def _unlinked(tree: Tree, name: str, previous: Manifest) -> Change:
    now, done = tree.entry(name), previous.done.get(name)
    if now is None:
        return Change(name, None, None, "keep", done)
    return Change(name, now, None, "disable", Done(now, None), "it holds the UART")


def _text(file: File) -> str:
    """The text of a file that may hold anything; :meth:`str.encode` with the same handler gives its bytes back."""
    return file.data.decode(errors="surrogateescape")


def _file(text: str, like: File) -> File:
    return File(text.encode(errors="surrogateescape"), like.mode)

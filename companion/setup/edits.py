"""Edits of files that others own, each with its way back: a marked block, words of the kernel's command line."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

_BEGIN, _END = "# spanwise setup: begin", "# spanwise setup: end"
_BLOCK = re.compile(rf"^{_BEGIN}\r?\n.*?^{_END}(?:\r?\n|\Z)", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True, slots=True)
class Edit:
    """``forward`` makes the change and leaves a text that has it alone.

    ``backward`` takes it out of a text that was changed since; it is given that text and the one before the edit.
    """

    forward: Callable[[str], str]
    backward: Callable[[str, str], str]
    note: str


def block(lines: Sequence[str]) -> Edit:
    """Lines for every board (``[all]``) at the end of the Raspberry Pi's ``config.txt``, between two marks."""
    body = "".join(f"{line}\n" for line in (_BEGIN, "[all]", *lines, _END))

    def forward(text: str) -> str:
        rest = _without_block(text, text)
        return f"{rest}{'' if not rest or rest.endswith(chr(10)) else chr(10)}{body}"

    return Edit(forward, _without_block, ", ".join(lines))


def _without_block(text: str, _before: str) -> str:
    return _BLOCK.sub("", text)


def without_words(pattern: str, note: str) -> Edit:
    """Take the words of a pattern out of ``cmdline.txt``, one line of words with blanks between."""
    word = re.compile(rf"(?:^|(?<=\s)){pattern}(?:[ \t]+|(?=\s|$))", re.MULTILINE)

    def forward(text: str) -> str:
        return word.sub("", text)

    def backward(text: str, before: str) -> str:
        removed = [match.strip() for match in word.findall(before)]
        return "".join(f"{removed_word} " for removed_word in removed if removed_word not in text.split()) + text

    return Edit(forward, backward, note)

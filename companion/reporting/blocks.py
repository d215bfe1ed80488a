"""Blocks of a report: what a page consists of, as data; the templates alone know HTML."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class Heading:
    """Title of a section; a ``key`` makes it an anchor of the table of contents, a ``warning`` colours it."""

    kind: ClassVar[str] = "heading"
    text: str
    key: str = ""
    level: int = 2
    warning: bool = False


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Sentence of explanation."""

    kind: ClassVar[str] = "paragraph"
    text: str


@dataclass(frozen=True, slots=True)
class Advice:
    """Recommended action, set apart."""

    kind: ClassVar[str] = "advice"
    text: str


@dataclass(frozen=True, slots=True)
class Findings:
    """List of sentences, the most important first."""

    kind: ClassVar[str] = "findings"
    sentences: Sequence[str]


@dataclass(frozen=True, slots=True)
class Answers:
    """Questions that a reader has first, each with its answer."""

    kind: ClassVar[str] = "answers"
    pairs: Sequence[tuple[str, str]]


@dataclass(frozen=True, slots=True)
class Table:
    """Table of ready cells; columns of numbers are set right, a cell ``failed`` and the row ``worst`` stand out.

    ``links`` has for each row where its first cell leads, "" for nowhere.
    """

    kind: ClassVar[str] = "table"
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]
    worst: int | None = None
    title: str = ""
    note: str = ""
    links: Sequence[str] = ()


@dataclass(frozen=True, slots=True)
class Picture:
    """Image inside the page: its data URI, a ``text`` for those who cannot see it, and a caption beneath it.

    Narrower than ``readable_px`` its lettering could not be read: a page that has no room for it scrolls it sideways.
    """

    kind: ClassVar[str] = "picture"
    source: str
    text: str
    caption: str = ""
    readable_px: int = 0


@dataclass(frozen=True, slots=True)
class Details:
    """Block that is folded under its title."""

    kind: ClassVar[str] = "details"
    title: str
    content: Table


Block = Heading | Paragraph | Advice | Findings | Answers | Table | Picture | Details


@dataclass(frozen=True, slots=True)
class Page:
    """Self-contained page.

    ``title`` is of the browser's window, ``headline`` the first line (the verdict where there is one), ``subject`` the
    recording, airframe or paper. ``grade`` is the style sheet's class that colours the headline, "" for a plain one;
    with ``contents`` a list of the sections comes first.
    """

    title: str
    headline: str
    body: Sequence[Block]
    subject: str = ""
    grade: str = ""
    contents: bool = False

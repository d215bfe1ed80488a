"""Requests and answers of HTTP/1.1, as few of them as a page, its websocket and its downloads need."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, unquote, urlsplit

MOST_HEAD_BYTES = 16_384  # bound of memory: browsers' heads have some kilobytes
MOST_BODY_BYTES = 4_096  # bound of memory: the page's own changes have some hundred bytes
_SECURITY = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
    "connect-src 'self' ws: wss:; frame-ancestors 'self'",
    "Cache-Control": "no-store",
}


@dataclass(frozen=True, slots=True)
class Request:
    """Head of a request, names of headers in lower case, and its body."""

    method: str
    target: str
    headers: dict[str, str]
    body: bytes = b""

    @property
    def path(self) -> str:
        """Path without the query."""
        return unquote(urlsplit(self.target).path)

    @property
    def query(self) -> dict[str, str]:
        """Values of the query, by name."""
        return dict(parse_qsl(urlsplit(self.target).query))

    @property
    def cookies(self) -> dict[str, str]:
        """Values of the cookies, by name."""
        pairs = (text.strip().partition("=") for text in self.headers.get("cookie", "").split(";"))
        return {name: value for name, _, value in pairs}

    @property
    def is_websocket(self) -> bool:
        """Whether a websocket is asked for."""
        return self.headers.get("upgrade", "").lower() == "websocket"


@dataclass(frozen=True, slots=True)
class HttpAnswer:
    """Answer to a request; ``file`` is sent in place of the body where there is one."""

    status: HTTPStatus
    body: bytes = b""
    content_type: str = "text/plain; charset=utf-8"
    headers: dict[str, str] = field(default_factory=dict)
    file: Path | None = None

    def head(self, length: int) -> bytes:
        """Status line and headers."""
        lines = {"Content-Type": self.content_type, "Content-Length": str(length), "Connection": "close"}
        every = lines | _SECURITY | self.headers
        text = "".join(f"{name}: {value}\r\n" for name, value in every.items())
        return f"HTTP/1.1 {self.status.value} {self.status.phrase}\r\n{text}\r\n".encode("latin-1")


def parse_head(head: bytes) -> Request | None:
    """Read the head of a request; None where it is none."""
    first, *lines = head.decode("latin-1").rstrip("\r\n").split("\r\n")
    words = first.split(" ")
    if len(words) != 3 or not words[2].startswith("HTTP/1.") or not words[1].startswith("/"):
        return None
    headers: dict[str, str] = {}
    for line in lines:
        name, colon, value = line.partition(":")
        if not colon or name != name.strip():
            return None
        headers[name.lower()] = value.strip()
    try:
        urlsplit(words[1])
        urlsplit(f"//{headers.get('host', '')}")
        urlsplit(headers.get("origin", ""))
    except ValueError:  # of addresses that are none
        return None
    return Request(words[0], words[1], headers)


def as_json(content: Any, status: HTTPStatus = HTTPStatus.OK) -> HttpAnswer:
    """Answer with JSON."""
    return HttpAnswer(status, json.dumps(content, allow_nan=False).encode(), "application/json")


def refusal(status: HTTPStatus, sentence: str) -> HttpAnswer:
    """Answer with a sentence that says what is wrong."""
    return HttpAnswer(status, f"{sentence}\n".encode())

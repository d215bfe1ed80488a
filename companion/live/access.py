"""Who may look: one rule for the page, the websocket, the downloads and the changes.

A browser lets any page that it shows open a websocket to this machine, and a name of a stranger's may be made to point
here; so a request without the token must name this machine as its host, and come from a page of this machine or from
none.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from urllib.parse import urlsplit

from companion.live.config import is_loopback
from companion.live.requests import Request

COOKIE = "spanwise_token"


@dataclass(frozen=True, slots=True)
class Access:
    """Rule of one live view; see :class:`companion.live.config.LiveConfig`."""

    token: str | None
    is_loopback: bool
    token_place: str = ""

    def admits(self, request: Request) -> bool:
        """Whether the request may be answered."""
        return self.has_token(request) or (self.is_loopback and _is_local(request))

    def has_token(self, request: Request) -> bool:
        """Whether the token comes with it: in the address, as a bearer, or as the cookie that the page sets."""
        if self.token is None:
            return False
        bearer = request.headers.get("authorization", "").removeprefix("Bearer ")
        given_by = (request.query.get("token", ""), bearer, request.cookies.get(COOKIE, ""))
        return any(secrets.compare_digest(text.encode(), self.token.encode()) for text in given_by)


def _is_local(request: Request) -> bool:
    host = urlsplit(f"//{request.headers.get('host', '')}").hostname or ""
    origin = request.headers.get("origin")
    from_page = "localhost" if origin is None else urlsplit(origin).hostname or ""
    return is_loopback(host) and is_loopback(from_page)

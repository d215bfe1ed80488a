"""Answers that need no token: the page that asks for it, and who this is, for BlueOS's menu.

BlueOS looks at every port that listens beyond loopback (``core/services/helper/main.py`` there): where ``/`` gets 200
there is a web server, and ``/register_service`` says what the menu shows of it. Nothing here is private; what both lead
to needs the token.
"""

from __future__ import annotations

import html
from http import HTTPStatus
from importlib import resources
from typing import Any

from companion.adapters.recordings.mcap.writer import software_version
from companion.live.requests import HttpAnswer, Request, as_json

REGISTRATION = "/register_service"
_WRONG, _PLACE = "<!-- wrong token -->", "<!-- token file -->"


def public_answer(request: Request, token_place: str = "", *, is_loopback: bool) -> HttpAnswer | None:
    """Answer for a request that is not admitted; None where it is refused."""
    if request.method != "GET" or request.is_websocket:
        return None
    if request.path == REGISTRATION:
        return as_json(registration())
    if request.path != "/" or is_loopback:
        return None
    return token_page(token_place, wrong="token" in request.query)


def registration() -> dict[str, Any]:
    """Entry of BlueOS's menu; the page opens in a tab of its own, for it refuses to be shown inside another's."""
    return {
        "name": "Spanwise",
        "description": "Stereo ranges that stay true while the wing bends",
        "icon": "mdi-airplane",
        "company": "Spanwise",
        "version": software_version(),
        "webpage": "",
        "api": "",
        "new_page": True,
        "avoid_iframes": True,
    }


def token_page(token_place: str, *, wrong: bool) -> HttpAnswer:
    """Page with a field for the token, and where to look it up; it loads nothing else."""
    text = (resources.files("companion.live") / "page" / "token.html").read_text(encoding="utf-8")
    text = text.replace(_WRONG, "That is not the token." if wrong else "")
    text = text.replace(_PLACE, html.escape(token_place or "live-token"))
    return HttpAnswer(HTTPStatus.OK, text.encode(), "text/html; charset=utf-8")

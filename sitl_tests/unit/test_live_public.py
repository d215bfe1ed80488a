"""Pages that the live view's door gives without the token."""

from __future__ import annotations

import dataclasses
import html
import json
from html.parser import HTMLParser

import pytest

from companion.adapters.recordings.mcap.writer import software_version
from companion.live.public import REGISTRATION, public_answer
from companion.live.requests import Request

BLUEOS = {"name": str, "description": str, "icon": str, "company": str, "version": str, "webpage": str, "api": str}
"""Fields that BlueOS insists on, of its ``ServiceMetadata`` (core/services/helper/main.py)."""
ASKED = Request("GET", "/", {"host": "10.0.0.7:8765"})


class Page(HTMLParser):
    """Title, inputs and whatever a page would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))


@pytest.mark.parametrize("is_loopback", [True, False])
def test_blueos_is_told_who_this_is(is_loopback: bool) -> None:
    response = public_answer(dataclasses.replace(ASKED, target=REGISTRATION), is_loopback=is_loopback)
    assert response is not None
    assert response.status == 200
    assert response.content_type == "application/json"
    entry = json.loads(response.body)
    assert {name: type(entry[name]) for name in BLUEOS} == BLUEOS
    assert entry["version"] == software_version()
    assert entry["icon"].startswith("mdi-"), "a name of Material Design Icons"
    assert entry["new_page"] is True


def test_blueos_takes_the_first_page_for_a_web_server_s() -> None:
    """It wants a status of 200 and a title, and then asks who this is."""
    response = public_answer(ASKED, is_loopback=False)
    assert response is not None
    assert response.status == 200
    assert b"<title>Spanwise</title>" in response.body


def test_the_page_asks_for_the_token_and_loads_nothing() -> None:
    response = public_answer(ASKED, is_loopback=False)
    assert response is not None
    tags = Page(response.body.decode()).tags
    assert [attributes["name"] for tag, attributes in tags if tag == "input"] == ["token"]
    assert [attributes["type"] for tag, attributes in tags if tag == "input"] == ["text"], "shown as it is typed"
    assert not [attributes for _, attributes in tags if {"src", "href"} & attributes.keys()]


@pytest.mark.parametrize("place", ["~/.local/state/spanwise/live-token", "/state/<b>&/live-token"])
def test_the_page_says_where_the_token_is(place: str) -> None:
    response = public_answer(ASKED, place, is_loopback=False)
    assert response is not None
    assert f"<code>{html.escape(place)}</code>" in response.body.decode()


def test_a_wrong_token_is_told() -> None:
    first, again = (
        public_answer(dataclasses.replace(ASKED, target=target), is_loopback=False) for target in ("/", "/?token=wrong")
    )
    assert first is not None
    assert again is not None
    assert b"not the token" not in first.body
    assert b"not the token" in again.body


@pytest.mark.parametrize(
    "request_",
    [
        dataclasses.replace(ASKED, target="/about.json"),
        dataclasses.replace(ASKED, target="/recordings/flight.mcap"),
        dataclasses.replace(ASKED, method="POST"),
        dataclasses.replace(ASKED, method="POST", target=REGISTRATION),
        dataclasses.replace(ASKED, headers={**ASKED.headers, "upgrade": "websocket"}),
        dataclasses.replace(ASKED, target=REGISTRATION, headers={**ASKED.headers, "upgrade": "websocket"}),
    ],
)
def test_nothing_else_is_given(request_: Request) -> None:
    assert public_answer(request_, is_loopback=False) is None


def test_on_loopback_a_strange_page_gets_not_even_the_first_page() -> None:
    """There the refusal says what to do, and no token may exist."""
    assert public_answer(ASKED, is_loopback=True) is None

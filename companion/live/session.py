"""One live view: records in, parameters and recordings by the page's buttons, everything behind one door."""

from __future__ import annotations

import dataclasses
import json
import queue
import socket
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from http import HTTPStatus
from importlib import resources
from typing import Any

from companion.adapters.recordings.mcap.channels import Recordable
from companion.adapters.recordings.mcap.writer import About
from companion.errors import ConfigError, RecordingError
from companion.live.about import ENDINGS, ViewKind, facts, parameter_table
from companion.live.access import Access
from companion.live.broadcaster import Broadcaster
from companion.live.config import LiveConfig
from companion.live.door import Door
from companion.live.feed import ALWAYS, RECORDED
from companion.live.page_recording import PageRecording
from companion.live.public import REGISTRATION, registration
from companion.live.requests import HttpAnswer, Request, as_json, refusal
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.params.shipped import shipped
from companion.records import Frame, FramePair, Notice, ParameterChange

_CONTENT = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_MOST_REQUESTS = 64  # bound of memory
_MOST_EVENTS = 60  # bound of memory: sentences that a page shows
_MIDWAY = 2  # number of a recording's part whose estimation began before it (convention)


@dataclass(frozen=True, slots=True)
class Subject:
    """Content of the live view.

    ``title`` is what runs: "live", "demo", or the name of a recording. ``ask`` hands on the wish to set a parameter
    (name, value), None where nothing can be set; ``request_topics`` is given the kinds of record that somebody looks
    at, as bits of :data:`companion.live.feed.BIT`. ``began_host_ns`` is when the flight, the recording or the service
    began, None where only its records tell. Without ``has_images`` no image can come.
    """

    airframe: Airframe
    settings: Settings
    title: str
    ask: Callable[[str, float], object] | None = None
    request_topics: Callable[[int], object] = lambda _mask: None
    is_recording: bool = False
    kind: ViewKind = ViewKind.LIVE
    has_images: bool = True
    began_host_ns: int | None = None


class LiveSession:
    """Serves one live view from one thread that publishes; the door and the SDK have threads of their own.

    Raises
    ------
    MissingExtra
        The extra ``live`` is not installed.
    """

    def __init__(self, config: LiveConfig, subject: Subject, listening: socket.socket) -> None:
        self._subject, self._settings = subject, subject.settings
        self._page_recording = PageRecording(config.folder)
        self._watched = 0
        self._switches: queue.Queue[bool] = queue.Queue(_MOST_REQUESTS)
        self._failure = self._ended = ""
        self._began_host_ns = subject.began_host_ns
        self._events: deque[Notice] = deque(maxlen=_MOST_EVENTS)
        self._broadcaster = Broadcaster(lambda: self._settings.values(), self._on_watched)
        access = Access(config.token, config.is_loopback, config.token_place)
        self._door = Door(listening, access, self._answer, self._broadcaster.port)

    def publish(self, record: Recordable) -> None:
        """Show one record to whoever looks, and record it where that is switched on."""
        if isinstance(record, ParameterChange):
            self._follow(record)
        elif isinstance(record, Notice):
            self._events.append(record)
        self._broadcaster.publish(record)
        if self._page_recording.is_on and not isinstance(record, Frame | FramePair):
            try:
                self._page_recording.write(record)
            except RecordingError as error:
                self._failure = str(error)
                self._request_topics()

    def tend(self) -> None:
        """Do what the page's buttons asked for; call it a few times a second."""
        while not self._switches.empty():
            self._switch(is_on=self._switches.get_nowait())

    def begin(self, at_host_ns: int) -> None:
        """Say when it began, as far as that is not known yet."""
        if self._began_host_ns is None:
            self._began_host_ns = at_host_ns

    def end(self, sentence: str = "") -> None:
        """Say to all who look that nothing more comes; the page stays until :meth:`close`."""
        if not self._ended:
            self._ended = sentence or ENDINGS[self._subject.kind]
            self._broadcaster.publish_end(self._ended)

    def close(self) -> None:
        """End the connections, close the door, and finish the recording."""
        self._broadcaster.close()
        self._door.close()
        self._page_recording.end()

    # ------------------------------------------------------------------------------- in the publishing thread

    def _follow(self, change: ParameterChange) -> None:
        try:
            self._settings = self._settings.replace(change.name, change.value, flown=True)
        except ConfigError:  # of a damaged recording
            return
        self._broadcaster.publish_parameter(change.name, change.value)

    def _switch(self, *, is_on: bool) -> None:
        self._failure = ""
        try:
            if is_on and not self._page_recording.is_on:
                about = About.of(self._subject.airframe, self._settings)
                self._page_recording.begin(dataclasses.replace(about, part_number=_MIDWAY))
            elif not is_on:
                self._page_recording.end()
        except (RecordingError, OSError) as error:
            self._failure = str(error)
        self._request_topics()

    # ------------------------------------------------------------------------------- in the servers' threads

    def _on_watched(self, mask: int) -> None:
        self._watched = mask
        self._request_topics()

    def _request_topics(self) -> None:
        self._subject.request_topics(self._watched | ALWAYS | (RECORDED if self._page_recording.is_on else 0))

    def _answer(self, request: Request) -> HttpAnswer:
        """Answer one request of the page."""
        if request.method == "GET":
            return self._read(request.path)
        if request.method == "POST" and _media_type(request) == "application/json":
            return self._change(request)
        return refusal(HTTPStatus.METHOD_NOT_ALLOWED, "only GET, and POST of JSON")

    def _read(self, path: str) -> HttpAnswer:
        if path == "/about.json":
            return as_json(facts(self._subject.airframe, self._subject.title) | self._state())
        if path == "/recordings.json":
            return as_json(self._recordings())
        if path.startswith("/recordings/"):
            return self._recording(path.removeprefix("/recordings/"))
        if path == REGISTRATION:
            return as_json(registration())
        if path == "/layout.json":
            layout = (shipped("live") / "spanwise.json").read_bytes()
            return HttpAnswer(HTTPStatus.OK, layout, "application/json")
        return _page_file("index.html" if path == "/" else path.removeprefix("/"))

    def _state(self) -> dict[str, Any]:
        """State of the view, which changes between two looks at the facts or differs from view to view."""
        return {
            "kind": str(self._subject.kind),
            "has_images": self._subject.has_images,
            "began_host_ns": self._began_host_ns,
            "ended": self._ended,
            "can_set": self._subject.ask is not None,
            "parameters": parameter_table(self._settings.values()),
            "events": [[notice.severity, notice.text, notice.at_host_ns] for notice in list(self._events)],
        }

    def _recordings(self) -> dict[str, Any]:
        return {
            "always": self._subject.is_recording,
            "on": self._page_recording.is_on,
            "failure": self._failure,
            "files": self._page_recording.listed(),
        }

    def _recording(self, name: str) -> HttpAnswer:
        file = self._page_recording.file(name)
        if file is None:
            return refusal(HTTPStatus.NOT_FOUND, "no such recording")
        named = {"Content-Disposition": f'attachment; filename="{name}"'} if name.isascii() and '"' not in name else {}
        return HttpAnswer(HTTPStatus.OK, content_type="application/octet-stream", headers=named, file=file)

    def _change(self, request: Request) -> HttpAnswer:
        try:
            wish = json.loads(request.body)
            if request.path == "/record":
                if not isinstance(wish["on"], bool):
                    raise TypeError
                self._switches.put_nowait(wish["on"])
                return as_json({"asked": True}, HTTPStatus.ACCEPTED)
            if request.path == "/parameters":
                return self._ask(str(wish["name"]), float(wish["value"]))
        except (ValueError, TypeError, LookupError, OverflowError, RecursionError):
            return refusal(HTTPStatus.BAD_REQUEST, "give JSON: name and value, or on")
        except queue.Full:
            return refusal(HTTPStatus.SERVICE_UNAVAILABLE, "too many requests at once")
        return refusal(HTTPStatus.NOT_FOUND, "nothing to change here")

    def _ask(self, name: str, value: float) -> HttpAnswer:
        if self._subject.ask is None:
            return refusal(HTTPStatus.CONFLICT, "nothing can be set here")
        try:
            clash = self._settings.replace(name, value).conflict()
        except ConfigError as error:
            return refusal(HTTPStatus.BAD_REQUEST, str(error))
        if clash is not None:
            return refusal(HTTPStatus.BAD_REQUEST, clash.text)
        self._subject.ask(name, value)
        return as_json({"asked": True}, HTTPStatus.ACCEPTED)


def _media_type(request: Request) -> str:
    """Kind of the body, without its parameters such as ``charset``."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def _page_file(name: str) -> HttpAnswer:
    """A file of the page; only those are there, whatever the name says."""
    files = {entry.name: entry for entry in (resources.files("companion.live") / "page").iterdir()}
    suffix = name[name.rfind(".") :]
    if name not in files or suffix not in _CONTENT:
        return refusal(HTTPStatus.NOT_FOUND, "no such page")
    return HttpAnswer(HTTPStatus.OK, files[name].read_bytes(), f"{_CONTENT[suffix]}; charset=utf-8")

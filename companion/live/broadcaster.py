"""The topics of a recording, published as they happen by the SDK's websocket server, on loopback."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from companion.adapters.recordings.mcap.channels import CAMERA_TOPICS, CHANNELS, SENT_LINK, Recordable, topic_of
from companion.adapters.recordings.mcap.images import ImageFormat
from companion.adapters.recordings.mcap.messages import MessageForm, form_of, image_form, image_message, message_of
from companion.errors import import_extra
from companion.live.feed import BIT
from companion.records import Frame, FramePair, ImuBatch, RawChunk, Station

_BACKLOG = 256  # messages that wait for one client; then the oldest go (choice)
ENDED = "ended"
"""Id of the protocol's status message that says that nothing more comes."""
_LAST_WORDS_S = 0.4  # the SDK throws away what waits when it stops (choice)


def require_live() -> Any:
    """Give the SDK.

    Raises
    ------
    MissingExtra
        The extra ``live`` is not installed.
    """
    return import_extra("foxglove", "live pages", "live")


class Broadcaster:
    """Publishes records to whoever subscribed to their topic.

    ``values`` gives the parameters in force, by MAVLink name; ``changed`` is told the kinds of record that somebody
    looks at, as bits of :data:`companion.live.feed.BIT`.
    """

    def __init__(self, values: Callable[[], dict[str, float]], changed: Callable[[int], object]) -> None:
        self._sdk = require_live()
        self._values, self._changed = values, changed
        self._lock = threading.Lock()
        self._subscribers: Counter[str] = Counter()
        self._latest_ns = 0
        # a browser that is closed is an error to the SDK; a server that does not start raises, whatever the level
        self._sdk.set_log_level("CRITICAL")
        self._context = context = self._sdk.Context()  # the server holds it weakly
        self._bits = {topic: BIT[kind] for topic, kind, _ in _topics()}
        self._server = self._sdk.start_server(
            name="spanwise",
            port=0,
            server_listener=_Listener(self._count, self._parameters),
            capabilities=[self._sdk.Capability.Parameters],
            context=context,
            message_backlog_size=_BACKLOG,
        )
        self._channels = {
            topic: self._sdk.Channel(topic, message_encoding=form.encoding, schema=self._schema(form), context=context)
            for topic, _, form in _topics()
        }

    @property
    def port(self) -> int:
        """Port of the SDK's server on loopback."""
        return int(self._server.port)

    def publish(self, record: Recordable) -> None:
        """Publish one record; without a subscriber of its topic it costs a look."""
        if isinstance(record, FramePair):
            self.publish(record.left)
            self.publish(record.right)
            return
        topic = CAMERA_TOPICS[record.side] if isinstance(record, Frame) else topic_of(record)
        if self._subscribers[topic]:
            if isinstance(record, Frame):
                log_ns, data = self._latest_ns, image_message(record, None, ImageFormat.JPEG)
            else:
                log_ns, data = message_of(record)
            self._latest_ns = max(self._latest_ns, log_ns, 0)
            self._channels[topic].log(data, log_time=max(log_ns, 0))

    def publish_parameter(self, name: str, value: float) -> None:
        """Tell a changed parameter to those who follow parameters."""
        self._server.publish_parameter_values([self._sdk.Parameter(name, value=float(value))])

    def publish_end(self, sentence: str) -> None:
        """Tell all who are connected that nothing more comes, and why."""
        self._server.publish_status(sentence, self._sdk.websocket.StatusLevel.Info, ENDED)
        if any(self._subscribers.values()):
            threading.Event().wait(_LAST_WORDS_S)  # nothing says when all is sent

    def close(self) -> None:
        """Stop the server."""
        self._server.stop()

    def _schema(self, form: MessageForm) -> Any:
        return self._sdk.Schema(name=form.schema_name, encoding=form.schema_encoding, data=form.schema)

    def _count(self, topic: str, step: int) -> None:
        with self._lock:
            self._subscribers[topic] = max(0, self._subscribers[topic] + step)
            mask = 0
            for name, count in self._subscribers.items():
                mask |= self._bits[name] if count else 0
            self._changed(mask)

    def _parameters(self, names: Iterable[str]) -> list[Any]:
        values = self._values()
        chosen = list(names) or list(values)
        return [self._sdk.Parameter(name, value=float(values[name])) for name in chosen if name in values]


class _Listener:
    """Callbacks of the SDK: who subscribes, and what the parameters are. Changes come through the door alone."""

    def __init__(self, count: Callable[[str, int], object], parameters: Callable[[Iterable[str]], list[Any]]) -> None:
        self._count, self._parameters = count, parameters

    def on_subscribe(self, _client: Any, channel: Any) -> None:
        """One more looks at a topic."""
        self._count(channel.topic, +1)

    def on_unsubscribe(self, _client: Any, channel: Any) -> None:
        """One less does."""
        self._count(channel.topic, -1)

    def on_get_parameters(self, _client: Any, names: list[str], _request: str | None = None) -> list[Any]:
        """Give the parameters of these names, all for none."""
        return self._parameters(names)

    def on_set_parameters(self, _client: Any, parameters: list[Any], _request: str | None = None) -> list[Any]:
        """Change nothing, and say what is in force."""
        return self._parameters([parameter.name for parameter in parameters])


def _topics() -> list[tuple[str, type, MessageForm]]:
    """Every topic with its kind of record and its form."""
    listed = [
        (topic, kind, form_of(channel)) for kind, channel in CHANNELS.items() for topic in _spelled(kind, channel.topic)
    ]
    return [*listed, *((topic, Frame, image_form()) for topic in CAMERA_TOPICS)]


def _spelled(kind: type, topic: str) -> list[str]:
    if kind is ImuBatch:
        return [topic.format(station=station.name.lower()) for station in Station]
    if kind is RawChunk:
        return [topic_of(RawChunk(link, 0, b"")) for link in (0, SENT_LINK)]
    return [topic]

"""Frames of our own component on every link: numbered, remembered by its identity, refused where not finite."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

from companion.adapters.mavlink.component import encode
from companion.adapters.mavlink.component.component import OnboardComponent
from companion.adapters.mavlink.decode.decoder import OUTGOING
from companion.adapters.mavlink.decode.message_records import parameter_encoding
from companion.adapters.mavlink.decode.source_map import AUTOPILOT_COMPONENT
from companion.adapters.mavlink.link.dialect import mavlink
from companion.adapters.mavlink.link.link import Link
from companion.params.settings import Settings
from companion.ports import Clock
from companion.records import Notice, RawChunk

_FIRST_SYSTEM = 1  # system id of our first heartbeat where none is set; ArduPilot's default
_COMMAND_PARAMETERS = 7  # of a COMMAND_LONG (by definition)
_MOST_UNREAD = 1024  # frames; bound of memory


class ComponentSender:
    """Packs pymavlink messages as our component and writes them to the links.

    ``system`` is the system id that we send with, the autopilot's; until that is heard the one that is set. ``refused``
    counts messages that were not sent because a value was not finite. ``autopilot_link`` is the number of the link that
    what is asked of the autopilot goes to, None for all.
    """

    def __init__(self, links: Sequence[Link], component: OnboardComponent, settings: Settings, clock: Clock) -> None:
        self.refused = 0
        self.autopilot_link: int | None = None
        self._clock = clock
        self._sent: deque[RawChunk] = deque(maxlen=_MOST_UNREAD)
        self._links, self._component = links, component
        self._packer = mavlink.MAVLink(None, settings.system_id or _FIRST_SYSTEM, settings.component_id)
        self._sequences = dict.fromkeys((link.number for link in links), 0)  # of the next frame on each link
        self._texts = 0

    @property
    def system(self) -> int:
        """System id of every frame."""
        return int(self._packer.srcSystem)

    @system.setter
    def system(self, system: int) -> None:
        self._packer.srcSystem = system

    def send(self, message: Any, number: int | None = None) -> None:
        """Send a message on all links, or on the one of a number."""
        if message is None or not encode.sendable(message):
            self.refused += 1
            return
        frames = {link.number: self.pack(message, link.number) for link in self._links if number in (None, link.number)}
        if frames:
            self._component.identity.sent(message.get_msgId(), bytes(message.get_payload()))
        taken = [link.number for link in self._links if link.number in frames and link.write(frames[link.number])]
        if taken:
            self._sent.append(RawChunk(OUTGOING + taken[0], self._clock.now_ns(), frames[taken[0]]))

    def sent(self) -> Iterator[RawChunk]:
        """Frames that a link has taken since the last call, each once, for the recording."""
        while self._sent:
            yield self._sent.popleft()

    def pack(self, message: Any, number: int) -> bytes:
        """Bytes of a message, with the next sequence number of a link: who reads that one counts gaps as losses."""
        self._packer.seq = self._sequences[number]
        self._sequences[number] = (self._packer.seq + 1) % 256
        return bytes(message.pack(self._packer))

    def command(self, command: int, *parameters: float) -> None:
        """Send a COMMAND_LONG to the autopilot; parameters that are left out are 0."""
        filled = [float(value) for value in parameters] + [0.0] * (_COMMAND_PARAMETERS - len(parameters))
        message = mavlink.MAVLink_command_long_message(self.system, AUTOPILOT_COMPONENT, command, 0, *filled)
        self.send(message, self.autopilot_link)

    def request_parameter(self, name: str) -> None:
        """Ask the autopilot for one of its parameters."""
        message = mavlink.MAVLink_param_request_read_message(self.system, AUTOPILOT_COMPONENT, name.encode(), -1)
        self.send(message, self.autopilot_link)

    def set_parameter(self, name: str, value: float, *, integer: bool) -> None:
        """Ask the autopilot to set one of its parameters; ``integer`` as PX4 encodes them, in the bytes of a float."""
        value, kind = parameter_encoding(value, integer=integer)
        message = mavlink.MAVLink_param_set_message(self.system, AUTOPILOT_COMPONENT, name.encode(), value, kind)
        self.send(message, self.autopilot_link)

    def tell(self, notice: Notice) -> None:
        """Send a sentence as STATUSTEXT, in pieces, unless it repeats one just sent."""
        text = self._component.texts.admit(notice)
        if text is not None:
            self._texts += 1
            for chunk in encode.status_text(notice.severity, text, self._texts):
                self.send(chunk)

"""Our own MAVLink component, as others see it: parameters, identity, commands, files, and the computer's state."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any

from companion.adapters.mavlink.component.commands import CommandServer
from companion.adapters.mavlink.component.ftp import FileServer
from companion.adapters.mavlink.component.onboard_computer_status import OnboardComputerStatus
from companion.adapters.mavlink.component.parameter_server import ParameterServer
from companion.adapters.mavlink.component.statustext import TextLimiter
from companion.adapters.mavlink.decode.message_records import Echo, Heard
from companion.adapters.mavlink.link.signing import Signing
from companion.adapters.mavlink.vehicle.id_conflict import IdConflictDetector
from companion.params.metadata import GENERAL_FILE, metadata_files
from companion.records import Notice, ParameterChange

_MOST_NOTICES = 16  # bound of memory
_LONGEST_WAIT_NS = 1_000_000_000  # chosen: a line that never empties must not silence the others for ever


class OnboardComponent:
    """Services of a MAVLink component beside its work: takes received messages, and yields the ones that are due."""

    def __init__(
        self, parameters: ParameterServer, signing: Signing | None = None, computer: OnboardComputerStatus | None = None
    ) -> None:
        self.parameters = parameters
        self.signing = signing
        self.identity = IdConflictDetector()
        self.texts = TextLimiter()
        component = parameters.settings.component_id
        files = metadata_files(component)
        self.files = FileServer(files, component)
        self.commands = CommandServer(component, files[GENERAL_FILE])
        self._computer = OnboardComputerStatus() if computer is None else computer
        self._notices: deque[Notice] = deque(maxlen=_MOST_NOTICES)
        self._bulk_host_ns = 0

    def hear(self, heard: Heard, system: int) -> None:
        """Take in a rare message of somebody else."""
        if heard.name == "FILE_TRANSFER_PROTOCOL":
            self.files.hear(heard, system)
        elif heard.name in ("COMMAND_LONG", "COMMAND_INT"):
            self.commands.hear(heard, system)
        else:
            self.parameters.hear(heard, system)

    def echoed(self, echo: Echo) -> None:
        """Take in a message that carries our own ids."""
        notice = self.identity.heard(echo)
        if notice is not None:
            self._notices.append(notice)

    def due(self, now_host_ns: int, *, busy: bool = False) -> Iterator[Any]:
        """The messages to send now; files and parameters wait, a second at most, while a line is ``busy``.

        Ranges and TIMESYNC go over the same line, and would be late by whatever lies before them.
        """
        messages = [self.commands.due(), self._computer.due(now_host_ns)]
        if not busy or now_host_ns - self._bulk_host_ns > _LONGEST_WAIT_NS:
            self._bulk_host_ns = now_host_ns
            messages.append(self.parameters.due(now_host_ns) or self.files.due(now_host_ns))
        yield from (message for message in messages if message is not None)

    def close(self) -> None:
        """Finish what is under way."""
        self.parameters.close()

    def events(self, now_host_ns: int) -> list[ParameterChange | Notice]:
        """Changes and sentences for the operator since the last call, whether or not a vehicle is heard."""
        if self.signing is not None:
            self._notices.extend(self.signing.notices(now_host_ns))
        taken = [*self.parameters.events(), *self._notices]
        self._notices.clear()
        return taken

"""Commands that are for us: messages on request; whatever else is addressed to us is answered "unsupported"."""

from __future__ import annotations

from collections import deque
from typing import Any

from companion.adapters.mavlink.decode.message_records import Heard
from companion.adapters.mavlink.link.dialect import NewerMessage, mavlink
from companion.params.metadata import GENERAL_FILE, mavlink_crc32, metadata_uri

_MOST_WAITING = 16  # bound of memory: a flood of commands loses its oldest answers
_COMPONENT_METADATA, _AUTOPILOT_VERSION = 397, 148  # message ids (MAVLink common.xml)
_COMPONENT_METADATA_CRC_EXTRA = 182  # MAVLink common.xml


class CommandServer:
    """Answers COMMAND_LONG and COMMAND_INT that name our component."""

    def __init__(self, component: int, general_file: bytes) -> None:
        self._component = component
        self._crc = mavlink_crc32(general_file)
        self._waiting: deque[Any] = deque(maxlen=_MOST_WAITING)

    def hear(self, heard: Heard, system: int) -> None:
        """Take in a command; ``system`` is our own system id."""
        message = heard.message
        if message.target_system not in (0, system) or message.target_component != self._component:
            return
        is_request = message.command == mavlink.MAV_CMD_REQUEST_MESSAGE
        answer = self._requested(message, heard.received_host_ns) if is_request else None
        result = mavlink.MAV_RESULT_UNSUPPORTED if answer is None else mavlink.MAV_RESULT_ACCEPTED
        self._waiting.append(
            mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, heard.system, heard.component)
        )
        if answer is not None:
            self._waiting.append(answer)

    def due(self) -> Any | None:
        """The next message to send."""
        return self._waiting.popleft() if self._waiting else None

    def _requested(self, message: Any, now_host_ns: int) -> Any | None:
        if message.param1 == _COMPONENT_METADATA:
            return NewerMessage(
                _COMPONENT_METADATA,
                "COMPONENT_METADATA",
                _COMPONENT_METADATA_CRC_EXTRA,
                "<II100s",
                time_boot_ms=now_host_ns // 1_000_000 & 0xFFFFFFFF,
                file_crc=self._crc,
                uri=metadata_uri(self._component, GENERAL_FILE).encode(),
            )
        if message.param1 == _AUTOPILOT_VERSION:
            able = (
                mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
                | mavlink.MAV_PROTOCOL_CAPABILITY_FTP
                | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
            )
            return mavlink.MAVLink_autopilot_version_message(
                able, 0, 0, 0, 0, bytes(8), bytes(8), bytes(8), 0, 0, 0, bytes(18)
            )
        return None

"""Commands that are for us: messages on request; whatever else is addressed to us is answered "unsupported"."""

from __future__ import annotations

import struct
from collections import deque
from typing import Any

from companion.adapters.mavlink.decode.message_records import Heard
from companion.adapters.mavlink.link.dialect import mavlink
from companion.params.metadata import GENERAL_FILE, mavlink_crc32, metadata_uri

_MOST_WAITING = 16  # bound of memory: a flood of commands loses its oldest answers
_COMPONENT_METADATA, _AUTOPILOT_VERSION = 397, 148  # message ids (MAVLink common.xml)


class ComponentMetadata(mavlink.MAVLink_message):  # type: ignore[misc]
    """COMPONENT_METADATA (397), which pymavlink 2.4.50 lacks: time_boot_ms, file_crc, uri[100]."""

    unpacker = struct.Struct("<II100s")
    crc_extra = 182

    def __init__(self, time_boot_ms: int, file_crc: int, uri: str) -> None:
        super().__init__(_COMPONENT_METADATA, "COMPONENT_METADATA")
        self._fieldnames = ["time_boot_ms", "file_crc", "uri"]
        self.time_boot_ms, self.file_crc, self.uri = time_boot_ms, file_crc, uri

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """Frame it, as pymavlink's messages do."""
        payload = self.unpacker.pack(self.time_boot_ms, self.file_crc, self.uri.encode())
        return bytes(self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1))


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
        answer = self._requested(message, heard.received_host_ns) if self._is_request(message) else None
        result = mavlink.MAV_RESULT_UNSUPPORTED if answer is None else mavlink.MAV_RESULT_ACCEPTED
        self._waiting.append(
            mavlink.MAVLink_command_ack_message(message.command, result, 0, 0, heard.system, heard.component)
        )
        if answer is not None:
            self._waiting.append(answer)

    def due(self) -> Any | None:
        """The next message to send."""
        return self._waiting.popleft() if self._waiting else None

    @staticmethod
    def _is_request(message: Any) -> bool:
        return bool(message.command == mavlink.MAV_CMD_REQUEST_MESSAGE)

    def _requested(self, message: Any, now_host_ns: int) -> Any | None:
        if message.param1 == _COMPONENT_METADATA:
            uri = metadata_uri(self._component, GENERAL_FILE)
            return ComponentMetadata(now_host_ns // 1_000_000 & 0xFFFFFFFF, self._crc, uri)
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

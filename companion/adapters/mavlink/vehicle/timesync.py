"""TIMESYNC with its newer fields, target system and component, which pymavlink 2.4.50 lacks."""

from __future__ import annotations

import struct
from typing import Any

from companion.adapters.mavlink.decode.message_records import Heard
from companion.adapters.mavlink.link.dialect import ID_OF, mavlink

_TARGET = 16  # bytes of payload before the newer fields (MAVLink common.xml)


class TimesyncAnswer(mavlink.MAVLink_message):  # type: ignore[misc]
    """TIMESYNC in answer to a request: tc1 is our time, ns, and its target who asked."""

    unpacker = struct.Struct("<qqBB")
    crc_extra = mavlink.MAVLink_timesync_message.crc_extra

    def __init__(self, request: Heard, now_ns: int) -> None:
        super().__init__(ID_OF["TIMESYNC"], "TIMESYNC")
        self._fieldnames = ["tc1", "ts1", "target_system", "target_component"]
        self.tc1, self.ts1 = now_ns, request.message.ts1
        self.target_system, self.target_component = request.system, request.component

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """Frame it, as pymavlink's messages do."""
        payload = self.unpacker.pack(self.tc1, self.ts1, self.target_system, self.target_component)
        return bytes(self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1))


def is_request(heard: Heard, system: int | None, component: int) -> bool:
    """Whether this is a TIMESYNC request of our vehicle, to us or to everyone (0, or by a sender that names nobody)."""
    if heard.name != "TIMESYNC" or heard.message.tc1 != 0 or heard.system != system:
        return False
    target_system, target_component = heard.payload[_TARGET : _TARGET + 2].ljust(2, b"\0")
    return target_system in (0, system) and target_component in (0, component)

"""TIMESYNC with its newer fields, target system and component, which pymavlink 2.4.50 lacks."""

from __future__ import annotations

from companion.adapters.mavlink.decode.message_records import Heard
from companion.adapters.mavlink.link.dialect import CRC_EXTRA, ID_OF, NewerMessage

_TARGET = 16  # bytes of payload before the newer fields (MAVLink common.xml)


def timesync_answer(request: Heard, now_ns: int) -> NewerMessage:
    """TIMESYNC in answer to a request: tc1 is our time, ns, and its target who asked."""
    return NewerMessage(
        ID_OF["TIMESYNC"],
        "TIMESYNC",
        CRC_EXTRA[ID_OF["TIMESYNC"]],
        "<qqBB",
        tc1=now_ns,
        ts1=request.message.ts1,
        target_system=request.system,
        target_component=request.component,
    )


def is_request(heard: Heard, system: int | None, component: int) -> bool:
    """Whether this is a TIMESYNC request of our vehicle, to us or to everyone (0, or by a sender that names nobody)."""
    if heard.name != "TIMESYNC" or heard.message.tc1 != 0 or heard.system != system:
        return False
    target_system, target_component = heard.payload[_TARGET : _TARGET + 2].ljust(2, b"\0")
    return target_system in (0, system) and target_component in (0, component)

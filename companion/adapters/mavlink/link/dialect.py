"""Message table of pymavlink's ``ardupilotmega`` dialect: id, name, CRC extra, and how to build a message."""

from __future__ import annotations

import functools
import itertools
import struct
from collections.abc import Callable
from operator import itemgetter
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

mavlink: Any = ardupilotmega

_CLASSES: dict[int, Any] = mavlink.mavlink_map

CRC_EXTRA: dict[int, int] = {identity: kind.crc_extra for identity, kind in _CLASSES.items()}
ID_OF: dict[str, int] = {kind.msgname: identity for identity, kind in _CLASSES.items()}
NAME_OF: dict[int, str] = {identity: kind.msgname for identity, kind in _CLASSES.items()}


class NewerMessage(mavlink.MAVLink_message):  # type: ignore[misc]
    """A message, or further fields of one, that pymavlink 2.4.50 lacks: ``fields`` in the order of the wire."""

    def __init__(self, identity: int, name: str, crc_extra: int, layout: str, **fields: Any) -> None:
        super().__init__(identity, name)
        self._crc_extra, self._layout, self._fieldnames = crc_extra, layout, list(fields)
        for field, value in fields.items():
            setattr(self, field, value)

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """Frame it, as pymavlink's messages do."""
        payload = struct.pack(self._layout, *(getattr(self, field) for field in self._fieldnames))
        return bytes(self._pack(mav, self._crc_extra, payload, force_mavlink1=force_mavlink1))


def payload_size(identity: int) -> int:
    """Bytes of the untrimmed payload, extensions included."""
    return int(_CLASSES[identity].unpacker.size)


def build_message(identity: int, payload: bytes) -> Any:
    """Make pymavlink's message object from a payload, zero-trimmed (MAVLink 2) or longer than this dialect knows.

    Gives the same field values as ``MAVLink.decode`` (a test holds it to that); the checksum has been checked before.
    """
    kind, unpack, size, ordered = _layout(identity)
    flat = unpack(payload[:size].ljust(size, b"\0"))
    if ordered is not None:
        return kind(*ordered(flat))
    starts = list(itertools.accumulate(kind.lengths, initial=0))
    return kind(*(_field(flat[starts[order] : starts[order + 1]]) for order in kind.orders))


@functools.cache
def _layout(identity: int) -> tuple[Any, Any, int, Callable[[tuple[Any, ...]], tuple[Any, ...]] | None]:
    """Class, unpacking and size of a message; the order of its fields where all are single numbers."""
    kind = _CLASSES[identity]
    numbers = set(kind.lengths) == {1} and "s" not in kind.unpacker.format and len(kind.orders) > 1
    ordered = itemgetter(*kind.orders) if numbers else None
    return kind, kind.unpacker.unpack, kind.unpacker.size, ordered


def _field(values: tuple[Any, ...]) -> Any:
    first = values[0]
    if isinstance(first, bytes):
        return first.rstrip(b"\0")
    return first if len(values) == 1 else list(values)

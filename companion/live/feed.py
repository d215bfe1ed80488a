"""A producer's end of the live view: records of a kind that somebody looks at leave for it, all others cost a look.

The live process tells by one shared number which kinds are looked at, a bit each. While nobody looks no record is
copied, no thread runs and nothing is sent; what does not fit while somebody looks is dropped, as at the recorder.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import socket
from dataclasses import dataclass
from typing import Any

from companion.adapters.recordings.mcap.channels import CHANNELS, Recordable
from companion.adapters.recordings.mcap.recorder_client import RecorderClient
from companion.records import Frame, FramePair, Notice, ParameterChange, Side

_CAPACITY_BYTES = 4 << 20  # bound of memory: some images wait; what does not fit is dropped
_IMAGE_PERIOD_NS = 500_000_000  # chosen: two pairs a second show that cameras live, and cost the vision process little
_PARTNER_NS = 20_000_000  # chosen: both images of a pair are exposed within it

BIT: dict[type, int] = {kind: 1 << place for place, kind in enumerate((Frame, *CHANNELS))} | {FramePair: 1}
RECORDED: int = sum(BIT[kind] for kind in CHANNELS)
"""Kinds that the page's own recordings take: all but images, of which only two a second come."""
ALWAYS: int = BIT[ParameterChange] | BIT[Notice]
"""Kinds that the live view follows although nobody looks: rare, and wanted by who comes later."""


class Interest:
    """Kinds of record that somebody looks at, shared between processes without a lock: one writes, the others read."""

    def __init__(self) -> None:
        self._mask: Any = multiprocessing.get_context("spawn").RawValue(ctypes.c_uint64, ALWAYS)

    @property
    def mask(self) -> int:
        """Bits of :data:`BIT`."""
        value: int = self._mask.value
        return value

    @mask.setter
    def mask(self, value: int) -> None:
        self._mask.value = value

    def view(self) -> memoryview:
        """The number in place, for who reads it for every record."""
        return memoryview(self._mask).cast("B").cast("Q")


@dataclass(slots=True)
class ImagePace:
    """Lets a pair of images pass twice a second, by the images' own times."""

    last_ns: int | None = None
    partner: Side | None = None

    def take(self, frame: Frame) -> bool:
        """Whether this frame is to be shown: the first after the pause, and then its partner."""
        if self.last_ns is None or abs(frame.mid_exposure_ns - self.last_ns) >= _IMAGE_PERIOD_NS:
            self.last_ns, self.partner = frame.mid_exposure_ns, Side(1 - frame.side)
            return True
        if frame.side is self.partner and abs(frame.mid_exposure_ns - self.last_ns) <= _PARTNER_NS:
            self.partner = None
            return True
        return False


@dataclass(frozen=True, slots=True)
class FeedEnd:
    """Everything that a producing process needs for its feed; picklable for a process that is started."""

    end: socket.socket
    interest: Interest


class LiveFeed:
    """The recorder port towards the live view, in a producing process; to be used from one thread."""

    def __init__(self, feed_end: FeedEnd) -> None:
        self._end = feed_end.end
        self._mask = feed_end.interest.view()
        self._client: RecorderClient | None = None
        self._pace = ImagePace()

    @property
    def dropped(self) -> int:
        """Records that the live view did not take."""
        return 0 if self._client is None else self._client.dropped

    def write(self, record: Recordable) -> None:
        """Hand over one record if somebody looks at its kind; never blocks."""
        if not self._mask[0] & BIT[type(record)]:
            return
        if isinstance(record, Frame) and not self._pace.take(record):
            return
        if self._client is None:
            self._client = RecorderClient(self._end, _CAPACITY_BYTES)
        self._client.write(record)

    def close(self) -> None:
        """Send what waits, and end."""
        if self._client is not None:
            self._client.close()

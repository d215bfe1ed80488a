"""Writes our own recordings: MCAP files whose messages stand in arrival order.

The file begins with what a replay needs (metadata ``spanwise``, attachments ``airframe.toml`` and ``settings.toml``); a
chunk is closed after a second of recorded time, so that a crash costs no more; metadata ``spanwise.end`` tells an
orderly end. The message's sequence number counts all records of the file.
"""

from __future__ import annotations

import contextlib
import os
import time
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

from mcap.writer import Writer

from companion.adapters.recordings.mcap.channels import CAMERA_TOPICS, CHANNELS, Recordable, topic_of
from companion.adapters.recordings.mcap.images import ImageFormat
from companion.adapters.recordings.mcap.machine import machine
from companion.adapters.recordings.mcap.messages import MessageForm, form_of, image_form, image_message, message_of
from companion.errors import RecordingError
from companion.params.airframe import Airframe
from companion.params.files import dump_airframe
from companion.params.persist import sync_folder
from companion.params.settings import Settings
from companion.rate_limiter import RateLimiter
from companion.records import ClockName, Frame, FramePair

FORMAT_VERSION = 1  # of our profile; raised where an old reader would misread (convention)
_CHUNK_NS = 1_000_000_000  # chosen: a crash costs a second at most
_SYNC_PERIOD_NS = 1_000_000_000  # chosen: as often as a chunk is closed; flash is not worn by more
_force = getattr(os, "fdatasync", os.fsync)  # not every system has the quicker one
_CHUNK_BYTES = 4 * 1024 * 1024  # chosen: several images fit in; the reader's memory per chunk stays small


@dataclass(frozen=True, slots=True)
class About:
    """Metadata of a recording: everything besides the records that a replay needs.

    ``part_number`` counts the files of one run of the service: only the first begins with the estimation itself.
    """

    airframe_text: str
    settings_text: str
    hub: ClockName = ClockName.HOST
    image_format: ImageFormat = ImageFormat.PNG
    part_number: int = 1

    @classmethod
    def of(
        cls,
        airframe: Airframe,
        settings: Settings,
        hub: ClockName = ClockName.HOST,
        image_format: ImageFormat = ImageFormat.PNG,
    ) -> About:
        """Describe a recording by the values in force when it starts."""
        return cls(dump_airframe(airframe), dump_settings(settings), hub, image_format)


def dump_settings(settings: Settings) -> str:
    """Write settings as TOML lines ``NAME = value``, by MAVLink name."""
    return "".join(f"{name} = {value!r}\n" for name, value in settings.values().items())


class McapWriter:
    """A recorder in this process and thread; :mod:`companion.adapters.recordings.mcap.recorder` puts it into one of
    its own.

    ``size_bytes`` is the size of the file when it was last flushed, ``synced_bytes`` when it was last forced to the
    disk, which only :meth:`sync` does.

    Raises
    ------
    RecordingError
        The file cannot be created, or a record has no place in a recording.
    """

    def __init__(self, path: Path, about: About) -> None:
        try:
            self._file = path.open("wb")
        except OSError as error:
            raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error
        self._path = path
        self._format = about.image_format
        self._flushed = 0
        self.size_bytes = self.synced_bytes = 0
        self._syncs = RateLimiter(_SYNC_PERIOD_NS)
        self._writer = Writer(self._file, chunk_size=_CHUNK_BYTES)
        self._channels: dict[str, int] = {}
        self._sequence = 0
        self._latest_ns = 0
        self._chunk_start_ns: int | None = None
        self._dropped = 0
        try:
            self._begin(about)
        except OSError as error:
            self.abandon()
            raise RecordingError(f"{path}: cannot be written: {error.strerror}") from error

    def _begin(self, about: About) -> None:
        self._writer.start(profile="spanwise", library=f"spanwise {software_version()}")
        facts = {
            "format": str(FORMAT_VERSION),
            "software": software_version(),
            "machine": machine(),
            "hub": str(about.hub),
            "images": str(about.image_format),
            "part": str(about.part_number),
        }
        self._writer.add_metadata("spanwise", facts)
        for name, text in (("airframe.toml", about.airframe_text), ("settings.toml", about.settings_text)):
            self._writer.add_attachment(0, 0, name, "application/toml", text.encode())
        self._writer.flush()

    def write(self, record: Recordable) -> None:
        """Append one record; raise RecordingError for something that is not a record."""
        if isinstance(record, FramePair):
            for frame in (record.left, record.right):
                self._write_frame(frame, record.pair_id)
        elif isinstance(record, Frame):
            self._write_frame(record, None)
        else:
            self._write_plain(record)
        self._sequence += 1

    def note_drops(self, count: int) -> None:
        """Mark the recording as not replayable: ``count`` further records are missing somewhere from here on."""
        self._dropped += count
        self.flush()
        self._writer.add_metadata("spanwise.drops", {"dropped": str(self._dropped), "after": str(self._sequence)})

    def flush(self) -> None:
        """Close the chunk in progress and hand it to the operating system."""
        self._writer.flush()
        self._chunk_start_ns = None
        self._flushed = self._sequence
        self.size_bytes = self._file.tell()

    def sync(self) -> None:
        """Force to the disk what the operating system has, lest a power cut take half a minute; may take seconds."""
        self._file.flush()
        if self._path.is_file():  # a device has no disk behind it
            _force(self._file.fileno())
            if not self.synced_bytes:
                sync_folder(self._path.parent)
        self.synced_bytes = self.size_bytes

    def keep_synced(self) -> None:
        """:meth:`sync` where there is something to force to the disk, once a second at most."""
        if self.size_bytes > self.synced_bytes and self._syncs.take(time.monotonic_ns()):
            self.sync()

    def abandon(self) -> None:
        """Close a file that cannot be written any further; one without any record in it is removed."""
        with contextlib.suppress(OSError):
            self._file.close()
        if not self._flushed and self._path.is_file():  # a device is not ours to remove
            self._path.unlink(missing_ok=True)

    def close(self, *, sync: bool = False) -> None:
        """Finish the file, and with ``sync`` force it to the disk; further calls do nothing."""
        if self._file.closed:
            return
        self._writer.flush()
        self._writer.add_metadata("spanwise.end", {"records": str(self._sequence), "dropped": str(self._dropped)})
        self._writer.finish()
        if sync:
            self.sync()
        self._file.close()

    def _write_plain(self, record: Any) -> None:
        listed = CHANNELS.get(type(record))
        if listed is None:
            raise RecordingError(f"{type(record).__name__} has no place in a recording")
        topic = topic_of(record)
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._register(topic, form_of(listed))
        self._add(channel, *message_of(record))

    def _write_frame(self, frame: Frame, pair_id: int | None) -> None:
        topic = CAMERA_TOPICS[frame.side]
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._register(topic, image_form())
        self._add(channel, self._latest_ns, image_message(frame, pair_id, self._format))

    def _register(self, topic: str, form: MessageForm) -> int:
        schema = self._writer.register_schema(form.schema_name, form.schema_encoding, form.schema)
        channel = self._channels[topic] = self._writer.register_channel(topic, form.encoding, schema)
        return int(channel)

    def _add(self, channel: int, host_ns: int, data: bytes) -> None:
        host_ns = max(int(host_ns), 0)
        self._latest_ns = max(self._latest_ns, host_ns)
        self._writer.add_message(channel, host_ns, data, host_ns, self._sequence)
        if self._chunk_start_ns is None:
            self._chunk_start_ns = self._latest_ns
        elif self._latest_ns - self._chunk_start_ns >= _CHUNK_NS:
            self.flush()


def software_version() -> str:
    """Version of the installed distribution."""
    return metadata.version("spanwise")

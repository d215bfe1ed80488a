"""Telemetry logs of ground stations: repeated [8-byte big-endian receive time, us UTC][one MAVLink frame].

A tlog is replayed in the autopilot's boot clock: every ``_host_ns`` is the newest inertial stamp that had arrived,
because the ground station's clock drifts against the autopilot's and may step. If the autopilot restarts inside the
log, the stamps after it are shifted so that time goes on, by as much as passed on the ground.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.mavlink.decode.bulk import next_frame
from companion.adapters.mavlink.decode.decoder import Decoder
from companion.adapters.mavlink.link.dialect import NAME_OF
from companion.adapters.mavlink.link.scan import MAGIC_1, MAGIC_2, frame_end
from companion.adapters.recordings.mcap.channels import CHANNELS
from companion.adapters.recordings.recording import LoggedRecording
from companion.errors import RecordingError
from companion.params.airframe import Airframe
from companion.records import ClockName, ClockRestart, ImuBatch, Ints, RawChunk, Record, Station, VehicleState

_STAMP = 8  # bytes of the big-endian microseconds before each frame (MAVProxy, mavutil; convention)
_CHUNK_US = 20_000  # chosen: as a live read: two ticks of the service at 100 Hz
_CHUNK_FRAMES = 128  # chosen: frames decoded together: a chunk without stamps of its own stays short
# of the receive time; a longer one is believed where the next frame agrees with it (choice)
_LONGEST_STEP_US = 3_600_000_000
EARLIEST_US = 946_684_800_000_000
"""The year 2000, UTC in microseconds: an autopilot without GPS tells 0 (choice)."""


class TlogRecording(LoggedRecording):
    """A tlog, decoded by the same decoder as a live link; see :class:`LoggedRecording` for its attributes.

    ``read_share`` is the share of the file's bytes that the last iteration has passed, 0 to 1: its length in time is
    unknown until then.

    Raises
    ------
    RecordingError
        No frame in the file, or the airframe's sources are not all on the autopilot's clock.
    """

    def __init__(self, path: Path, airframe: Airframe) -> None:
        super().__init__(path, airframe, ClockName.BOOT)
        self._data = path.read_bytes()
        self.read_share = 0.0
        if next(self.chunks(), None) is None:
            raise RecordingError(f"{path}: no MAVLink frame with a receive time in it: not a tlog, or empty")
        foreign = [s.name.lower() for s in Station if airframe.sensor(s).source.clock is not ClockName.BOOT]
        if foreign:
            raise RecordingError(
                f"{path}: a telemetry log has the autopilot's clock alone, and airframe '{airframe.name}' has the "
                f"{' and '.join(foreign)} sensor on another clock: its samples cannot be put in time. Give the .mcap "
                "that Spanwise recorded on this flight; or, where the autopilot's own sensors are meant, an airframe "
                "with nothing but them, such as --airframe sitl-plane"
            )

    def chunks(self) -> Iterator[RawChunk]:
        """The frames without their stamps, about 20 ms in one chunk; ``received_host_ns`` is the UTC receive time."""
        start_us = last_us = 0
        frames: list[bytes] = []
        for stamp_us, frame in self.frames():
            if frames and (stamp_us - start_us >= _CHUNK_US or len(frames) >= _CHUNK_FRAMES):
                yield RawChunk(0, last_us * 1000, b"".join(frames))
                frames = []
            if not frames:
                start_us = stamp_us
            frames.append(frame)
            last_us = stamp_us
        if frames:
            yield RawChunk(0, last_us * 1000, b"".join(frames))

    def frames(self) -> Iterator[tuple[int, bytes]]:
        """Every frame with its UTC receive time in us; damage is stepped over and named in the notices."""
        data, end, at, skipped_from, last_us = self._data, len(self._data), 0, -1, 0
        while at < end:
            if skipped_from >= 0 and at + _STAMP < end and frame_end(data, at + _STAMP) < 0:
                at = max(next_frame(data, at + _STAMP + 1) - _STAMP, at + 1)
                continue
            size = _frame_bytes(data, at + _STAMP)
            after = at + _STAMP + size
            stamp_us = self._stamp_us(at)
            good = size and after <= end and (_plausible(stamp_us, last_us) or self._resumes(at, after))
            if good:
                if skipped_from >= 0:
                    text = f"{at - skipped_from} bytes at byte {skipped_from} are no frames, skipped"
                    self.notes.add(f"{self.path}: {text}")
                    skipped_from = -1
                self.read_share = after / end
                yield stamp_us, data[at + _STAMP : after]
                last_us, at = stamp_us, after
            else:
                skipped_from = at if skipped_from < 0 else skipped_from
                at += 1
        if skipped_from >= 0:
            self.say(f"truncated: the last {end - skipped_from} bytes are no whole frame, left out")

    def _resumes(self, at: int, after: int) -> bool:
        """Whether logging went on here after a pause or a step of the clock: two whole frames agree on a new time."""
        data, stamp_us, following = self._data, self._stamp_us(at), after + _STAMP
        if not _plausible(stamp_us, 0) or frame_end(data, at + _STAMP) != after or following >= len(data):
            return False
        return _plausible(self._stamp_us(after), stamp_us) and frame_end(data, following) > 0

    def _stamp_us(self, at: int) -> int:
        return int.from_bytes(self._data[at : at + _STAMP], "big")

    def records(self) -> Iterator[Record]:
        """Records of the frames, in arrival order, in the autopilot's clock."""
        decoder = Decoder(self.airframe, component_id=0)
        timeline = _Timeline()
        stamps: dict[Station, list[Ints]] = {station: [] for station in Station}
        for chunk in self.chunks():
            for record in timeline.place(decoder.decode_chunk(chunk), chunk.received_host_ns):
                if isinstance(record, ImuBatch):
                    stamps[record.station].append(record.t_ns)
                yield record
        for t_ns in timeline.restarts_ns:
            self.say(f"the autopilot restarted; its clock goes on at {t_ns / 1e9:.1f} s", t_ns)
        self._report_streams(stamps, decoder)

    def _report_streams(self, stamps: dict[Station, list[Ints]], decoder: Decoder) -> None:
        for station, parts in stamps.items():
            source = self.airframe.sensor(station).source
            name = f"{self.path.name}: {station.name.lower()} ({source.message} of component {source.component})"
            if parts:
                self.notes.gaps(name, np.concatenate(parts))
            else:
                delivered = {f"{NAME_OF[message]} of {component}" for message, component in decoder.delivered}
                inertial = sorted(entry for entry in delivered if "IMU" in entry) or ["none"]
                self.notes.add(f"{name}: no samples; inertial messages in this log: {', '.join(inertial)}")


class _Timeline:
    """Puts decoded records into the autopilot's clock, going on where that clock restarts."""

    def __init__(self) -> None:
        self.restarts_ns: list[int] = []
        self._shift_ns = 0
        self._newest_ns = 0
        self._sampled_utc_ns = 0

    def place(self, records: list[Record], received_utc_ns: int) -> Iterator[Record]:
        """Give the records with stamps in the continued clock, arrived at the newest inertial stamp so far."""
        restarted = False
        for record in records:
            if isinstance(record, ClockRestart):
                restarted = True
                continue
            if isinstance(record, ImuBatch):
                if restarted:
                    self._go_on(int(record.t_ns[0]), received_utc_ns)
                    restarted = False
                record = dataclasses.replace(record, t_ns=record.t_ns + self._shift_ns)
                self._newest_ns = max(self._newest_ns, int(record.t_ns.max()))
                self._sampled_utc_ns = received_utc_ns
            elif isinstance(record, VehicleState):
                record = dataclasses.replace(record, t_boot_ns=record.t_boot_ns + self._shift_ns)
            changes: dict[str, Any] = {CHANNELS[type(record)].time: self._newest_ns}
            yield dataclasses.replace(record, **changes)

    def _go_on(self, first_ns: int, received_utc_ns: int) -> None:
        passed_ns = max(received_utc_ns - self._sampled_utc_ns, 0)
        self._shift_ns = self._newest_ns + passed_ns - first_ns
        self.restarts_ns.append(self._newest_ns + passed_ns)


def _frame_bytes(data: bytes, at: int) -> int:
    """Length of the frame that begins here by its header, 0 where none does."""
    if at + 3 > len(data):
        return 0
    if data[at] == MAGIC_2:
        return 12 + data[at + 1] + (13 if data[at + 2] & 1 else 0)
    return 8 + data[at + 1] if data[at] == MAGIC_1 else 0


def _plausible(stamp_us: int, last_us: int) -> bool:
    return abs(stamp_us - last_us) < _LONGEST_STEP_US if last_us else EARLIEST_US < stamp_us < 4 * EARLIEST_US

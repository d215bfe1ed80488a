"""Which topic a record goes to, which stamp is its log time, and how it is encoded: the table of our MCAP files."""

from __future__ import annotations

import dataclasses
import typing
from dataclasses import dataclass

from companion.adapters.recordings.mcap import ros1_codec
from companion.records import (
    AutopilotParameter,
    CameraFeedback,
    ClockRestart,
    ClockState,
    CorrectedRange,
    Deflection,
    Frame,
    FramePair,
    ImuBatch,
    MatchSet,
    ModeState,
    NoRange,
    Notice,
    ObstacleSectors,
    ParameterChange,
    RawChunk,
    Record,
    Rejected,
    RelativeRotation,
    ServiceStatus,
    Shot,
    Tick,
    TimesyncReply,
    TriggerLatency,
    TriggerPlan,
    VehicleState,
)

Recordable = Record | Frame | FramePair
SENT_LINK = 128
"""Link numbers from here on are of chunks that we sent; the MAVLink decoder's OUTGOING."""


@dataclass(frozen=True, slots=True)
class McapChannel:
    """One kind of record: its topic, whose braces ``topic_of`` fills in, and the attribute that is its host time."""

    kind: type
    topic: str
    time: str

    @property
    def schema_name(self) -> str:
        """Name of the MCAP schema, by which the reader knows the record's class."""
        return f"spanwise/{self.kind.__name__}" if self.is_ros1 else f"spanwise.{self.kind.__name__}"

    @property
    def is_ros1(self) -> bool:
        """Whether the record is stored as a ROS 1 message instead of JSON."""
        return self.kind in ros1_codec.SCHEMAS


def topic_of(record: Recordable) -> str:
    """The topic of one record, which is not an image."""
    topic = CHANNELS[type(record)].topic
    if isinstance(record, ImuBatch):
        return topic.format(station=record.station.name.lower())
    if isinstance(record, RawChunk):
        return topic.format(direction="sent" if record.link >= SENT_LINK else "received")
    return topic


def _channel(kind: type) -> McapChannel:
    stamps = [entry.name for entry in dataclasses.fields(kind) if entry.name.endswith("_host_ns")]
    topic, time = _LISTED.get(kind, (f"/other/{kind.__name__}", stamps[0]))
    return McapChannel(kind, topic, time)


_IMAGES = (Frame, FramePair)  # compressed; see images.py

# topic and log time; a record that is not listed goes to /other/<Name> with its first host stamp
_LISTED: dict[type, tuple[str, str]] = {
    RawChunk: ("/mavlink/{direction}", "received_host_ns"),
    ImuBatch: ("/imu/{station}", "received_host_ns"),
    TimesyncReply: ("/time/exchange", "received_host_ns"),
    ClockRestart: ("/time/restart", "seen_host_ns"),
    ClockState: ("/time/clock", "at_host_ns"),
    VehicleState: ("/vehicle/state", "received_host_ns"),
    AutopilotParameter: ("/vehicle/parameter", "received_host_ns"),
    ParameterChange: ("/parameter", "changed_host_ns"),
    Tick: ("/tick", "now_host_ns"),
    MatchSet: ("/vision/matches", "matched_host_ns"),
    Shot: ("/trigger/shot", "fired_host_ns"),
    CameraFeedback: ("/trigger/feedback", "received_host_ns"),
    TriggerPlan: ("/trigger/plan", "planned_host_ns"),
    TriggerLatency: ("/trigger/latency", "at_host_ns"),
    ModeState: ("/wing/mode", "t_host_ns"),
    Deflection: ("/wing/deflection", "t_host_ns"),
    CorrectedRange: ("/range/corrected", "t_host_ns"),
    RelativeRotation: ("/wing/rotation", "t_host_ns"),
    NoRange: ("/range/none", "at_host_ns"),
    ObstacleSectors: ("/range/sectors", "t_host_ns"),
    Rejected: ("/status/rejected", "at_host_ns"),
    Notice: ("/status/notice", "at_host_ns"),
    ServiceStatus: ("/status/service", "at_host_ns"),
}
CHANNELS: dict[type, McapChannel] = {kind: _channel(kind) for kind in typing.get_args(Record) if kind not in _IMAGES}
CAMERA_TOPICS = ("/camera/left", "/camera/right")
IMAGE_SCHEMA = "foxglove.CompressedImage"
KINDS: dict[str, type] = {channel.schema_name: kind for kind, channel in CHANNELS.items()}

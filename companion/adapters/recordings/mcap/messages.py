"""Records as messages: bytes and schema of each kind, the same in a recording and in the live view."""

from __future__ import annotations

import json
from dataclasses import dataclass

from companion.adapters.recordings.mcap import images, ros1_codec
from companion.adapters.recordings.mcap.channels import CHANNELS, IMAGE_SCHEMA, McapChannel
from companion.adapters.recordings.mcap.codec import codec_of, dumps
from companion.adapters.recordings.mcap.images import ImageFormat
from companion.records import Frame, Record


@dataclass(frozen=True, slots=True)
class MessageForm:
    """Encoding of the messages of a channel, and the schema that describes them."""

    encoding: str
    schema_name: str
    schema_encoding: str
    schema: bytes


def form_of(listed: McapChannel) -> MessageForm:
    """Give the form of a kind of record."""
    if listed.is_ros1:
        return MessageForm("ros1", listed.schema_name, "ros1msg", ros1_codec.SCHEMAS[listed.kind].encode())
    text = json.dumps({"title": listed.schema_name, **codec_of(listed.kind).schema})
    return MessageForm("json", listed.schema_name, "jsonschema", text.encode())


def image_form() -> MessageForm:
    """Give the form of images."""
    return MessageForm("json", IMAGE_SCHEMA, "jsonschema", json.dumps(images.SCHEMA).encode())


def message_of(record: Record) -> tuple[int, bytes]:
    """Log time (host ns) and bytes of a record that is no image."""
    listed = CHANNELS[type(record)]
    data = ros1_codec.pack(record) if listed.is_ros1 else dumps(listed.kind, record)
    return getattr(record, listed.time), data


def image_message(frame: Frame, pair_id: int | None, image_format: ImageFormat) -> bytes:
    """Bytes of an image, compressed."""
    return json.dumps(images.frame_to_plain(frame, pair_id, image_format)).encode()

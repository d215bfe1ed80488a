"""Our own recordings: every record comes back equal, in order, and up to a cut."""

from __future__ import annotations

import contextlib
import functools
import json
import struct
import typing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from companion.adapters.mavlink.decode.decoder import OUTGOING
from companion.adapters.recordings.mcap import channels
from companion.adapters.recordings.mcap.container import covered_s
from companion.adapters.recordings.mcap.images import ImageFormat
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.mcap.ros1_codec import pack, unpack
from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.adapters.recordings.recording_factory import open_recording
from companion.errors import RecordingError
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import (
    Axis,
    ClockName,
    ClockState,
    Frame,
    FramePair,
    ImuBatch,
    Notice,
    ParameterChange,
    RawChunk,
    Record,
    Side,
    Station,
    Tick,
)
from sitl_tests.unit.recordings_help import assert_equal, record_of

KINDS = typing.get_args(Record)
SECOND = 1_000_000_000


@functools.cache
def about(image_format: ImageFormat = ImageFormat.PNG) -> About:
    return About.of(load_airframe("nadir-2m"), Settings(), image_format=image_format)


def write(path: Path, records: list[channels.Recordable], image_format: ImageFormat = ImageFormat.PNG) -> McapRecording:
    writer = McapWriter(path, about(image_format))
    for record in records:
        writer.write(record)
    writer.close()
    return McapRecording(path)


def seconds_of_flight(count: int) -> list[channels.Recordable]:
    """Ten ticks and ten batches a second."""
    records: list[channels.Recordable] = []
    for i in range(10 * count):
        t_ns = 5 * SECOND + i * SECOND // 10
        records += [
            RawChunk(0, t_ns, bytes(range(i % 50))),
            ImuBatch(Station.LEFT, ClockName.HOST, np.array([t_ns]), np.full((1, 6), 0.1 * i), Axis.ALL, t_ns),
            Tick(t_ns),
        ]
    return records


def host_ns(record: channels.Recordable) -> int:
    return int(getattr(record, channels.CHANNELS[type(record)].time))


def frame(side: Side, sequence: int) -> Frame:
    image = np.random.default_rng(sequence).integers(0, 256, (48, 64), dtype=np.uint8)
    return Frame(side, sequence, ClockName.HOST, 10**9 + sequence, 2_000_000, 0, 7, image)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_every_record_comes_back_equal(kind: type, data: st.DataObject, tmp_path: Path) -> None:
    records = data.draw(st.lists(record_of(kind), min_size=1, max_size=3))
    back = list(write(tmp_path / "one.mcap", records).records())
    assert len(back) == len(records)
    for before, after in zip(records, back, strict=True):
        assert_equal(before, after)


def test_every_record_class_has_a_topic_of_its_own_and_a_host_time() -> None:
    listed = [channels.CHANNELS[kind] for kind in KINDS if kind not in (Frame, FramePair)]
    assert len({channel.topic for channel in listed}) == len(listed)
    for channel in listed:
        assert typing.get_type_hints(channel.kind)[channel.time] is int
        assert channel.time.endswith("_host_ns")


def test_records_of_all_kinds_keep_their_arrival_order_even_when_their_times_do_not(tmp_path: Path) -> None:
    records: list[channels.Recordable] = []
    for i in range(300):
        records += [Tick(10**9 - i), Notice(6, str(i), 5 * 10**8), ParameterChange("TRG_RATE", i / 7, i)]
    back = list(write(tmp_path / "order.mcap", records).records())
    assert back == records


def test_what_a_replay_needs_travels_with_the_records(tmp_path: Path) -> None:
    changed = Settings().replace("TRK_LAG", 0.3).replace("TRG_RATE", 7.7)
    airframe = load_airframe("nadir-2m")
    McapWriter(tmp_path / "a.mcap", About.of(airframe, changed, ClockName.BOOT)).close()
    recording = McapRecording(tmp_path / "a.mcap")
    assert recording.airframe == airframe
    assert recording.settings == changed
    assert recording.hub is ClockName.BOOT
    assert recording.replayable
    assert recording.notices == []


def test_what_we_sent_has_a_topic_of_its_own() -> None:
    assert channels.SENT_LINK == OUTGOING
    assert channels.topic_of(RawChunk(0, 1, b"")) == "/mavlink/received"
    assert channels.topic_of(RawChunk(OUTGOING, 1, b"")) == "/mavlink/sent"


def test_an_unsent_column_that_is_not_zero_is_kept() -> None:
    values = np.zeros((2, 6))
    values[1, 4] = -0.0
    batch = ImuBatch(Station.ROOT, ClockName.BOOT, np.array([1, 2]), values, Axis.Z, 3)
    assert_equal(unpack(ImuBatch, pack(batch)), batch)
    lean = ImuBatch(Station.ROOT, ClockName.BOOT, np.array([1, 2]), np.zeros((2, 6)), Axis.Z, 3)
    assert len(pack(lean)) < len(pack(batch))


@pytest.mark.parametrize("chunk", [0, 3, 7])
def test_a_file_cut_off_gives_everything_up_to_the_last_complete_chunk(tmp_path: Path, chunk: int) -> None:
    records = seconds_of_flight(10)
    path = tmp_path / "cut.mcap"
    write(path, records)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    struck = summary.chunk_indexes[chunk]
    path.write_bytes(path.read_bytes()[: struck.chunk_start_offset + struck.chunk_length - 1])
    recording = McapRecording(path)
    back = list(recording.records())
    before_the_cut = [record for record in records if host_ns(record) < struck.message_start_time]
    assert len(back) >= len(before_the_cut)
    assert host_ns(records[len(back)]) <= struck.message_start_time, "at most the struck chunk is lost"
    for before, after in zip(records[: len(back)], back, strict=True):
        assert_equal(before, after)
    assert struck.message_end_time - struck.message_start_time <= 1.2 * SECOND
    assert [notice for notice in recording.notices if "truncated at" in notice.text]


def test_every_possible_cut_is_read_or_refused_in_words(tmp_path: Path) -> None:
    path, short = tmp_path / "whole.mcap", tmp_path / "short.mcap"
    records = seconds_of_flight(2)
    write(path, records)
    all_bytes = path.read_bytes()
    counts = []
    for size in range(0, len(all_bytes), 97):
        short.write_bytes(all_bytes[:size])
        if counts:
            counts.append(len(list(McapRecording(short).records())))
        else:
            with contextlib.suppress(RecordingError):
                counts.append(len(list(McapRecording(short).records())))
    assert counts == sorted(counts)
    assert counts[0] == 0
    assert counts[-1] == len(records)


def test_a_clock_that_was_never_read_does_not_begin_the_recording(tmp_path: Path) -> None:
    began_ns, ended_ns = 5_000_000_000_000, 5_003_000_000_000
    path, random = tmp_path / "a.mcap", np.random.default_rng(1)
    writer = McapWriter(path, About.of(load_airframe("nadir-2m"), Settings()))
    writer.write(ClockState(ClockName.BOOT, 0, 0, 0.0, 1_000_000_000, synced=False))
    for now_ns in range(began_ns, ended_ns + 1, 100_000_000):
        writer.write(RawChunk(0, now_ns, random.bytes(2000)))
    writer.close()
    assert McapRecording(path).span_ns() == (began_ns, ended_ns)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    (notice,) = [each.text for each in McapRecording(cut).notices if "truncated at" in each.text]
    assert 0.0 < float(notice.partition("truncated at ")[2].partition(" s")[0]) <= 3.0


def test_a_damaged_chunk_is_left_out_and_named(tmp_path: Path) -> None:
    path = tmp_path / "damaged.mcap"
    records = seconds_of_flight(5)
    write(path, records)
    data = bytearray(path.read_bytes())
    segment = [mcap_record for mcap_record in McapRecording(path)._segments if mcap_record.opcode == 6][2]
    data[segment.offset + segment.length // 2] ^= 0xFF
    path.write_bytes(bytes(data))
    recording = McapRecording(path)
    back = list(recording.records())
    assert 0 < len(back) < len(records)
    assert not recording.replayable
    assert "damaged" in recording.notices[0].text


def test_dropped_records_make_it_not_replayable_even_when_cut_off_later(tmp_path: Path) -> None:
    path = tmp_path / "drops.mcap"
    writer = McapWriter(path, about())
    writer.write(Tick(1))
    writer.note_drops(3)
    writer.write(Tick(2))
    writer.note_drops(2)
    writer.flush()
    for state in ("running", "closed"):
        recording = McapRecording(path)
        assert not recording.replayable
        assert recording.dropped == 5
        assert any("5 records were dropped" in notice.text for notice in recording.notices), state
        writer.close()


def test_png_images_come_back_bit_equal_and_paired(tmp_path: Path) -> None:
    records = [FramePair(i, frame(Side.LEFT, i), frame(Side.RIGHT, i)) for i in range(3)] + [frame(Side.RIGHT, 9)]
    recording = write(tmp_path / "images.mcap", records)
    assert recording.images is ImageFormat.PNG
    for before, after in zip(records, recording.records(), strict=True):
        assert_equal(before, after)


def test_jpeg_images_are_said_to_be_lossy(tmp_path: Path) -> None:
    recording = write(tmp_path / "lossy.mcap", [frame(Side.LEFT, 1)], ImageFormat.JPEG)
    assert recording.images is ImageFormat.JPEG
    (back,) = recording.records()
    assert isinstance(back, Frame)
    assert back.image.shape == (48, 64)


def test_an_independent_reader_sees_messages_that_its_schemas_describe(tmp_path: Path) -> None:
    records = [*seconds_of_flight(2), FramePair(1, frame(Side.LEFT, 1), frame(Side.RIGHT, 1))]
    write(tmp_path / "foxglove.mcap", records)
    schema_names = set()
    with (tmp_path / "foxglove.mcap").open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            if schema.encoding == "jsonschema":
                plain = json.loads(message.data)
                assert plain.keys() == json.loads(schema.data)["properties"].keys()
            else:
                assert (schema.encoding, channel.message_encoding) == ("ros1msg", "ros1")
                assert ros1(schema.data.decode(), message.data)
            schema_names.add(schema.name)
    assert schema_names == {"spanwise/RawChunk", "spanwise/ImuBatch", "spanwise.Tick", "foxglove.CompressedImage"}


@settings(max_examples=30, deadline=None)
@given(batch=record_of(ImuBatch))
def test_the_packed_form_is_what_its_schema_text_says(batch: ImuBatch) -> None:
    plain = ros1(channels.ros1_codec.SCHEMAS[ImuBatch], pack(batch))
    assert plain["clock"] == batch.clock.encode()
    assert plain["t_ns"] == tuple(batch.t_ns.tolist())
    stored = [i for i in range(6) if plain["columns"] >> i & 1]
    assert np.array(plain["values"]).tobytes() == batch.values[:, stored].tobytes()


def ros1(definition: str, data: bytes) -> dict[str, typing.Any]:
    """A small reader of ROS 1 messages, driven by the message definition alone."""
    letters = {"uint8": "B", "int32": "i", "int64": "q", "float64": "d"}
    fields: dict[str, typing.Any] = {}
    at = 0
    for line in definition.splitlines():
        if line.startswith("#"):
            continue
        kind, name = line.split()
        count, letter = 1, "s" if kind == "string" else letters[kind.removesuffix("[]")]
        if kind == "string" or kind.endswith("[]"):
            (count,) = struct.unpack_from("<I", data, at)
            at += 4
        values = struct.unpack_from(f"<{count}{letter}", data, at)
        at += struct.calcsize(f"<{count}{letter}")
        fields[name] = values if kind.endswith("[]") else values[0]
    assert at == len(data)
    return fields


def test_foreign_and_missing_files_are_refused_in_words(tmp_path: Path) -> None:
    from mcap.writer import Writer

    with (tmp_path / "foreign.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.finish()
    with pytest.raises(RecordingError, match="not a recording of Spanwise"):
        open_recording(tmp_path / "foreign.mcap")
    with pytest.raises(RecordingError, match=r"no-such\.mcap: no such file"):
        open_recording(tmp_path / "no-such.mcap")
    with pytest.raises(RecordingError, match="cannot be written"):
        McapWriter(tmp_path / "no" / "folder.mcap", about())


def test_chunks_that_overlap_are_not_lost_twice() -> None:
    second_ns = 1_000_000_000
    spans_s = [(4, 6), (1, 3), (2, 4), (0, 0), (2, 3), (8, 9)]
    assert covered_s((start * second_ns, end * second_ns) for start, end in spans_s) == pytest.approx(6.0)
    assert covered_s([]) == 0.0

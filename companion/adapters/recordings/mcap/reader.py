"""Reads our own MCAP recordings, whole or cut off: records come back equal, in the order of writing."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

from mcap import records as mcap
from mcap.opcode import Opcode

from companion.adapters.recordings.mcap import images, ros1_codec
from companion.adapters.recordings.mcap.channels import CAMERA_TOPICS, IMAGE_SCHEMA, KINDS, Recordable
from companion.adapters.recordings.mcap.codec import loads
from companion.adapters.recordings.mcap.container import (
    DAMAGE,
    LONGEST_CHUNK_S,
    TIME_SPAN,
    FileSegment,
    check_attachment,
    chunk_records,
    covered_s,
    learn,
    parse,
    recorded_span_ns,
    scan,
)
from companion.adapters.recordings.mcap.images import ImageFormat
from companion.adapters.recordings.mcap.writer import FORMAT_VERSION
from companion.adapters.recordings.recording import Notes
from companion.errors import RecordingError
from companion.params.airframe import Airframe
from companion.params.files import parse_airframe
from companion.params.settings import Settings, tunables
from companion.params.toml import parse_toml, settings_of
from companion.records import ClockName, Frame, FramePair, Notice, Side
from companion.units import Severity

_MOST_LETTERS = 120  # of an error in a sentence: a line of a terminal (choice)


class McapRecording:
    """One of our recordings; the attributes are those of :class:`companion.adapters.recordings.recording.Recording`.

    A given ``airframe`` replaces the recorded one. ``machine`` is what made the recording (:func:`.machine.machine`),
    "" where it is older than this entry, and ``part_number`` the number of the file among those of one run of the
    service. ``cut`` means that the recorder did not finish the file, and ``complete``, known once ``records`` is
    exhausted, that no record between the first and the last is missing. ``missing_s`` is the recorded time that was
    lost with damaged chunks and behind a cut, None where the file does not tell.

    Raises
    ------
    RecordingError
        Not an MCAP file, not one of ours, or cut off before its first second.
    """

    def __init__(self, path: Path, airframe: Airframe | None = None) -> None:
        self.path = path
        self._notes = Notes()
        self._segments, self._end = scan(path)
        self._damaged_ns: dict[int, tuple[int, int]] = {}  # by the place of the chunk
        self._drops: list[int] = []  # how many records stand before what was dropped
        try:
            facts, texts = self._header()
            self._understand(facts, texts)
        except (*DAMAGE, KeyError) as error:
            raise RecordingError(f"{path}: its header is damaged, nothing can be read ({error})") from error
        if airframe is not None:
            self.airframe = airframe
        self._say_what_is_wrong()

    def _understand(self, facts: dict[str, dict[str, str]], texts: dict[str, str]) -> None:
        if "spanwise" not in facts:
            raise RecordingError(f"{self.path}: an MCAP file, but not a recording of Spanwise (no metadata 'spanwise')")
        about = facts["spanwise"]
        if int(about["format"]) > FORMAT_VERSION:
            raise RecordingError(f"{self.path}: written by a newer Spanwise ({about['software']}); update to read it")
        if not {"airframe.toml", "settings.toml"} <= texts.keys():
            raise RecordingError(f"{self.path}: cut off before the airframe and the settings; nothing can be read")
        self.software = about["software"]
        self.machine = about.get("machine", "")
        self.hub = ClockName(about["hub"])
        self.images = ImageFormat(about["images"])
        self.airframe = parse_airframe(texts["airframe.toml"], f"{self.path} (airframe.toml)")
        self.settings = load_settings(texts["settings.toml"])
        self.dropped = int(facts.get("spanwise.drops", {}).get("dropped", "0"))
        self.part_number = int(about.get("part", "1"))
        self.complete = self.dropped == 0
        self.cut = not (self._end.orderly and "spanwise.end" in facts)
        self._finished = "spanwise.end" in facts

    @property
    def notices(self) -> list[Notice]:
        """Sentences about what is wrong with the recording or worth knowing."""
        return self._notes.notices

    @property
    def replayable(self) -> bool:
        """Whether a replay reproduces what was published: the estimation began in this file, and nothing is missing."""
        return self.complete and self.part_number == 1

    @property
    def empty(self) -> bool:
        """Whether not even the first second is in the file."""
        return not self._segments_of(Opcode.CHUNK)

    @property
    def has_images(self) -> bool:
        """Whether images may be in it: a finished file declares its channels at its end, a cut one need not."""
        return self.cut or any(topic in CAMERA_TOPICS for topic in self._declared_topics())

    @property
    def missing_s(self) -> float | None:
        """Recorded time that is lost, where the file tells; complete once ``records`` is exhausted."""
        lost_s = covered_s(self._damaged_ns.values())
        if self._finished:
            return lost_s
        behind_s = -1.0 if self._end.cut_chunk_ns is None else (self._end.cut_chunk_ns - self.span_ns()[1]) * 1e-9
        return lost_s + behind_s if 0.0 <= behind_s < LONGEST_CHUNK_S else None

    def records(self) -> Iterator[Recordable]:
        """Every record in arrival order; what is damaged is left out and named in the notices."""
        for _, record in self._numbered():
            yield record

    def records_before_loss(self) -> Iterator[Recordable]:
        """The records up to the first that is missing, because it was dropped, damaged or cut off."""
        for count, (number, record) in enumerate(self._numbered()):
            if number != count or count in self._drops[:1]:
                return
            yield record

    def _numbered(self) -> Iterator[tuple[int, Recordable]]:
        """Records with their number in the file, counted by the recorder."""
        unpaired: dict[int, Frame] = {}
        for schema, message in self._messages():
            try:
                record = _record_of(schema, message, unpaired)
            except DAMAGE as error:
                self.complete = False
                text = f"a message of '{schema.name}' is damaged and left out ({_brief(error)})"
                self._notes.add(f"{self.path.name}: {text}")
                continue
            if record is not None:
                yield message.sequence, record
            elif schema.name not in KINDS and schema.name != IMAGE_SCHEMA:
                self._notes.add(f"{self.path.name}: messages of '{schema.name}' are not known here and left out")

    def _segments_of(self, *opcodes: Opcode) -> list[FileSegment]:
        return [segment for segment in self._segments if segment.opcode in opcodes]

    def _declared_topics(self) -> list[str]:
        """Topics of the channels that are declared outside the chunks."""
        topics = []
        with self.path.open("rb") as file:
            for segment in self._segments_of(Opcode.CHANNEL):
                with contextlib.suppress(*DAMAGE):
                    topics.append(str(parse(file, segment).topic))
        return topics

    def _messages(self) -> Iterator[tuple[mcap.Schema, mcap.Message]]:
        schemas: dict[int, mcap.Schema] = {}
        channels: dict[int, mcap.Channel] = {}
        with self.path.open("rb") as file:
            for segment in self._segments_of(Opcode.SCHEMA, Opcode.CHANNEL):
                with contextlib.suppress(*DAMAGE):  # copies of what the chunks declare
                    learn(parse(file, segment), schemas, channels)
            for segment in self._segments_of(Opcode.CHUNK):
                for record in self._chunk(file, segment):
                    if not isinstance(record, mcap.Message):
                        learn(record, schemas, channels)
                    elif record.channel_id in channels and channels[record.channel_id].schema_id in schemas:
                        yield schemas[channels[record.channel_id].schema_id], record
                    else:
                        self._notes.add(
                            f"{self.path.name}: channel {record.channel_id} was declared in a damaged chunk; left out"
                        )

    def _chunk(self, file: BinaryIO, segment: FileSegment) -> list[Any]:
        try:
            return chunk_records(file, segment)
        except DAMAGE as error:
            self.complete = False
            self._damaged_ns[segment.offset] = recorded_span_ns(file, segment)
            where = f"{self.path.name}: the chunk at byte {segment.offset}"
            self._notes.add(f"{where} is damaged and left out ({_brief(error)})")
            return []

    def _header(self) -> tuple[dict[str, dict[str, str]], dict[str, str]]:
        facts: dict[str, dict[str, str]] = {}
        texts: dict[str, str] = {}
        with self.path.open("rb") as file:
            for segment in self._segments:
                if segment.opcode == Opcode.METADATA:
                    record = parse(file, segment)
                    facts[record.name] = record.metadata
                    if record.name == "spanwise.drops":
                        self._drops.append(int(record.metadata["after"]))
                elif segment.opcode == Opcode.ATTACHMENT:
                    check_attachment(file, segment)
                    record = parse(file, segment)
                    texts[record.name] = record.data.decode()
        return facts, texts

    def _say_what_is_wrong(self) -> None:
        for row in tunables():
            problem = row.check(getattr(self.settings, row.attribute))
            if problem is not None:
                self._notes.add(f"{self.path.name}: {problem}; replayed as flown", severity=Severity.INFO)
        if self.cut:
            last = self._segments[-1]
            start_ns, end_ns = self.span_ns()
            self._notes.add(
                f"{self.path.name}: truncated at {(end_ns - start_ns) / 1e9:.1f} s (byte {last.offset + last.length}): "
                "the recorder did not finish; everything before is here",
                end_ns,
            )
        if self.part_number > 1:
            self._notes.add(
                f"{self.path.name}: part {self.part_number} of a recording: settings and estimates of its start are "
                "in the parts before; a replay estimates anew",
                severity=Severity.INFO,
            )
        if self.dropped:
            self._notes.add(f"{self.path.name}: {self.dropped} records were dropped while recording; not replayable")

    def span_ns(self) -> tuple[int, int]:
        """Host times of the first and the last record, (0, 0) where there is none.

        A clock that was never read is stamped 0; such a record does not begin the recording.
        """
        spans = []
        with self.path.open("rb") as file:
            for segment in self._segments_of(Opcode.CHUNK):
                if segment.length >= TIME_SPAN.size:
                    file.seek(segment.offset)
                    start_ns, end_ns = TIME_SPAN.unpack(file.read(TIME_SPAN.size))
                    spans.append((start_ns or _first_stamp_ns(file, segment), end_ns))
        starts = [start_ns for start_ns, _ in spans if start_ns]
        return min(starts, default=0), max((end_ns for _, end_ns in spans), default=0)


def _brief(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"[:_MOST_LETTERS]


def _first_stamp_ns(file: BinaryIO, segment: FileSegment) -> int:
    """Earliest log time of a chunk after 0; 0 where there is none, or the chunk is damaged."""
    try:
        stamps = [entry.log_time for entry in chunk_records(file, segment) if isinstance(entry, mcap.Message)]
    except DAMAGE:
        return 0
    return min((stamp_ns for stamp_ns in stamps if stamp_ns), default=0)


def load_settings(text: str) -> Settings:
    """Parse what :func:`~companion.adapters.recordings.mcap.writer.dump_settings` wrote, in any version.

    Raises
    ------
    ConfigError
        A value that no version took.
    """
    return Settings().with_values(settings_of(parse_toml(text, "settings.toml"), "settings.toml"), flown=True)


def _record_of(schema: mcap.Schema, message: mcap.Message, unpaired: dict[int, Frame]) -> Recordable | None:
    """The record of a message; None for one that is not known, or the left image of a pair, which waits."""
    if schema.name == IMAGE_SCHEMA:
        frame, pair_id = images.frame_from_plain(json.loads(message.data))
        if pair_id is None:
            return frame
        if frame.side is Side.LEFT:
            unpaired[pair_id] = frame
            return None
        return FramePair(pair_id, unpaired.pop(pair_id), frame) if pair_id in unpaired else None
    if schema.name not in KINDS:
        return None
    kind = KINDS[schema.name]
    record: Recordable = (
        ros1_codec.unpack(kind, message.data) if kind in ros1_codec.SCHEMAS else loads(kind, message.data)
    )
    return record

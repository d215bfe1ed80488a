"""Every reader of recordings, tables and images, fed with damaged files."""

from __future__ import annotations

import itertools
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from companion.adapters.cameras.folder import FolderPair
from companion.adapters.recordings.mcap import images
from companion.adapters.recordings.mcap.images import ImageFormat
from companion.adapters.recordings.recording_factory import open_recording
from companion.adapters.recordings.tables.mapped_recording import MappedRecording
from companion.adapters.recordings.tables.mapping import parse_mapping
from companion.errors import SpanwiseError
from companion.params.files import dump_airframe, load_airframe
from companion.records import ImuBatch, Side
from sitl_tests.fuzz import corpora, mutators, structured
from sitl_tests.fuzz.mutators import Mutator
from sitl_tests.fuzz.target import LIMIT_S, Ending, Violation
from sitl_tests.unit import test_recordings_mcap as ours
from sitl_tests.unit.text_table_mapping import text_table_mapping

TEXT_MAPPING = text_table_mapping("range_m m")
_MATLAB_MAPPING = """
rate_hz = 500
[matlab]
array = "data"
names = "names"
[columns]
"left" = { channel = "left_z_mps2", unit = "g" }
"right" = { channel = "right_z_mps2", unit = "g" }
"#1" = { channel = "input_n" }
"""
_MOST_RECORDS = 200_000


def read_all(recording: Any) -> None:
    """Go through all records and look at the rest, as ``replay`` and ``diagnose`` do."""
    for record in itertools.islice(recording.records(), _MOST_RECORDS):
        if isinstance(record, ImuBatch) and record.values.shape != (record.t_ns.size, 6):
            raise Violation(f"a batch of {record.t_ns.size} stamps has values of {record.values.shape}")
    dump_airframe(recording.airframe)
    for notice in recording.notices:
        if not notice.text:
            raise Violation("a notice without words")


def _recording(path: Path) -> None:
    read_all(open_recording(path, load_airframe("sitl-plane")))


def _own_recording(path: Path) -> None:
    read_all(open_recording(path))


def _folder(path: Path) -> None:
    read_all(open_recording(path.parent, load_airframe("nadir-2m")))


def _mapped(text: str) -> Callable[[Path], None]:
    def use(path: Path) -> None:
        read_all(MappedRecording(path, parse_mapping(text, "lab.toml"), load_airframe("nadir-2m")))

    return use


@dataclass
class ReaderTarget:
    """A file of one format, damaged and read.

    Attributes
    ----------
    file : str
        Its name in a folder of its own.
    use : callable
        Reads it to the end.
    beside : callable, optional
        Files that lie beside it, by name.
    """

    name: str
    file: str
    corpus: corpora.Corpus
    use: Callable[[Path], None]
    ways: Sequence[Mutator]
    beside: Callable[[], dict[str, bytes]] | None = None
    counts: Counter[str] = field(default_factory=Counter)
    limit_s: float = LIMIT_S

    def warm(self) -> None:
        for data in self.corpus():
            self.run(data)

    def case(self, rng: np.random.Generator) -> bytes:
        files = self.corpus()
        return mutators.mutate(files[int(rng.integers(len(files)))], rng, self.ways)

    def run(self, data: bytes) -> Ending:
        folder = Path(tempfile.mkdtemp(prefix="spanwise-fuzz-"))
        try:
            for name, content in (self.beside() if self.beside else {}).items():
                (folder / name).write_bytes(content)
            (folder / self.file).write_bytes(data)
            return ending(lambda: self.use(folder / self.file))
        finally:
            shutil.rmtree(folder)


def ending(use: Callable[[], None]) -> Ending:
    """Data, or one sentence that tells what was wrong."""
    try:
        use()
    except SpanwiseError as error:
        text = str(error)
        if not text or "\n" in text.strip() or len(text) > 1500:
            raise Violation(f"a refusal that is no sentence: {text[:200]!r}") from error
        return Ending.REFUSAL
    return Ending.DATA


class ImageTarget:
    """Images of a folder, and images inside our recordings."""

    name = "images"
    limit_s = LIMIT_S

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def warm(self) -> None:
        for number, files in enumerate(corpora.pictures().values()):
            self.run(bytes([number]) + files[0])

    def case(self, rng: np.random.Generator) -> bytes:
        number = int(rng.integers(len(corpora.pictures())))
        (data, *_) = list(corpora.pictures().values())[number]
        return bytes([number]) + mutators.mutate(data, rng, (*mutators.PLAIN, mutators.word), 3)

    def run(self, data: bytes) -> Ending:
        suffix = list(corpora.pictures())[data[0] % len(corpora.pictures())]
        folder = Path(tempfile.mkdtemp(prefix="spanwise-fuzz-"))
        try:
            for camera in ("cam0", "cam1"):
                (folder / camera).mkdir()
                (folder / camera / f"1000{suffix}").write_bytes(data[1:])
            return ending(lambda: self._use(folder, data[1:]))
        finally:
            shutil.rmtree(folder)

    def _use(self, folder: Path, data: bytes) -> None:
        import base64

        plain = images.frame_to_plain(ours.frame(Side.LEFT, 1), None, ImageFormat.PNG)
        try:
            images.frame_from_plain({**plain, "data": base64.b64encode(data).decode("ascii")})
        except SpanwiseError:
            self.counts["recorded images refused"] += 1
        for frame in FolderPair(folder).frames():
            if frame.image.ndim != 2:
                raise Violation(f"an image of shape {frame.image.shape}")


def _with_range() -> dict[str, bytes]:
    return {"range.csv": corpora.range_tables()[0]}


def _with_accel() -> dict[str, bytes]:
    return {"accel.csv": corpora.accel_tables()[0]}


TLOG_WAYS: tuple[Mutator, ...] = (*mutators.PLAIN, *[structured.tlog_entry] * 10)
BIN_WAYS: tuple[Mutator, ...] = (*mutators.PLAIN, *[structured.bin_format] * 5)
ULOG_WAYS: tuple[Mutator, ...] = (*mutators.PLAIN, *[structured.ulog_message] * 8, *[structured.ulog_format] * 3)
MCAP_WAYS: tuple[Mutator, ...] = (*mutators.PLAIN, *[structured.mcap_record] * 10)
_TABLE = (*mutators.TEXT, structured.cell, structured.cell, structured.cell, structured.encoding)
READERS: dict[str, Callable[[], Any]] = {
    "tlog": lambda: ReaderTarget("tlog", "a.tlog", corpora.tlogs, _recording, TLOG_WAYS),
    "bin": lambda: ReaderTarget("bin", "a.BIN", corpora.bins, _recording, BIN_WAYS),
    "ulog": lambda: ReaderTarget("ulog", "a.ulg", corpora.ulogs, _recording, ULOG_WAYS),
    "mcap": lambda: ReaderTarget("mcap", "a.mcap", corpora.mcaps, _own_recording, MCAP_WAYS),
    "accel": lambda: ReaderTarget("accel", "accel.csv", corpora.accel_tables, _folder, _TABLE, _with_range),
    "range": lambda: ReaderTarget("range", "range.csv", corpora.range_tables, _folder, _TABLE, _with_accel),
    "table": lambda: ReaderTarget("table", "a.txt", corpora.text_tables, _mapped(TEXT_MAPPING), _TABLE),
    "matlab": lambda: ReaderTarget(
        "matlab", "a.mat", corpora.matlab_files, _mapped(_MATLAB_MAPPING), (*mutators.PLAIN, *[structured.element] * 10)
    ),
    "images": ImageTarget,
}  # fmt: skip

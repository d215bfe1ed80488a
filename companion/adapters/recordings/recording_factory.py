"""Opens a recording of any known format, told by its content."""

from __future__ import annotations

from pathlib import Path

from companion.adapters.recordings.logs.bin import BinRecording
from companion.adapters.recordings.logs.dataflash import MAGIC as BIN_MAGIC
from companion.adapters.recordings.logs.tlog import TlogRecording
from companion.adapters.recordings.logs.ulog import UlogRecording
from companion.adapters.recordings.logs.ulog_messages import MAGIC as ULOG_MAGIC
from companion.adapters.recordings.mcap.container import MAGIC as MCAP_MAGIC
from companion.adapters.recordings.mcap.reader import McapRecording
from companion.adapters.recordings.recording import Recording
from companion.adapters.recordings.tables.csv import CsvRecording
from companion.adapters.recordings.tables.tables_readme import is_converted
from companion.errors import AirframeNeeded, RecordingError
from companion.params.airframe import Airframe

_FORMATS = "known are .mcap (Spanwise), .tlog, .BIN (ArduPilot), .ulg (PX4) and a folder with accel.csv"
_TABLES = "; a laboratory's table in another layout is read by spanwise diagnose --mapping"
_TABLE_SUFFIXES = (".csv", ".txt", ".dat", ".tsv", ".mat")  # of tables that a mapping may read (convention)
SUFFIXES = (".mcap", ".tlog", ".bin", ".ulg")
"""Endings of recordings that are a file, in lower case."""
_MOST_NAMED = 5  # chosen: files of a folder that a sentence names and stays legible


def open_recording(path: Path | str, airframe: Airframe | None = None) -> Recording:
    """Open a recording, chosen by its content.

    Known are MCAP files of ours, tlogs, .BIN and .ulg logs, and folders with accel.csv. The airframe maps the messages
    of a foreign log to stations; only our own recordings bring one with them.

    Raises
    ------
    RecordingError
        The file is missing, of no known kind, empty, or needs an airframe.
    """
    path = Path(path)
    if not path.exists():
        raise RecordingError(f"{path}: no such file or folder")
    if path.is_dir():
        _check_folder(path)
        return CsvRecording(path, _needed(airframe, path))
    with path.open("rb") as file:
        head = file.read(16)
    if not head:
        raise RecordingError(f"{path}: is empty (0 bytes): nothing was recorded, or the copy failed")
    if head.startswith(MCAP_MAGIC):
        return McapRecording(path, airframe)
    if head.startswith(BIN_MAGIC):
        return BinRecording(path, _needed(airframe, path))
    if head.startswith(ULOG_MAGIC):
        return UlogRecording(path, _needed(airframe, path))
    if head[8:9] in (b"\xfd", b"\xfe") or path.suffix.lower() == ".tlog":
        return TlogRecording(path, _needed(airframe, path))
    tables = _TABLES if path.suffix.lower() in _TABLE_SUFFIXES else ""
    raise RecordingError(f"{path}: not a recording that can be read; {_FORMATS}{tables}")


def is_recording_file(path: Path) -> bool:
    """Whether a path is a file that ends as a recording does."""
    return path.suffix.lower() in SUFFIXES and path.is_file()


def is_recording_folder(path: Path) -> bool:
    """Whether a path is a folder of a laboratory's tables."""
    return (path / "accel.csv").is_file() or any(path.glob("accel_*.csv"))


def recordings_in(folder: Path) -> list[Path]:
    """Recordings at a folder or below it: files, and folders of tables, but none that spanwise convert wrote."""
    if is_recording_folder(folder):
        return [folder]
    holders = {path.parent for path in folder.rglob("accel*.csv")}
    tables = [path for path in holders if is_recording_folder(path) and not is_converted(path.parent)]
    return sorted([*filter(is_recording_file, folder.rglob("*")), *tables])


def _check_folder(path: Path) -> None:
    """Say what a folder without samples is, before an airframe is asked for."""
    if is_recording_folder(path):
        return
    if is_converted(path):
        raise RecordingError(
            f"{path}: tables that spanwise convert wrote, no recording; give the recording that they are from"
        )
    names = [each.name for each in sorted(path.iterdir()) if is_recording_file(each)]
    if names:
        listed = ", ".join(names[:_MOST_NAMED]) + (", ..." if len(names) > _MOST_NAMED else "")
        raise RecordingError(f"{path}: a folder with recordings; give one of them: {listed}")
    raise RecordingError(f"{path}: no accel.csv in this folder, and no recording; {_FORMATS}")


def _needed(airframe: Airframe | None, path: Path) -> Airframe:
    if airframe is None:
        raise AirframeNeeded(f"{path}: does not say of which aircraft it is; give its airframe (--airframe NAME)")
    return airframe

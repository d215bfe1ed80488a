"""A camera pair replayed from a folder of images in EuRoC's layout: ``cam0/data/<ns>.png`` left, ``cam1`` right.

The name of an image, or its row in ``data.csv`` where there is one, is its stamp in nanoseconds. Frames come in order
of their stamps; a missing file is a missing frame, nothing is shifted.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from companion.adapters.recordings.mcap.images import grey_of
from companion.errors import DeviceError
from companion.records import PLAN_UNKNOWN, Bytes, ClockName, Frame, Side

_FOLDERS = ("cam0", "cam1")
_LATEST_NS = 2**63 - 1  # that 64 bits hold (derived)
_IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")


@dataclass(frozen=True, slots=True)
class Stamped:
    """One image file and its stamp on ``FolderPair``'s clock."""

    t_ns: int
    side: Side
    path: Path


class FolderPair:
    """Implements :class:`companion.ports.CameraPair`; ``poll`` gives the frames of one instant after the other.

    ``folder`` holds ``cam0`` and ``cam1``. The stamps belong to ``clock`` (in a replay the log's only clock is the hub)
    and are mid-exposure after ``stamp_to_middle_ns`` has been added.
    """

    def __init__(
        self,
        folder: Path,
        clock: ClockName = ClockName.HOST,
        *,
        exposure_ns: int = 0,
        row_time_ns: int = 0,
        stamp_to_middle_ns: int = 0,
    ) -> None:
        self._clock, self._exposure_ns, self._row_time_ns = clock, exposure_ns, row_time_ns
        self._to_middle_ns = stamp_to_middle_ns
        self.files = [entry for side in Side for entry in list_images(folder / _FOLDERS[side], side)]
        self.files.sort(key=lambda entry: (entry.t_ns, entry.side))
        self._next = 0
        self._sequence = [0, 0]

    @property
    def exhausted(self) -> bool:
        """Whether every frame has been given."""
        return self._next >= len(self.files)

    def poll(self, timeout_s: float) -> list[Frame]:  # noqa: ARG002 - a file never keeps anyone waiting
        """Frames of the next instant; nothing once all have been given."""
        if self.exhausted:
            return []
        t_ns, frames = self.files[self._next].t_ns, []
        while not self.exhausted and self.files[self._next].t_ns == t_ns:
            frames.append(self._frame(self.files[self._next]))
            self._next += 1
        return frames

    def frames(self) -> Iterator[Frame]:
        """Every frame that has not been given yet."""
        while not self.exhausted:
            yield from self.poll(0.0)

    def close(self) -> None:
        """Nothing to release."""

    def _frame(self, entry: Stamped) -> Frame:
        sequence = self._sequence[entry.side]
        self._sequence[entry.side] += 1
        return Frame(
            side=entry.side,
            sequence=sequence,
            clock=self._clock,
            mid_exposure_ns=entry.t_ns + self._to_middle_ns,
            exposure_ns=self._exposure_ns,
            row_time_ns=self._row_time_ns,
            plan_id=PLAN_UNKNOWN,
            image=read_grey(entry.path),
        )


def list_images(camera: Path, side: Side) -> list[Stamped]:
    """Images of one camera's folder with their stamps, in order; two that have one stamp are both there.

    Raises
    ------
    DeviceError
        There is no such folder, it is empty, a name is no stamp and no ``data.csv`` gives one, or that is no
        table of stamps.
    """
    data = camera / "data" if (camera / "data").is_dir() else camera
    if not data.is_dir():
        raise DeviceError(f"{camera}: no such folder; the EuRoC layout has cam0/data (left) and cam1/data (right)")
    stamps = _table(camera / "data.csv")
    images = [path for path in data.iterdir() if path.suffix.lower() in _IMAGES and not path.name.startswith(".")]
    frames = [Stamped(_stamp(path, stamps), side, path) for path in images]
    if not frames:
        raise DeviceError(f"{data}: no images ({', '.join(_IMAGES)})")
    return sorted(frames, key=lambda entry: (entry.t_ns, entry.path))


def read_grey(path: Path) -> Bytes:
    """Read an image as (rows, columns) uint8; :class:`DeviceError` where it cannot be read."""
    try:
        image = grey_of(path.read_bytes())
    except OSError as error:
        raise DeviceError(f"{path}: cannot be read: {error.strerror}") from error
    if image is None:
        raise DeviceError(f"{path}: not an image that can be read")
    return image


def _stamp(path: Path, stamps: dict[str, int]) -> int:
    if path.name in stamps:
        return stamps[path.name]
    t_ns = _nanoseconds(path.stem)
    if t_ns is None:
        raise DeviceError(f"{path}: its name is no time in nanoseconds, and data.csv does not list it")
    return t_ns


def _nanoseconds(text: str) -> int | None:
    """A stamp in digits; None for any other text."""
    if not text.isdecimal() or len(text.lstrip("0")) > len(str(_LATEST_NS)):
        return None
    return int(text) if int(text) <= _LATEST_NS else None


def _table(path: Path) -> dict[str, int]:
    if not path.is_file():
        return {}
    stamps: dict[str, int] = {}
    try:
        rows = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (UnicodeDecodeError, csv.Error) as error:
        raise DeviceError(f"{path}: is no table in UTF-8: save it so, or name the images by their stamps") from error
    for number, row in enumerate(rows, start=1):
        if not row or row[0].lstrip().startswith("#"):
            continue
        t_ns = _nanoseconds(row[0].strip()) if len(row) > 1 else None
        if t_ns is None:
            raise DeviceError(f"{path}:{number}: expected 'time in ns, file name'")
        if stamps.setdefault(row[1].strip(), t_ns) != t_ns:
            raise DeviceError(f"{path}:{number}: {row[1].strip()} has a second stamp here: leave one")
    return stamps

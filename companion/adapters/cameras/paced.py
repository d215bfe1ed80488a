"""Frames of a file as if they came now: benches and rehearsals of the live service without a camera."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from companion.adapters.recordings.recording_factory import open_recording
from companion.errors import DeviceError
from companion.ports import CameraPair, Clock
from companion.records import ClockName, Frame, FramePair


class PacedPair:
    """Implements :class:`companion.ports.CameraPair`: the frames of another one at their own pace from now on.

    The first frame is exposed at the first call; stamps are moved to the host's clock by one constant.
    """

    def __init__(self, source: CameraPair, clock: Clock) -> None:
        self._source, self._clock = source, clock
        self._waiting: list[Frame] = []
        self._shift_ns: int | None = None

    def poll(self, timeout_s: float) -> list[Frame]:
        """Frames whose time has come within the timeout; none any more once the source has ended."""
        until_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        self._waiting = self._waiting or list(self._source.poll(timeout_s))
        if not self._waiting:
            self._clock.sleep_until(until_ns)
            return []
        first_ns = min(frame.mid_exposure_ns for frame in self._waiting)
        if self._shift_ns is None:
            self._shift_ns = self._clock.now_ns() - first_ns
        due_ns = first_ns + self._shift_ns
        self._clock.sleep_until(min(due_ns, until_ns))
        if due_ns > until_ns:
            return []
        frames, self._waiting = self._waiting, []
        return [self._moved(frame, self._shift_ns) for frame in frames]

    def close(self) -> None:
        """Release the source."""
        self._source.close()

    @staticmethod
    def _moved(frame: Frame, shift_ns: int) -> Frame:
        return dataclasses.replace(frame, clock=ClockName.HOST, mid_exposure_ns=frame.mid_exposure_ns + shift_ns)


class _Recorded(Protocol):
    def records(self) -> Iterator[object]:
        """Everything in the file."""
        ...


class RecordedPair:
    """Implements :class:`companion.ports.CameraPair`: the images of one of our recordings, with their own stamps.

    Raises
    ------
    DeviceError
        The recording has no images.
    RecordingError
        It cannot be read.
    """

    def __init__(self, path: Path) -> None:
        self._frames = _frames(open_recording(path))
        self._next = next(self._frames, [])
        if not self._next:
            raise DeviceError(f"{path} has no images; they are in recordings made with --record-images")

    def poll(self, timeout_s: float) -> list[Frame]:  # noqa: ARG002 - a file never keeps anyone waiting
        """The next frame, or pair; nothing at the end."""
        frames, self._next = self._next, next(self._frames, [])
        return frames

    def close(self) -> None:
        """Nothing to release."""


def _frames(recording: _Recorded) -> Iterator[list[Frame]]:
    for record in recording.records():
        if isinstance(record, Frame):
            yield [record]
        elif isinstance(record, FramePair):
            yield [record.left, record.right]

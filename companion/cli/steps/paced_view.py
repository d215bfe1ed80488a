"""A recording shown at its own pace in the live view."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator

from companion.live.feed import ImagePace
from companion.live.session import LiveSession
from companion.records import Frame, FramePair, ImuBatch, Record, Tick

_TURN_S = 0.1  # chosen: a wish of the page is met at once to the eye
_LONGEST_PAUSE_S = 2.0  # a gap of the recording is not waited for (choice)


class PacedView:
    """Hands a replay's records to the live view, and holds the replay back to the pace of the recording."""

    def __init__(self, session: LiveSession) -> None:
        self._session = session
        self._images = ImagePace()
        self._began_s: float | None = None
        self._first_ns = 0

    def publish(self, record: Record) -> None:
        """Show one record."""
        self._session.publish(record)

    def keep_pace(self, record: Record) -> None:
        """Wait until a tick or a batch of samples is due."""
        if isinstance(record, Tick | ImuBatch):
            at_ns = record.now_host_ns if isinstance(record, Tick) else record.received_host_ns
            self._wait_until(at_ns)
            self._session.tend()

    def stay(self) -> None:
        """Keep the page up with its last values, until Ctrl-C."""
        self._session.end()
        with contextlib.suppress(KeyboardInterrupt):
            while True:
                self._session.tend()
                time.sleep(_TURN_S)

    def with_images(self, records: Iterator[Record]) -> Iterator[Record]:
        """Show the images among these records, which no replay uses, and give all of them."""
        for record in records:
            if (isinstance(record, Frame) and self._images.take(record)) or (
                isinstance(record, FramePair) and self._images.take(record.left)
            ):
                self._session.publish(record)
            yield record

    def _wait_until(self, at_ns: int) -> None:
        now_s = time.monotonic()
        if self._began_s is None:
            self._began_s, self._first_ns = now_s, at_ns
            self._session.begin(at_ns)
        early_s = self._began_s + 1e-9 * (at_ns - self._first_ns) - now_s
        if early_s > _LONGEST_PAUSE_S:
            self._began_s -= early_s - _LONGEST_PAUSE_S
            early_s = _LONGEST_PAUSE_S
        if early_s > 0.0:
            time.sleep(early_s)

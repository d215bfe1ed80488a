"""Lines of motors and propellers taken out of all streams: searched for once a second, followed in between."""

from __future__ import annotations

from collections.abc import Sequence

from companion.core.tracking.line_search import MIN_RATE_HZ, SILENT_NS, KnownLines
from companion.core.tracking.spread_work import SpreadWork
from companion.core.tracking.streams import SampleBuffer


class LineFollowing:
    """Search for lines in the samples of some streams, and their removal from these."""

    def __init__(self, streams: Sequence[SampleBuffer]) -> None:
        self._streams = streams
        self._lines = KnownLines()
        self._search: SpreadWork[None] | None = None
        self._multiples: dict[int, tuple[int, ...]] = {}  # that the streams follow

    @property
    def is_searching(self) -> bool:
        """Whether a search has begun whose result is not yet followed."""
        return self._search is not None

    def begin(self, until_ns: int) -> None:
        """Begin a search in the samples before an instant."""
        rings = [stream.ring for stream in self._streams]
        self._search = SpreadWork(self._lines.search(rings, until_ns, self._followed_shafts()))

    def work(self) -> None:
        """Run a stage of the search, where there is one."""
        if self._search is not None:
            self._search.work()

    def finish(self) -> bool:
        """Follow the lines that the search has shown; whether there is a new shaft among them."""
        if self._search is None:
            return False
        self._search.finish()
        self._search = None
        new = bool(self._lines.multiples.keys() - self._multiples.keys())
        self._lines.follow(self._followed_shafts())
        if self._lines.multiples != self._multiples:
            self._multiples = self._lines.multiples
            for stream in self._streams:
                stream.follow_lines(self._lines.leader_hz, self._multiples)
        for stream in self._streams:
            stream.anchor_lines(self._lines.leader_hz)
        return new

    def _followed_shafts(self) -> dict[int, tuple[float, float]]:
        """Frequency of each shaft's leader by number, Hz, and its power over the rest, where that is most.

        A stream too slow to be searched does not count: a leader near its Nyquist frequency looks locked to anything.
        Nor does one that is silent: it keeps the frequency that it saw last.
        """
        followed: dict[int, tuple[float, float]] = {}
        newest_ns = max((stream.newest_ns or 0 for stream in self._streams), default=0)
        for stream in self._streams:
            if stream.sensor.rate_hz < MIN_RATE_HZ or stream.is_silent(newest_ns - SILENT_NS):
                continue
            for number, leader in stream.followed_shafts().items():
                followed[number] = max(followed.get(number, leader), leader, key=lambda each: each[1])
        return followed

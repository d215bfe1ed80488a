"""Lines of motors and propellers taken out of all streams: searched for once a second, followed in between."""

from __future__ import annotations

from collections.abc import Sequence

from companion.core.tracking.line_removal import LOCKED_RATIO
from companion.core.tracking.line_search import MIN_RATE_HZ, SILENT_NS, KnownLines
from companion.core.tracking.spread_work import SpreadWork
from companion.core.tracking.streams import SampleBuffer

_CLEAR_OF_NYQUIST = 0.35  # chosen, of the sample rate: at 333 Hz shafts of 7,000 rpm


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

    @property
    def follows(self) -> bool:
        """Whether there is a shaft whose loops share their turn."""
        return bool(self._multiples)

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

    def share_turn(self) -> None:
        """Turn loops out of lock as the one that holds the same shaft best: its line turns alike at every station.

        A tip that gusts shake, or whose peaks are clipped, loses a shaft that changes its speed; the root holds it.
        """
        for number, (best, (_, ratio)) in self._best_followed().items():
            for stream in self._streams:
                stream.turn_with(best if ratio > LOCKED_RATIO else None, number)

    def _followed_shafts(self) -> dict[int, tuple[float, float]]:
        """Frequency of each shaft's leader by number, Hz, and its power over the rest, where that is most."""
        return {number: leader for number, (_, leader) in self._best_followed().items()}

    def _best_followed(self) -> dict[int, tuple[SampleBuffer, tuple[float, float]]]:
        """The stream in which each shaft's leader has most power over the rest, its frequency there (Hz), that ratio.

        A leader near the Nyquist frequency of a slow stream does not count: it looks locked to anything. Nor does a
        stream that is silent: it keeps the frequency that it saw last.
        """
        best: dict[int, tuple[SampleBuffer, tuple[float, float]]] = {}
        newest_ns = max((stream.newest_ns or 0 for stream in self._streams), default=0)
        for stream in self._streams:
            rate_hz = stream.sensor.rate_hz
            most_hz = rate_hz if rate_hz >= MIN_RATE_HZ else _CLEAR_OF_NYQUIST * rate_hz
            followed = {} if stream.is_silent(newest_ns - SILENT_NS) else stream.followed_shafts()
            for number, leader in followed.items():
                if leader[0] < most_hz and (number not in best or leader[1] > best[number][1][1]):
                    best[number] = stream, leader
        return best

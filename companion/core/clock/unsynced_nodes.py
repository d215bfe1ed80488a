"""Nodes that answer no TIMESYNC: alignment of each by the motion that it shares with the autopilot's IMU."""

from __future__ import annotations

from collections.abc import Iterator

from companion.core.clock.bank import ClockBank
from companion.core.clock.motion_alignment import MotionAlignment
from companion.params.airframe import Sensor
from companion.records import ClockName, ImuBatch, TimesyncReply

_PATIENCE_NS = 3_000_000_000  # time without an answer after which a node is aligned by motion (choice)
_NODES = (ClockName.NODE_LEFT, ClockName.NODE_RIGHT)


class UnsyncedNodes:
    """Nodes without an answer for some seconds, with one :class:`MotionAlignment` each.

    An alignment is far coarser than answers. So a clock that answers made known is left alone as long as it stays so.
    ``aligned`` are the clocks that hang on alignments now.
    """

    def __init__(self) -> None:
        self.aligned: set[ClockName] = set()
        self._unanswered_ns: dict[ClockName, int] = {}
        self._alignments: dict[ClockName, MotionAlignment] = {}

    def answered(self, clock: ClockName, received_host_ns: int) -> None:
        """Note an answer: the alignment of its clock ends."""
        self._alignments.pop(clock, None)
        self.aligned.discard(clock)
        self._unanswered_ns[clock] = received_host_ns

    def restarted(self, clock: ClockName) -> None:
        """Forget the motion that was stamped before a clock's restart."""
        self._alignments.pop(clock, None)
        self.aligned.discard(clock)

    def note(self, batch: ImuBatch, sensor: Sensor, root: Sensor) -> None:
        """Add samples of a station, stamped by its own clock; those of silent nodes are kept."""
        clock = batch.clock
        if clock not in _NODES:
            return
        since_ns = self._unanswered_ns.setdefault(clock, batch.received_host_ns)
        if batch.received_host_ns - since_ns >= _PATIENCE_NS and MotionAlignment.possible(batch.axes):
            alignment = self._alignments.setdefault(clock, MotionAlignment(clock))
            alignment.add_node(batch)
            alignment.sensors(sensor, root)

    def note_root(self, batch: ImuBatch) -> None:
        """Add samples of the autopilot's IMU, in host time."""
        for alignment in self._alignments.values():
            alignment.add_root(batch)

    def exchanges(self, now_host_ns: int, clocks: ClockBank) -> Iterator[TimesyncReply]:
        """Alignments of all unsynced nodes due by now, as exchanges; ``clocks`` is only read."""
        for clock, alignment in self._alignments.items():
            state = clocks.state(clock, now_host_ns)
            if clock in self.aligned or not state.synced:
                for exchange in alignment.exchanges(now_host_ns, state):
                    yield exchange
                    self.aligned.add(clock)  # not sooner: the first one's taker asks whether there was one before

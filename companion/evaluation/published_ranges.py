"""When ranges were published: how long the first was waited for, and the longest time without another, in the air."""

from __future__ import annotations

from dataclasses import dataclass

from companion.records import CorrectedRange, ImuBatch, ModeState, ServiceStatus, VehicleState


@dataclass(slots=True)
class PublishedRanges:
    """Follows the records of a flight in their order, by the host's time.

    On the ground no range is expected: waiting begins anew with every word of the autopilot that the aircraft is there.
    An autopilot that does not say is taken as flying.
    """

    lifted_off: bool = False
    _longest_ns: int = 0
    _waiting_ns: int | None = None
    _first_wait_ns: int | None = None
    _end_ns: int = 0

    def take(self, record: object) -> None:
        """Look at a record of any kind."""
        if isinstance(record, CorrectedRange):
            self._flying(record.t_host_ns)
            if record.trusted:
                self._publish(record.t_host_ns)
        elif isinstance(record, ModeState):
            self._flying(record.t_host_ns)
        elif isinstance(record, ServiceStatus):
            self._flying(record.at_host_ns)
        elif isinstance(record, ImuBatch):
            self._end_ns = max(self._end_ns, record.received_host_ns)
        elif isinstance(record, VehicleState) and record.on_ground:
            self._on_ground(record.received_host_ns)

    @property
    def first_s(self) -> float | None:
        """Time to the first published range's exposure, from lift-off where ``lifted_off``, else from the begin."""
        return None if self._first_wait_ns is None else self._first_wait_ns * 1e-9

    @property
    def longest_silence_s(self) -> float:
        """Longest time without a range after the first, that up to the last sample included; 0 before any."""
        if self._first_wait_ns is None or self._waiting_ns is None:
            return 0.0
        return max(self._longest_ns, self._end_ns - self._waiting_ns) * 1e-9

    def _flying(self, t_host_ns: int) -> None:
        if self._waiting_ns is None:
            self._waiting_ns = t_host_ns

    def _publish(self, t_host_ns: int) -> None:
        waited_ns = t_host_ns - (self._waiting_ns or 0)
        if self._first_wait_ns is None:
            self._first_wait_ns = waited_ns
        else:
            self._longest_ns = max(self._longest_ns, waited_ns)
        self._waiting_ns, self._end_ns = t_host_ns, max(self._end_ns, t_host_ns)

    def _on_ground(self, t_host_ns: int) -> None:
        if self._first_wait_ns is None:
            self.lifted_off = True
        elif self._waiting_ns is not None:
            self._longest_ns = max(self._longest_ns, t_host_ns - self._waiting_ns)
        self._waiting_ns = t_host_ns

"""Protocols that the outside satisfies. Real devices and simulated ones implement the same protocols."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Protocol

from companion.records import Frame, Record, Shot, TriggerPlan


class Clock(Protocol):
    """The companion's monotonic clock."""

    def now_ns(self) -> int:
        """Nanoseconds since an arbitrary epoch; never goes back."""
        ...

    def sleep_until(self, target_host_ns: int) -> None:
        """Return at or after the target."""
        ...


class Autopilot(Protocol):
    """The vehicle's side: records in, records out."""

    def poll(self, timeout_s: float) -> Iterator[Record]:
        """Yield what has arrived, raw bytes first, then what they decode to."""
        ...

    def publish(self, record: Record) -> None:
        """Send an output record in the form that the autopilot understands."""
        ...

    def set_own_parameter(self, name: str, value: float) -> None:
        """Set one of our own parameters, as a ground station would; what comes of it is among the next polled."""
        ...

    def close(self) -> None:
        """Release the link."""
        ...


class CameraPair(Protocol):
    """Two cameras; frames come as they arrive, unpaired."""

    def poll(self, timeout_s: float) -> Iterable[Frame]:
        """Frames that have arrived within the timeout."""
        ...

    def close(self) -> None:
        """Release the devices."""
        ...


class Trigger(Protocol):
    """The line that starts an exposure, used from the trigger process at the planned instant."""

    def fire(self, plan: TriggerPlan) -> Shot:
        """Start both exposures now and say when that was."""
        ...

    def close(self) -> None:
        """Release the device."""
        ...


class Recorder(Protocol):
    """Where records go, in the order in which they were handled."""

    def write(self, record: Record) -> None:
        """Append one record; never blocks for the disk."""
        ...

    def close(self) -> None:
        """Flush and finish the file."""
        ...

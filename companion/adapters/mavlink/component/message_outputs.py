"""Messages made of output records: a table of which record becomes which MAVLink messages, and at most how often.

To publish another message, write its encoder and add a row to :data:`OUTPUTS`. Ranges and obstacles, whose change goes
out at once and whose stamps must advance, have a publisher of their own
(:mod:`companion.adapters.mavlink.component.range_publisher`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from companion.adapters.mavlink.component import encode
from companion.params.settings import Settings
from companion.rate_limiter import RateLimiter
from companion.records import CorrectedRange, ModeState, Record

_SECOND_NS = 1_000_000_000  # by definition
_LARGEST_BOOT_MS = 0xFFFFFFFF  # by definition: time_boot_ms is a uint32, which wraps after 49.7 days
_STAMPS = ("t_host_ns", "at_host_ns", "planned_host_ns")  # instant of an output record: the first that it has


@dataclass(frozen=True, slots=True)
class MessageOutput:
    """One row: MAVLink messages made of one kind of output record.

    ``record`` is a kind of :data:`companion.records.OutputRecord`. ``encode`` turns a record and its boot time in ms,
    as ``time_boot_ms`` carries it (a plan's is when it was made), into pymavlink messages in wire units, with None in
    the place of one that cannot be represented; a record of which it makes none takes no other's turn. Ranges come
    trusted and untrusted: an encoder that sends the range itself looks at ``trusted``. ``rate_hz`` gives the largest
    rate for the settings; at 0 nothing is sent.
    """

    record: type
    encode: Callable[[Any, int], Iterable[Any | None]]
    rate_hz: Callable[[Settings], float]


OUTPUTS: tuple[MessageOutput, ...] = (
    MessageOutput(ModeState, encode.mode_graphs, lambda settings: settings.debug_rate_hz),
    MessageOutput(CorrectedRange, encode.range_graphs, lambda settings: settings.debug_rate_hz),
)


class OutputPublisher:
    """Encodes the records of one vehicle by :data:`OUTPUTS`, each row at its rate."""

    def __init__(self) -> None:
        self._limiter = RateLimiter(_SECOND_NS)

    def messages(self, record: Record, settings: Settings, boot_offset_ns: int) -> Iterator[Any | None]:
        """Messages of a record; ``boot_offset_ns`` is boot time less host time."""
        for row, output in enumerate(OUTPUTS):
            rate_hz = output.rate_hz(settings) if isinstance(record, output.record) else 0.0
            if rate_hz <= 0:
                continue
            t_host_ns = next(int(getattr(record, name)) for name in _STAMPS if hasattr(record, name))
            period_ns = _SECOND_NS / rate_hz
            if self._limiter.ready(t_host_ns, row, period_ns):
                boot_ms = (t_host_ns + boot_offset_ns) // 1_000_000 & _LARGEST_BOOT_MS
                messages = list(output.encode(record, boot_ms))
                says_something = any(message is not None for message in messages)
                # a record that says nothing delays no other, but its refusals are counted at the row's rate too
                if self._limiter.take(t_host_ns, row if says_something else (row, "refused"), period_ns):
                    yield from messages

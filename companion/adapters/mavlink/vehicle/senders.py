"""Uniqueness of MAVLink ids: the first address keeps its id while it lives; two senders on one wire are told apart."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import TypeGuard

from companion.adapters.mavlink.vehicle.clock_reset_detector import LEAPS
from companion.rate_limiter import RateLimiter
from companion.records import ClockRestart, Notice, Record, Reject, Rejected
from companion.units import Severity

Address = tuple[str, int]
Key = tuple[int, int]

_ALIVE_NS = 1_500_000_000  # chosen: one heartbeat may be lost before an id passes to another sender
_COPIES = 128  # latest frames of a holder, among which a router's copy is looked for (choice)
_CONFIRMATIONS = 3  # a stray frame or two prove nothing (choice)
_REPEAT_NS = 30_000_000_000  # chosen: often enough for a reader, rare enough for a slow link
_REPORT_NS = 1_000_000_000  # chosen: a flood of foreign frames becomes one count a second
_WINDOW_NS = 10_000_000_000  # chosen: the confirmations, a second apart at least, come well within it


@dataclass(slots=True)
class _Place:
    """Holder of an id: its address, when it was heard last, and its latest frames."""

    address: Address
    heard_host_ns: int
    sent: deque[bytes] = field(default_factory=lambda: deque(maxlen=_COPIES))


class Senders:
    """Guards the ids of autopilot and sensors.

    A router may deliver the same frame twice, by another route: such a copy is refused like anything else from another
    address, but nobody is warned of it.

    ``guarded`` are component ids, at first none; ``system`` is the only system whose ids are guarded, None for all.
    """

    def __init__(self) -> None:
        self.guarded: frozenset[int] = frozenset()
        self.system: int | None = None
        self._places: dict[Key, _Place] = {}
        self._refused: Counter[tuple[Key, Address]] = Counter()
        self._foreign: Counter[tuple[Key, Address]] = Counter()
        self._counts = RateLimiter(_REPORT_NS)
        self._warnings = RateLimiter(_REPEAT_NS)

    def guards(self, key: Key) -> bool:
        """Whether an id is guarded."""
        return key[1] in self.guarded and self.system in (None, key[0])

    def has(self, address: Address, key: Key, frame: bytes, now_host_ns: int) -> bool:
        """Whether the id is the sender's already; takes note of the frame."""
        place = self._places.get(key)
        if place is None or place.address != address:
            return False
        place.heard_host_ns = now_host_ns
        place.sent.append(frame)
        return True

    def admit(self, address: Address, key: Key, frame: bytes, now_host_ns: int) -> bool:
        """Give the id to its holder or to the first sender; refuse and count the frames of others."""
        place = self._places.get(key)
        if place is None or (place.address != address and now_host_ns - place.heard_host_ns > _ALIVE_NS):
            place = self._places[key] = _Place(address, now_host_ns)
        if place.address != address:
            self._refused[key, address] += 1
            self._foreign[key, address] += frame not in place.sent
            return False
        return self.has(address, key, frame, now_host_ns)

    def refuse_copy(self, address: Address, key: Key, frame: bytes) -> bool:
        """Whether a frame is one of the holder's that came by another route too: refused and counted."""
        place = self._places.get(key)
        is_copy = place is not None and place.address != address and frame in place.sent
        if is_copy:
            self._refused[key, address] += 1
        return is_copy

    def holds_any(self, address: Address) -> bool:
        """Whether a guarded id is this sender's."""
        return any(place.address == address for place in self._places.values())

    def refusals(self, now_host_ns: int) -> list[Notice | Rejected]:
        """Refusals once a second, and a sentence for each id, at most every 30 s."""
        if not self._refused or not self._counts.take(now_host_ns):
            return []
        notices: list[Notice | Rejected] = []
        for (key, address), count in self._refused.items():
            name, where = f"{key[0]}/{key[1]}", f"{address[0]}:{address[1]}"
            notices.append(Rejected(Reject.FOREIGN_SOURCE, f"second sender of {name}", now_host_ns, count))
            if self._foreign[key, address] >= _CONFIRMATIONS and self._warnings.take(now_host_ns, key):
                first = self._places[key].address
                text = f"id {name} is used twice: {where} is refused, {first[0]}:{first[1]} came first"
                notices.append(Notice(Severity.ERROR, text, now_host_ns))
        self._refused.clear()
        if len(self._foreign) > _COPIES:
            self._foreign.clear()
        return notices


class ClockConflictDetector:
    """Suspects two senders behind one address or wire: stamps of two clocks jump back and forth again and again.

    A clock that restarts does so once; what is late in a network is a sample or two.
    """

    def __init__(self) -> None:
        self._backward_host_ns: dict[str, deque[int]] = {}
        self._warnings = RateLimiter(_REPEAT_NS)

    def hear(self, record: Record) -> Notice | None:
        """Look at what the decoder gave; a sentence when the stamps of one source leapt in three seconds of ten."""
        if _leapt(record) and record.count >= _CONFIRMATIONS:
            what, now_host_ns = record.what.removesuffix(LEAPS), record.at_host_ns
        elif isinstance(record, ClockRestart):
            what, now_host_ns = f"{record.clock} clock", record.seen_host_ns
        else:
            return None
        backward_host_ns = self._backward_host_ns.setdefault(what, deque(maxlen=_CONFIRMATIONS))
        if not backward_host_ns or now_host_ns - backward_host_ns[-1] >= _REPORT_NS:
            backward_host_ns.append(now_host_ns)
        if len(backward_host_ns) < _CONFIRMATIONS or now_host_ns - backward_host_ns[0] > _WINDOW_NS:
            return None
        if not self._warnings.take(now_host_ns, what):
            return None
        return Notice(Severity.ERROR, f"{what}: time leaps again and again: two senders with one id?", now_host_ns)


def _leapt(record: Record) -> TypeGuard[Rejected]:
    """Whether these are stamps that were refused because they are behind or ahead of those before."""
    if not isinstance(record, Rejected):
        return False
    ahead = record.reason is Reject.INCONSISTENT and record.what.endswith(LEAPS)
    return ahead or record.reason is Reject.TIME_BACKWARDS

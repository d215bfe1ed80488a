"""A remote clock behind a lossy, jittery link, and a flight of exchanges and samples over it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.core.clock.bank import ClockBank
from companion.records import ClockName, Ints, Reject, TimesyncReply

S = 1_000_000_000
MS = 1_000_000
NODE = ClockName.NODE_LEFT


@dataclass
class Link:
    """A remote clock behind a lossy, jittery link. Truth is integer arithmetic of its own."""

    seed: int
    skew_ppm: int = 167
    jitter_ns: float = 30e6
    fixed_ns: float = 0.3e6
    loss: float = 0.2
    rng: np.random.Generator = field(init=False)
    start_ns: int = field(init=False)
    epoch_ns: int = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.start_ns = int(self.rng.integers(1, 10**15))
        self.epoch_ns = int(self.rng.integers(0, 10**15))

    def remote(self, host_ns: int) -> int:
        """Reading of the remote clock at a host instant, ns."""
        elapsed = host_ns - self.start_ns
        return self.epoch_ns + elapsed + elapsed * self.skew_ppm // 1_000_000

    def exchange(self, sent_ns: int) -> TimesyncReply | None:
        """Answered TIMESYNC exchange, or None where either message was lost."""
        lost = self.rng.random(2) < self.loss
        outward, back = (self.fixed_ns + self.rng.random(2) * self.jitter_ns).astype(np.int64)
        if lost.any():
            return None
        read_ns = sent_ns + int(outward)
        stamp = self.remote(read_ns) // 1000 * 1000  # ArduPilot counts microseconds
        return TimesyncReply(NODE, sent_ns, stamp, read_ns + int(back))

    def later(self, after_ns: int) -> Link:
        """The same link and clock, flown from so much later on."""
        other = Link(self.seed + 1000, self.skew_ppm, self.jitter_ns, self.fixed_ns, self.loss)
        other.start_ns, other.epoch_ns = self.start_ns + after_ns, self.remote(self.start_ns + after_ns)
        return other

    def stamps(self, host_ns: Ints) -> Ints:
        """Readings of the remote clock at host instants, (n,) ns each."""
        return np.array([self.remote(int(t)) for t in host_ns], dtype=np.int64)


@dataclass
class Flight:
    """Answers of a bank during a flight of exchanges at 10 Hz and samples at 1 kHz in batches of 20."""

    error_ns: list[int] = field(default_factory=list)
    bound_ns: list[int] = field(default_factory=list)
    excess_ns: list[float] = field(default_factory=list)
    stamps: list[Ints] = field(default_factory=list)
    true: list[Ints] = field(default_factory=list)
    locked_after_s: float = np.inf


def fly(bank: ClockBank, link: Link, duration_s: int) -> Flight:
    flight, least_round_trip = Flight(), np.inf
    for sent in range(link.start_ns, link.start_ns + duration_s * S, 100 * MS):
        reply = link.exchange(sent)
        if reply is not None:
            bank.exchange(reply)
            least_round_trip = min(least_round_trip, reply.received_host_ns - sent)
        for end in range(sent + 80 * MS, sent + 180 * MS, 20 * MS):
            true = np.arange(end - 20 * MS, end, MS)
            converted = bank.to_host(NODE, link.stamps(true), received_host_ns=end + 5 * MS)
            if isinstance(converted, Reject):
                continue
            flight.locked_after_s = min(flight.locked_after_s, (end - link.start_ns) / S)
            flight.error_ns.append(int(np.abs(converted[0] - true).max()))
            flight.bound_ns.append(converted[1])
            flight.excess_ns.append(converted[1] - least_round_trip / 2)
            flight.stamps.append(converted[0])
            flight.true.append(true)
    return flight

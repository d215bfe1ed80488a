"""Lock-step: a clock that moves only when somebody looks at it, and the vehicle that lives on it.

Nothing here knows how fast the machine is. The companion's code runs as it stands; every look at the clock costs it a
stated time, sleeping costs what was slept, and the vehicle is turned for every millisecond that passes. Equal seeds
give equal flights.
"""

from __future__ import annotations

import os
from collections import deque

from companion.sim.vehicle.world import World

EPOCH_NS = 5_000_000_000_000
"""Host time at which the vehicle's boot time is 0 (convention)."""

_TURN_NS = 1_000_000  # chosen: finer than the autopilot's loop, coarse enough to be fast
_LOOK_NS = 20_000  # stands for what the loop computes between two looks; a turn looks some ten times (choice)


class LockStepClock:
    """Implements :class:`companion.ports.Clock`; turns ``world`` as its time passes, up to the end of the flight."""

    def __init__(self, world: World) -> None:
        self.world = world
        self._now_ns = EPOCH_NS
        self._turned_ns = EPOCH_NS
        self._over_ns = EPOCH_NS + round(world.flight.duration_s * 1e9)

    @property
    def flown_s(self) -> float:
        """Seconds since the vehicle's boot; looking at this costs nothing."""
        return (self._now_ns - EPOCH_NS) * 1e-9

    def now_ns(self) -> int:
        """Nanoseconds of simulated host time; the look itself takes a little."""
        self._pass_until(self._now_ns + _LOOK_NS)
        return self._now_ns

    def sleep_until(self, target_host_ns: int) -> None:
        """Advance the time to the target, if it lies ahead."""
        self._pass_until(max(self._now_ns, target_host_ns))

    def _pass_until(self, host_ns: int) -> None:
        self._now_ns = host_ns
        while self._turned_ns + _TURN_NS <= min(host_ns, self._over_ns):
            self._turned_ns += _TURN_NS
            self.world.run_once(self._turned_ns - EPOCH_NS, self._turned_ns)


class MemoryWire:
    """Bytes between vehicle and companion: a port of the one, and what carries a link of the other."""

    def __init__(self) -> None:
        self.to_companion: deque[bytes] = deque()
        self.to_vehicle: deque[bytes] = deque()
        self._ready, writing = os.pipe()
        os.write(writing, b"!")  # never read: whoever waits on it goes on at once
        os.close(writing)

    def fileno(self) -> int:
        """A descriptor that is always ready."""
        return self._ready

    def receive(self, limit: int, now_host_ns: int) -> bytes:
        """Give the companion everything that has come."""
        del limit, now_host_ns
        data = b"".join(self.to_companion)
        self.to_companion.clear()
        return data

    def send(self, data: bytes | list[bytes]) -> bool:
        """Take frames: bytes from the companion, a list of bytes from the vehicle."""
        if isinstance(data, bytes):
            self.to_vehicle.append(data)
        else:
            self.to_companion.extend(data)
        return True

    def drain(self) -> bytes:
        """Give the vehicle everything that has come."""
        data = b"".join(self.to_vehicle)
        self.to_vehicle.clear()
        return data

    def close(self) -> None:
        """Release the descriptor."""
        if self._ready >= 0:
            os.close(self._ready)
            self._ready = -1

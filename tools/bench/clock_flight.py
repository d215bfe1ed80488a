"""Clock estimation in flight: our adapter against the simulated autopilot and nodes over a lossy, jittery link.

Simulated time, so that this machine's load does not matter; adapter, decoder, wire and autopilot are the real ones.
20 % of all frames are lost in both directions, the vehicle's clock runs ahead of ours by 10 ms a minute, and half way
through the autopilot restarts. It answers from the ticks of its loop.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from companion.adapters.mavlink.link.link import Link
from companion.adapters.mavlink.vehicle.autopilot import MavlinkAutopilot
from companion.core.clock.bank import ClockBank
from companion.params.airframe import Airframe
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import ClockName, ClockRestart, TimesyncReply
from companion.sim.flight.flight import Flight, build_flight
from companion.sim.vehicle.faults import Faults
from companion.sim.vehicle.lockstep import EPOCH_NS, LockStepClock, MemoryWire
from companion.sim.vehicle.world import World, WorldOptions

DURATION_S, REBOOT_S, SILENT_S = 120.0, 60.0, 1.0
LOSS, JITTER_S = 0.2, 0.03
SKEW = 10e-3 / 60.0
_LOOK_NS = 5_000_000


class FastTime(LockStepClock):
    """The vehicle's clock runs ahead of the companion's."""

    def boot_ns(self, host_ns: int) -> int:
        """The vehicle's flight time."""
        return round((host_ns - EPOCH_NS) * (1.0 + SKEW))

    def _pass_until(self, host_ns: int) -> None:
        self._now_ns = host_ns
        while self._turned_ns + 1_000_000 <= host_ns:
            self._turned_ns += 1_000_000
            self.world.run_once(self.boot_ns(self._turned_ns), self._turned_ns)


@dataclass
class Watched:
    """Estimate of the autopilot's clock, looked at every 5 ms; trips are of the epoch that is looked at."""

    error_ns: list[int] = field(default_factory=list)
    bound_ns: list[int] = field(default_factory=list)
    excess_ns: list[float] = field(default_factory=list)
    least_trip_ns: float = np.inf
    locked_s: list[float] = field(default_factory=list)


def run(duration_s: float = DURATION_S) -> list[dict[str, float | str]]:
    """Give a row per link: share of true bounds, median bound and its excess over half the least trip, error, locks."""
    flight = build_flight(_light(load_airframe("nadir-2m")), 1, duration_s + 1.0)
    return [
        _row("400 Hz loop, no jitter", flight, 400, 0.0, duration_s),
        _row("400 Hz loop, 0-30 ms jitter", flight, 400, JITTER_S, duration_s),
        _row("50 Hz loop, no jitter", flight, 50, 0.0, duration_s),
    ]


def _row(name: str, flight: Flight, loop_hz: float, jitter_s: float, duration_s: float) -> dict[str, float | str]:
    faults = Faults(loss=LOSS, jitter_s=jitter_s, reorder=True, reboots=((1, REBOOT_S, SILENT_S),))
    watched = _fly(flight, faults, loop_hz, duration_s)
    error, bound = np.array(watched.error_ns, dtype=float), np.array(watched.bound_ns, dtype=float)
    back_s = REBOOT_S + SILENT_S
    again = [at_s - back_s for at_s in watched.locked_s if at_s >= back_s]
    return {
        "name": name,
        "true": float(np.mean(error <= bound)),
        "bound_ms": float(np.median(bound)) / 1e6,
        "excess_ms": float(np.median(watched.excess_ns)) / 1e6,
        "error_ms": float(np.sqrt(np.mean(error**2))) / 1e6,
        "lock_s": max(watched.locked_s[0], again[0] if again else np.inf),
    }


def _fly(flight: Flight, faults: Faults, loop_hz: float, duration_s: float) -> Watched:
    wire = MemoryWire()
    world = World(flight, WorldOptions(faults=faults, parameters={"SCHED_LOOP_RATE": loop_hz}), wire)
    clock = FastTime(world)
    pilot = MavlinkAutopilot([Link(0, "simulated", wire, clock)], flight.airframe, Settings(), clock)
    bank, watched, synced, next_ns, now_ns = ClockBank(), Watched(), False, 0, EPOCH_NS
    while now_ns < EPOCH_NS + duration_s * 1e9:
        for record in pilot.poll(0.002):
            if isinstance(record, TimesyncReply):
                bank.exchange(record)
                if record.clock is ClockName.BOOT:
                    watched.least_trip_ns = min(watched.least_trip_ns, record.received_host_ns - record.sent_host_ns)
            elif isinstance(record, ClockRestart):
                bank.restart(record)
                watched.least_trip_ns = np.inf
        now_ns = clock.now_ns()
        if now_ns >= next_ns:
            next_ns = now_ns + _LOOK_NS
            synced = _look(bank, watched, clock.boot_ns(now_ns), now_ns, synced)
    pilot.close()
    return watched


def _look(bank: ClockBank, watched: Watched, flight_ns: int, now_ns: int, was_synced: bool) -> bool:
    """Ask for the host time of a stamp that the autopilot would give just now, and compare it with the truth."""
    back_ns = round((REBOOT_S + SILENT_S) * 1e9)
    if REBOOT_S * 1e9 <= flight_ns < back_ns:
        return False  # it says nothing, so nothing can be stamped
    boot_ns = flight_ns - back_ns if flight_ns >= back_ns else flight_ns
    converted = bank.to_host(ClockName.BOOT, np.array([boot_ns], dtype=np.int64), received_host_ns=now_ns)
    if not isinstance(converted, tuple):
        return False
    if not was_synced:
        watched.locked_s.append(flight_ns * 1e-9)
    host, bound_ns = converted
    watched.error_ns.append(abs(int(host[0]) - now_ns))
    watched.bound_ns.append(bound_ns)
    watched.excess_ns.append(bound_ns - watched.least_trip_ns / 2)
    return True


def _light(airframe: Airframe) -> Airframe:
    """Slow nodes: it is the autopilot's time that is looked at, and samples would only cost processor time."""
    slow: dict[str, Any] = {
        name: dataclasses.replace(getattr(airframe, name), rate_hz=100.0) for name in ("left", "right")
    }
    return dataclasses.replace(airframe, **slow)

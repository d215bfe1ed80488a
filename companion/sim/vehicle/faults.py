"""Faults of the link between the simulated vehicle and its companion."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np

from companion.sim.vehicle.wire import AUTOPILOT_ID


@dataclass(frozen=True, slots=True)
class Faults:
    """Faults to inject; the default is none. Components are MAVLink ids (1, 200, 201), times are seconds of flight.

    ``loss`` (both directions) and ``duplicate`` (outward) are probabilities for each frame. Each outward frame is
    delayed by a uniform time up to ``jitter_s``, and may be overtaken only with ``reorder``. Each of ``reboots`` is
    (component, t_s, silence_s): the component is silent, then returns with its clock near zero and its settings lost.
    The others are (component, from_s, to_s): in ``stops`` its inertial stream alone is silent, in ``silences`` all of
    it, and in ``nans`` its vertical acceleration is NaN.
    """

    loss: float = 0.0
    duplicate: float = 0.0
    jitter_s: float = 0.0
    reorder: bool = False
    reboots: tuple[tuple[int, float, float], ...] = ()
    stops: tuple[tuple[int, float, float], ...] = ()
    silences: tuple[tuple[int, float, float], ...] = ()
    nans: tuple[tuple[int, float, float], ...] = ()

    def silent(self, component: int, t_s: float) -> bool:
        """Tell whether a component says nothing at all."""
        rebooting = any(at <= t_s < at + silence for who, at, silence in self.reboots if who == component)
        return rebooting or _inside(self.silences, component, t_s)

    def stopped(self, component: int, t_s: float) -> bool:
        """Tell whether its inertial stream is silent."""
        return _inside(self.stops, component, t_s)

    def broken(self, component: int, t_s: float) -> bool:
        """Tell whether it sends NaN."""
        return _inside(self.nans, component, t_s)

    def restarts(self, component: int, t_s: float) -> list[float]:
        """Instants up to now at which the component's clock began anew."""
        return [at + silence for who, at, silence in self.reboots if who == component and at + silence <= t_s]


def _inside(spans: tuple[tuple[int, float, float], ...], component: int, t_s: float) -> bool:
    return any(start <= t_s < stop for who, start, stop in spans if who == component)


class Wire:
    """The link outward: loses, doubles, delays and reorders frames."""

    def __init__(self, faults: Faults, rng: np.random.Generator) -> None:
        self._faults = faults
        self._rng = rng
        self._pending: list[tuple[int, int, bytes]] = []
        self._counter = 0
        self._last_ns = 0
        self.lost = 0

    def drops(self) -> bool:
        """Draw whether the next frame is lost."""
        lost = self._faults.loss > 0 and self._rng.random() < self._faults.loss
        self.lost += lost
        return lost

    def carry(self, frames: list[bytes], now_ns: int) -> list[bytes]:
        """Take frames in and give those that have come through by now."""
        faults = self._faults
        if not (faults.loss or faults.duplicate or faults.jitter_s):
            return frames
        for frame in frames:
            self._push(frame, now_ns)
        out = []
        while self._pending and self._pending[0][0] <= now_ns:
            out.append(heapq.heappop(self._pending)[2])
        return out

    def _push(self, frame: bytes, now_ns: int) -> None:
        faults = self._faults
        if self.drops():
            return
        copies = 2 if faults.duplicate and self._rng.random() < faults.duplicate else 1
        for _ in range(copies):
            due = now_ns
            if faults.jitter_s:
                due += int(self._rng.uniform(0.0, faults.jitter_s * 1e9))
            if not faults.reorder:
                due = self._last_ns = max(due, self._last_ns)
            self._counter += 1
            heapq.heappush(self._pending, (due, self._counter, frame))


def boot_origin_ns(faults: Faults, t_boot_ns: int, component: int = AUTOPILOT_ID) -> int:
    """Flight time at which a component's clock last began."""
    restarts = faults.restarts(component, t_boot_ns * 1e-9)
    return round(max(restarts) * 1e9) if restarts else 0

"""Everything compiled before the first real sample: a made-up wing flown through a throw-away estimation.

The compiler may take a minute where no machine code is kept from an earlier start; the inertial process must spend it
before its link opens, never in flight.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from companion.core.kernels.compiled import COMPILED, watched
from companion.core.pipeline import smoothed, start, step
from companion.core.trigger.latency import LatencyModel
from companion.core.trigger.planner import HORIZON_NS, STEP_NS, Planner
from companion.params.airframe import Airframe
from companion.params.settings import Settings
from companion.records import Axis, ClockName, Floats, ImuBatch, Station, Tick, TimesyncReply, Validity
from companion.units import GRAVITY_MPS2

_EPOCH_NS = 1_000_000_000_000  # any host time
_LENGTH_S = 11.2  # the first fit comes after 1.5 s, the first rate of a drift after 10 s
_TICK_NS = 20_000_000  # the service's timer
_ROUND_TRIP_NS = 400_000  # a good link


def warm_up(airframe: Airframe, settings: Settings, compiling: Callable[[int], object] = lambda _: None) -> None:
    """Run all that is compiled once with this airframe's sizes.

    ``compiling`` is called with the number of functions begun, as each begins to be compiled: never, where the machine
    code of an earlier start is kept.
    """
    if not COMPILED:
        return
    begun: list[str] = []

    def begins(name: str) -> None:
        begun.append(name)
        compiling(len(begun))

    with watched(begins):
        _fly(airframe, settings)


def _fly(airframe: Airframe, settings: Settings) -> None:
    state = start(airframe, settings)
    for now_ns in range(_EPOCH_NS + _TICK_NS, _EPOCH_NS + round(_LENGTH_S * 1e9), _TICK_NS):
        for station in Station:
            rate_hz = airframe.sensor(station).rate_hz
            first, last = (round((at - _EPOCH_NS) * 1e-9 * rate_hz) for at in (now_ns - _TICK_NS, now_ns))
            t_ns = _EPOCH_NS + (np.arange(first, last) / rate_hz * 1e9).astype(np.int64)
            batch = ImuBatch(station, ClockName.HOST, t_ns, _readings(t_ns, station), Axis.ALL, now_ns)
            state, _ = step(state, batch)
        state, _ = step(state, TimesyncReply(ClockName.BOOT, now_ns - _ROUND_TRIP_NS, now_ns, now_ns))
        state, _ = step(state, Tick(now_ns))
    state.clocks.to_host(ClockName.BOOT, np.arange(now_ns - _TICK_NS, now_ns, 1_000_000), now_ns)
    smoothed(state, _EPOCH_NS + round((_LENGTH_S - 0.5) * 1e9))
    if state.scheduling is not None:  # a made-up wing need not be one that is tracked
        planner = Planner(airframe, settings, LatencyModel(airframe))
        planner.plan(state.tracker.forecast(HORIZON_NS, STEP_NS), Validity.TRACKING, now_ns)


def _readings(t_ns: np.ndarray[tuple[int], np.dtype[np.int64]], station: Station) -> Floats:
    """A level aircraft whose tips swing; sines of many periods stand in for noise."""
    t = (t_ns - _EPOCH_NS)[:, None] * 1e-9
    values: Floats = 0.01 * np.sin(t * np.arange(100.0, 700.0, 100.0) + station)
    values[:, 2] -= GRAVITY_MPS2 + (0.0 if station is Station.ROOT else 1.0) * np.sin(30.0 * t[:, 0])
    return values

"""A stand-in for the companion on the simulated vehicle's wire: ranges of a known error, without cameras or estimation.

For rehearsing what acts on ranges (missions, landings) many times faster than real time, and for making just those
faults that a script must notice. It says what the service would: HEARTBEAT as component 191, DISTANCE_SENSOR, and the
sigma as NAMED_VALUE_FLOAT.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.sim.vehicle.wire import FrameSender

COMPONENT = 191  # MAV_COMP_ID_ONBOARD_COMPUTER
_RATE_NS = 100_000_000  # chosen: the default of OUT_RATE
_BEAT_NS = 1_000_000_000  # convention: heartbeats come once a second (MAVLink)
_ALIVE, _UNTRUSTED = 90, 1  # convention: 1 of signal_quality is "invalid", 100 perfect (MAVLink common.xml)
_BASELINE_M = 1.98  # airframe nadir-2m (convention)
_LIMITS_M = (4.0, 200.0)  # defaults of RNG_MIN and RNG_MAX (convention)
_SIGMA_PER_M = 0.45 / 60.0**2  # over the range squared: 0.45 m at 60 m (choice)


@dataclass(slots=True)
class RangeFaults:
    """Faults of the stub's ranges; may be changed in flight.

    ``toe_rad`` is relative toe that is not corrected: ``1/Z' = 1/Z + toe/B``. The range is ``scale`` times what it
    should be (focal length or baseline wrong), with ``jump_m`` added; ``untrusted`` is alive without a range,
    ``silent`` nothing at all.
    """

    toe_rad: float = 0.0
    scale: float = 1.0
    jump_m: float = 0.0
    untrusted: bool = False
    silent: bool = False


class CompanionStub:
    """One port of a :class:`~companion.sim.vehicle.routing.Router`.

    ``distance_m`` gives the true distance now, None where there is nothing to see, and ``now_ns`` boot time. ``faults``
    may be changed in flight; ``bend_mm`` is the symmetric and antisymmetric deflection to send for the graphs.
    """

    def __init__(
        self, distance_m: Callable[[], float | None], now_ns: Callable[[], int], *, orientation: int = 25
    ) -> None:
        self.faults = RangeFaults()
        self.bend_mm: tuple[float, float] | None = None
        self._distance_m, self._now_ns = distance_m, now_ns
        self._orientation = orientation
        self._rng = np.random.default_rng(1)
        self._sender = FrameSender(COMPONENT)
        self._next_ns = self._beat_ns = 0

    def send(self, frames: list[bytes]) -> None:
        """Nothing that is said interests it."""

    def close(self) -> None:
        """Nothing to release."""

    def drain(self) -> bytes:
        """Messages that are due."""
        now_ns, out = self._now_ns(), b""
        if self.faults.silent:
            return out
        if now_ns >= self._beat_ns:
            self._beat_ns = now_ns + _BEAT_NS
            out += self._sender.message(
                mavlink.MAVLink_heartbeat_message(
                    mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                    mavlink.MAV_AUTOPILOT_INVALID,
                    0,
                    0,
                    mavlink.MAV_STATE_ACTIVE,
                    3,
                )
            )
        if now_ns >= self._next_ns:
            self._next_ns = max(self._next_ns + _RATE_NS, now_ns)
            out += self._range(now_ns // 1_000_000)
            for name, value in zip((b"q_sym_mm", b"q_anti_mm"), self.bend_mm or (), strict=False):
                out += self._sender.message(mavlink.MAVLink_named_value_float_message(now_ns // 1_000_000, name, value))
        return out

    def _range(self, boot_ms: int) -> bytes:
        (least, most), true_m = _LIMITS_M, self._distance_m()
        if true_m is not None and true_m <= 0.0:
            true_m = None
        sigma_m = _SIGMA_PER_M * (true_m or most) ** 2
        range_m = math.nan if true_m is None else self._measured(true_m, sigma_m)
        good = least <= range_m <= most and not self.faults.untrusted and sigma_m <= 0.03 * range_m
        distance, quality = (round(range_m * 100), _ALIVE) if good else (round(most * 100) + 1, _UNTRUSTED)
        variance = min(math.ceil((100 * sigma_m) ** 2), 255) if good and sigma_m < 0.16 else 255
        message = mavlink.MAVLink_distance_sensor_message(
            boot_ms, round(least * 100), round(most * 100), distance, 4, 0, self._orientation, variance,
            signal_quality=quality,
        )  # fmt: skip
        out = bytes(self._sender.message(message))
        if good:
            out += bytes(
                self._sender.message(mavlink.MAVLink_named_value_float_message(boot_ms, b"rng_sig_m", sigma_m))
            )
        return out

    def _measured(self, true_m: float, sigma_m: float) -> float:
        faults = self.faults
        inverse = 1.0 / true_m + faults.toe_rad / _BASELINE_M
        if inverse <= 0:
            return math.inf
        return faults.scale / inverse + faults.jump_m + float(self._rng.normal(0.0, sigma_m))

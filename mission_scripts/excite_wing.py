"""Excite the wing with doublets at increasing airspeed, and record its answer.

At each airspeed the aircraft flies level, nods (pitch doublets: the symmetric modes) and rocks (roll doublets: the
antisymmetric ones), and flies on with still controls after each so that the wing rings out. Between airspeeds it
circles where it began. Slowest first: the next airspeed is flown only when the wing's motion has died away at this one.

The doublets are attitude demands in GUIDED, inside the autopilot's own limits; it forgets them three seconds after the
last one, so a lost link ends them. Needs ArduPlane, in the air (or --take-off), with room to fly straight.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Sequence

from mission_scripts.common.flight import Flight
from mission_scripts.common.options import parser_for
from mission_scripts.common.outcome import Aborted, Exit
from mission_scripts.common.run import run
from mission_scripts.common.vehicle import GUIDED

_SEND_S = 0.04
_SPEED_OFF_MPS = 1.0
_SPEED_S = 40.0
_LEVEL_S = 1.5
_TRIM_S = 2.0
_FEW, _GROWN, _LEAST_MM = 5, 2.0, 10.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = parser_for("excite_wing", __doc__ or "")
    parser.add_argument("--airspeeds", type=float, nargs="+", default=[18.0, 20.0, 22.0], metavar="M/S")
    parser.add_argument("--doublets", type=int, default=3, metavar="N", help="of each kind at each airspeed")
    parser.add_argument("--pitch", type=float, default=6.0, metavar="DEG", help="either side of level flight")
    parser.add_argument("--roll", type=float, default=15.0, metavar="DEG", help="either side of level flight")
    parser.add_argument("--half", type=float, default=0.35, metavar="S", help="length of each half of a doublet")
    parser.add_argument("--rest", type=float, default=3.0, metavar="S", help="still controls after each doublet")
    parser.add_argument("--height", type=float, metavar="M", help="above home (default: where it is)")
    parser.add_argument("--bend-limit", type=float, default=60.0, metavar="MM", help="of the tips, as the service says")
    options = parser.parse_args(arguments)
    if list(options.airspeeds) != sorted(set(options.airspeeds)) or options.airspeeds[0] <= 0:
        parser.error("--airspeeds must increase: the slowest comes first")
    if not (0 < options.pitch <= 15 and 0 < options.roll <= 40 and 0.1 <= options.half <= 1.0):
        parser.error("--pitch up to 15, --roll up to 40 degrees, --half from 0.1 to 1 s")
    return run(options, excite)


def excite(flight: Flight) -> Exit:
    """The mission."""
    options, watch = flight.options, flight.watch
    flight.await_service()
    flight.be_airborne()
    home, height_m = watch.place, options.height or watch.height_m
    wing = Wing(flight)
    flight.guard.more = wing.check
    for airspeed_mps in options.airspeeds:
        where = (home.latitude_deg, home.longitude_deg)
        flight.change_mode(GUIDED, lambda where=where: flight.vehicle.circle_at(where, height_m))  # type: ignore[misc]
        flight.vehicle.airspeed(airspeed_mps)
        flight.wait(f"airspeed {airspeed_mps:g} m/s", lambda v=airspeed_mps: _settled(flight, v, height_m), _SPEED_S)  # type: ignore[misc]
        flight.say(f"at {airspeed_mps:g} m/s: {options.doublets} pitch and {options.doublets} roll doublets")
        _doublets(flight, wing, airspeed_mps)
    flight.vehicle.airspeed(-2.0)
    flight.leave()
    flight.say(f"{wing.flown} doublets flown at {len(options.airspeeds)} airspeeds; {wing.told()}")
    return Exit.DONE


def _settled(flight: Flight, airspeed_mps: float, height_m: float) -> bool:
    watch = flight.watch
    return abs(watch.airspeed_mps - airspeed_mps) < _SPEED_OFF_MPS and abs(watch.height_m - height_m) < 8.0


def _doublets(flight: Flight, wing: Wing, airspeed_mps: float) -> None:
    options = flight.options
    wing.begin()
    trim = _trim(flight)
    _hold(flight, 0.0, trim, _LEVEL_S)
    wing.calm()
    pitch, roll = math.radians(options.pitch), math.radians(options.roll)
    for number in range(2 * options.doublets):
        nod = number % 2 == 0
        kick = (0.0, pitch) if nod else (roll, 0.0)
        _hold(flight, 0.0, trim, _LEVEL_S)
        _hold(flight, kick[0], trim + kick[1], options.half)
        _hold(flight, -kick[0], trim - kick[1], options.half)
        wing.begin()
        _hold(flight, 0.0, trim, options.rest)
        wing.flown += 1
        flight.say(f"  {'pitch' if nod else 'roll'} doublet {number // 2 + 1}: {wing.decayed(airspeed_mps)}")


def _trim(flight: Flight) -> float:
    """Pitch of level flight at this airspeed, from a while of it."""
    seen: list[float] = []
    ends_s = time.monotonic() + _TRIM_S
    while time.monotonic() < ends_s:
        flight.guard.check()
        seen.append(flight.watch.pitch_rad)
        time.sleep(_SEND_S)
    return statistics.fmean(seen)


def _hold(flight: Flight, roll_rad: float, pitch_rad: float, seconds: float) -> None:
    """Hold an attitude, under guard."""
    ends_s = time.monotonic() + seconds
    while time.monotonic() < ends_s:
        flight.guard.check()
        flight.vehicle.attitude(roll_rad, pitch_rad)
        time.sleep(_SEND_S)


class Wing:
    """The wing's motion as the service tells it (q_sym_mm, q_anti_mm); without the service nothing is known of it."""

    def __init__(self, flight: Flight) -> None:
        self._watch = flight.watch
        self._limit_mm: float = flight.options.bend_limit
        self._seen: list[tuple[float, float]] = []
        self._most_mm = self._calm_mm = 0.0
        self._last_s = 0.0
        self.flown = 0

    def begin(self) -> None:
        """What comes from here on is looked at together."""
        self._seen.clear()

    def calm(self) -> None:
        """Keep how far gusts alone swing the wing, from level flight since :meth:`begin`."""
        self._calm_mm = _swing(self._seen)

    def check(self) -> None:
        """Gather, and hold the tips to their limit (called by the guard)."""
        at_s = self._watch.named.get("q_sym_mm", (-math.inf, 0.0))[0]
        both = [self._watch.named_value(name) for name in ("q_sym_mm", "q_anti_mm")]
        if both[0] is None or both[1] is None or at_s == self._last_s:
            return
        self._last_s = at_s
        bend_mm = abs(both[0]) + abs(both[1])  # of the tip that is bent more
        self._most_mm = max(self._most_mm, bend_mm)
        self._seen.append((at_s, bend_mm))
        if bend_mm > self._limit_mm:
            raise Aborted(f"a wing tip bends by {bend_mm:.0f} mm, limit {self._limit_mm:g} mm")

    def decayed(self, airspeed_mps: float) -> str:
        """In words; raises Aborted where the motion grows instead of dying away, which is how flutter begins.

        Gusts swing the wing all the time: only what is well beyond them, at the end of the rest, counts as growth.
        """
        half = len(self._seen) // 2
        if half < _FEW:
            return "recorded"
        early, late = (_swing(part) for part in (self._seen[:half], self._seen[half:]))
        if late > early and late > max(_GROWN * self._calm_mm, _LEAST_MM):
            raise Aborted(
                f"at {airspeed_mps:g} m/s the wing's motion grows from {early:.0f} to {late:.0f} mm, "
                f"gusts alone swing it {self._calm_mm:.0f} mm"
            )
        return f"swings {early:.1f} mm, then {late:.1f} mm (gusts alone {self._calm_mm:.1f} mm)"

    def told(self) -> str:
        """The greatest bend, in words."""
        if not self._last_s:
            return "the service told nothing of the bend on this link (it was not watched)"
        return f"greatest bend {self._most_mm:.0f} mm"


def _swing(seen: list[tuple[float, float]]) -> float:
    values = [value for _, value in seen]
    return max(values, default=0.0) - min(values, default=0.0)


if __name__ == "__main__":
    sys.exit(main())

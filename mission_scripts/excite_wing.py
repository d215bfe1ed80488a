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
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from companion.cli.steps.numbers import seconds
from mission_scripts.common.flight import Flight
from mission_scripts.common.options import count, degrees, height, millimetres, parser_for, speed
from mission_scripts.common.outcome import Aborted, Exit
from mission_scripts.common.places import Place
from mission_scripts.common.run import run
from mission_scripts.common.vehicle import GUIDED
from mission_scripts.common.watch import Watch

_SEND_S = 0.04
_SPEED_OFF_MPS = 1.0
_HEIGHT_OFF_M, _NEAR_M, _SETTLE_S = 8.0, 200.0, 120.0
_FAR = 0.4  # of the circle's radius
_USUAL = -2.0  # the autopilot's own cruise speed
_LEVEL_S, _TRIM_S = 1.5, 4.0
_PITCH_PER_MPS, _MOST_SLOW_RAD, _SLOWEST = 0.02, 0.08, 0.75
_SILENT_S = 2.0  # chosen: eight messages at the default OUT_DEBUG
_FEW, _GROWN, _LEAST_MM = 5, 2.0, 10.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line."""
    parser = parser_for("excite_wing", __doc__ or "")
    parser.add_argument("--airspeeds", type=speed, nargs="+", default=[18.0, 20.0, 22.0], metavar="M/S")
    parser.add_argument("--doublets", type=count, default=3, metavar="N", help="of each kind at each airspeed")
    parser.add_argument("--pitch", type=degrees, default=6.0, metavar="DEG", help="either side of level flight")
    parser.add_argument("--roll", type=degrees, default=15.0, metavar="DEG", help="either side of level flight")
    parser.add_argument("--half", type=seconds, default=0.35, metavar="S", help="length of each half of a doublet")
    parser.add_argument("--rest", type=seconds, default=3.0, metavar="S", help="still controls after each doublet")
    parser.add_argument("--height", type=height, metavar="M", help="above home (default: where it is)")
    parser.add_argument("--bend-limit", type=millimetres, default=60.0, metavar="MM", help="of tips, by the service")
    options = parser.parse_args(arguments)
    if list(options.airspeeds) != sorted(set(options.airspeeds)):
        parser.error("--airspeeds must increase: the slowest comes first")
    if not (0 < options.pitch <= 15 and 0 < options.roll <= 40 and 0.1 <= options.half <= 1.0):
        parser.error("--pitch up to 15, --roll up to 40 degrees, --half from 0.1 to 1 s")
    return run(options, excite)


def excite(flight: Flight) -> Exit:
    """The mission."""
    options, watch = flight.options, flight.watch
    flight.be_airborne()
    home, height_m = watch.place, options.height or watch.height_m
    wing = Wing(flight)
    flight.guard.more = wing.check
    for airspeed_mps in options.airspeeds:
        place = Working(home, height_m, airspeed_mps)
        place.come_back(flight)
        flight.say(f"at {airspeed_mps:g} m/s: {options.doublets} pitch and {options.doublets} roll doublets")
        _doublets(flight, wing, place)
    flight.vehicle.airspeed(_USUAL)
    flight.leave()
    flight.say(f"{wing.flown} doublets flown at {len(options.airspeeds)} airspeeds; {wing.summary()}")
    return Exit.DONE


@dataclass(frozen=True, slots=True)
class Working:
    """Where, how high and how fast the doublets are flown."""

    home: Place
    height_m: float
    airspeed_mps: float

    def come_back(self, flight: Flight) -> None:
        """Circle at home until height and airspeed are right."""
        flight.change_mode(GUIDED, lambda: flight.vehicle.circle_at(self.home, self.height_m))
        flight.vehicle.airspeed(self.airspeed_mps)
        flight.wait(f"circling for {self.airspeed_mps:g} m/s", lambda: self._settled(flight.watch), _SETTLE_S)

    def _settled(self, watch: Watch) -> bool:
        right = abs(watch.airspeed_mps - self.airspeed_mps) < _SPEED_OFF_MPS
        return right and abs(watch.height_m - self.height_m) < _HEIGHT_OFF_M and self.away_m(watch) < _NEAR_M

    def away_m(self, watch: Watch) -> float:
        """Distance from home."""
        return self.home.distance_m(watch.place)


def _doublets(flight: Flight, wing: Wing, place: Working) -> None:
    options = flight.options
    pitch, roll = math.radians(options.pitch), math.radians(options.roll)
    level: Level | None = None
    for number in range(2 * options.doublets):
        if place.away_m(flight.watch) > _FAR * options.radius:
            place.come_back(flight)
            level = None
        if level is None:
            wing.begin()
            level = Level(flight, place.airspeed_mps)
            wing.calm()
        nod = number % 2 == 0
        level.fly(_LEVEL_S)
        for sign in (1.0, -1.0):
            level.fly(options.half, 0.0 if nod else sign * roll, sign * pitch if nod else 0.0)
        wing.begin()
        level.fly(options.rest)
        if wing.wants_more:
            level.fly(options.rest)
        wing.flown += 1
        flight.say(f"  {'pitch' if nod else 'roll'} doublet {number // 2 + 1}: {wing.decayed(place.airspeed_mps)}")


class Level:
    """Level flight with forced attitude: the pitch that the autopilot flies at this airspeed, and kicks on top of it.

    A forced pitch leaves height and airspeed to themselves; a slow correction by airspeed keeps them together.
    """

    def __init__(self, flight: Flight, airspeed_mps: float) -> None:
        self._flight, self._airspeed_mps = flight, airspeed_mps
        bends: list[float] = []
        self._send(_TRIM_S, lambda: flight.vehicle.attitude(0.0, None), lambda: bends.append(flight.watch.pitch_rad))
        self._trim_rad = statistics.fmean(bends[len(bends) // 2 :])

    def fly(self, seconds: float, roll_rad: float = 0.0, kick_rad: float = 0.0) -> None:
        """Hold for so long, under guard."""
        too_fast = self._flight.watch.airspeed_mps - self._airspeed_mps
        slow = min(max(_PITCH_PER_MPS * too_fast, -_MOST_SLOW_RAD), _MOST_SLOW_RAD)
        self._send(seconds, lambda: self._flight.vehicle.attitude(roll_rad, self._trim_rad + slow + kick_rad))

    def _send(self, seconds: float, *each: Callable[[], object]) -> None:
        ends_s = time.monotonic() + seconds
        while time.monotonic() < ends_s:
            self._flight.hear()
            self._flight.guard.check()
            if self._flight.watch.airspeed_mps < _SLOWEST * self._airspeed_mps:
                raise Aborted(f"airspeed down to {self._flight.watch.airspeed_mps:.1f} m/s")
            for act in each:
                act()
            time.sleep(_SEND_S)


class Wing:
    """The wing's motion as the service tells it (q_sym_mm, q_anti_mm); without the service nothing is known of it."""

    def __init__(self, flight: Flight) -> None:
        self._watch = flight.watch
        self._limit_mm: float = flight.options.bend_limit
        self._bends: list[tuple[float, float]] = []
        self._most_mm = self._calm_mm = 0.0
        self._last_s = 0.0
        self.flown = 0

    def begin(self) -> None:
        """Start a new series of bends."""
        self._bends.clear()

    def calm(self) -> None:
        """Keep how far gusts alone swing the wing, from level flight since :meth:`begin`."""
        self._calm_mm = _swing(self._bends)

    def check(self) -> None:
        """Gather, and hold the tips to their limit (called by the guard)."""
        at_s = self._watch.named.get("q_sym_mm", (-math.inf, 0.0))[0]
        if self._last_s and time.monotonic() - at_s > _SILENT_S:
            raise Aborted(f"the service told nothing of the bend for {_SILENT_S:g} s: nobody watches the wing")
        both = [self._watch.named_value(name) for name in ("q_sym_mm", "q_anti_mm")]
        if both[0] is None or both[1] is None or at_s == self._last_s:
            return
        self._last_s = at_s
        bend_mm = abs(both[0]) + abs(both[1])  # of the tip that is bent more
        self._most_mm = max(self._most_mm, bend_mm)
        self._bends.append((at_s, bend_mm))
        if bend_mm > self._limit_mm:
            raise Aborted(f"a wing tip bends by {bend_mm:.0f} mm, limit {self._limit_mm:g} mm")

    @property
    def wants_more(self) -> bool:
        """Whether the wing is watched, and too few bends were heard to see whether its motion dies away."""
        return bool(self._last_s) and len(self._bends) < 2 * _FEW

    def decayed(self, airspeed_mps: float) -> str:
        """In words; raises Aborted where the motion grows instead of dying away, which is how flutter begins.

        Gusts swing the wing all the time: only what is well beyond them, at the end of the rest, counts as growth. A
        wing that was watched, and is so no more, is flown no faster.
        """
        if self.wants_more:
            raise Aborted(
                f"{len(self._bends)} bends were heard after the doublet, and {2 * _FEW} show whether the motion dies "
                "away: raise OUT_DEBUG or --rest, or mend the link"
            )
        if not self._last_s:
            return "recorded"
        half = len(self._bends) // 2
        early, late = (_swing(half_bends) for half_bends in (self._bends[:half], self._bends[half:]))
        if late > early and late > max(_GROWN * self._calm_mm, _LEAST_MM):
            raise Aborted(
                f"at {airspeed_mps:g} m/s the wing's motion grows from {early:.0f} to {late:.0f} mm, "
                f"gusts alone swing it {self._calm_mm:.0f} mm"
            )
        return f"swings {early:.1f} mm, then {late:.1f} mm (gusts alone {self._calm_mm:.1f} mm)"

    def summary(self) -> str:
        """The greatest bend, in words."""
        if not self._last_s:
            return "the service told nothing of the bend on this link (it was not watched)"
        return f"greatest bend {self._most_mm:.0f} mm"


def _swing(bends: list[tuple[float, float]]) -> float:
    values = [value for _, value in bends]
    return max(values, default=0.0) - min(values, default=0.0)


if __name__ == "__main__":
    sys.exit(main())

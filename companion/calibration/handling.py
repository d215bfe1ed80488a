"""Judgement of a wing that a person handles on the bench: taps name a node, tilts show its axes and signs.

At rest an accelerometer feels the ground's push, (0, 0, -g) in level body axes (forward, right, down). Right wing down
by an angle phi it reads y = -g sin(phi), nose up by theta x = g sin(theta), and the gyro's integral is that same angle:
two witnesses of one rotation, which agree only where axes, signs and units are right.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from companion.records import Axis, Floats, Station
from companion.units import GRAVITY_MPS2

TAP_MPS2 = 1.5
"""Least peak of a tap, above all that a still bench shows (choice)."""
TAP_RATIO = 2.0
"""Least ratio of the tapped tip's peak to the other's: the wing passes a part of the blow on (choice)."""
STILL_MPS2 = 0.3
"""Largest scatter of a wing at rest: several times a node's noise (choice)."""
TILT_RAD = math.radians(10.0)
"""Least tilt that is judged, five times what may be wrong (choice)."""
AGREEMENT_RAD = math.radians(5.0)
"""Largest angle between a tip's vertical and the root's: mounting, dihedral and twist together (choice)."""
TIPS = (Station.LEFT, Station.RIGHT)


class Tilt(enum.Enum):
    """Rotation that is asked for, by the column of its rate."""

    RIGHT_WING_DOWN = 3
    NOSE_UP = 4

    @property
    def words(self) -> str:
        """Name in a sentence."""
        return self.name.lower().replace("_", " ")

    def angle_rad(self, force_mps2: Floats) -> float:
        """Angle about this axis by the specific force at rest (3,); positive as asked."""
        x, y, z = (float(value) for value in force_mps2)
        return math.atan2(-y, -z) if self is Tilt.RIGHT_WING_DOWN else math.atan2(x, math.hypot(y, z))


@dataclass(frozen=True, slots=True)
class Judgement:
    """One figure of a step, and what to do where it does not pass."""

    figure: str
    remedy: str = ""


def is_still(samples: Mapping[Station, Floats]) -> bool:
    """Whether no station moves; samples (n, 6) of a second each."""
    return all(len(values) > 1 and _scatter_mps2(values) < STILL_MPS2 for values in samples.values())


def tap_peaks(samples: Mapping[Station, Floats]) -> dict[Station, float]:
    """Peak of the vertical about its median at each station, m/s^2; samples (n, 6) of each."""
    return {
        station: float(np.max(np.abs(values[:, 2] - np.median(values[:, 2]))))
        for station, values in samples.items()
        if len(values)
    }


def judge_tap(samples: Mapping[Station, Floats], asked: Station) -> Judgement:
    """Judge a tap on one tip by the peaks of both; samples (n, 6) of each station."""
    peaks = tap_peaks(samples)
    other = Station.RIGHT if asked is Station.LEFT else Station.LEFT
    struck, across = peaks.get(asked, 0.0), peaks.get(other, 0.0)
    figure = f"{_name(asked)} {struck:.1f} m/s^2, {_name(other)} {across:.1f} m/s^2"
    if struck >= TAP_RATIO * across:
        return Judgement(figure)
    if across >= TAP_RATIO * struck:
        return Judgement(figure, "the nodes are exchanged: swap their components (200 is left), or the two sources")
    return Judgement(figure, "both tips moved alike: tap one with a fingernail and leave the other alone")


def judge_tilt(
    before: Mapping[Station, Floats], after: Mapping[Station, Floats], turned_rad: Mapping[Station, float],
    axes: Mapping[Station, Axis], tilt: Tilt,
) -> dict[Station, Judgement]:  # fmt: skip
    """Judge axes and signs of every station by a tilt.

    Parameters
    ----------
    before, after : mapping
        Mean specific force at rest (3,), m/s^2.
    turned_rad : mapping
        Integral of the gyro about the tilt's axis meanwhile, rad.
    axes : mapping
        Axes that each station sends.
    tilt : Tilt
        Rotation that was asked for.
    """
    root_rad = tilt.angle_rad(after[Station.ROOT]) - tilt.angle_rad(before[Station.ROOT])
    return {
        station: _judge_station(station, before[station], after[station], turned_rad[station], axes[station], tilt,
                                root_rad)
        for station in after
    }  # fmt: skip


def _judge_station(
    station: Station, before: Floats, after: Floats, turned_rad: float, axes: Axis, tilt: Tilt, root_rad: float
) -> Judgement:
    if axes & Axis.X and axes & Axis.Y:
        angle_rad, witness = tilt.angle_rad(after) - tilt.angle_rad(before), "gravity"
    else:  # the vertical alone tells the size of a tilt and not its side
        angle_rad, witness = math.copysign(_vertical_rad(after) - _vertical_rad(before), root_rad), "its vertical"
    figure = f"{math.degrees(angle_rad):+.1f} deg by {witness}"
    sends_rate = bool(axes & (Axis.P if tilt is Tilt.RIGHT_WING_DOWN else Axis.Q))
    figure += f", {math.degrees(turned_rad):+.1f} deg by its gyro" if sends_rate else ""
    return Judgement(figure, _remedy(station, angle_rad, turned_rad if sends_rate else None, after, tilt, root_rad))


def _remedy(
    station: Station, angle_rad: float, turned_rad: float | None, after: Floats, tilt: Tilt, root_rad: float
) -> str:
    letter = "y" if tilt is Tilt.RIGHT_WING_DOWN else "x"
    rate = "p" if tilt is Tilt.RIGHT_WING_DOWN else "q"
    where = f"[{_name(station)}].source"
    if float(after[2]) > 0.5 * -GRAVITY_MPS2:
        return f"z does not show the ground's push of -9.8 m/s^2: turn its sign in {where}"
    if station is Station.ROOT and angle_rad < TILT_RAD:
        return f"it was tilted the other way, or the autopilot's {letter} axis is turned: {tilt.words} is asked for"
    if abs(angle_rad + root_rad) < AGREEMENT_RAD < abs(root_rad):
        return f"{letter} has the wrong sign: turn it in {where}"
    if abs(angle_rad - root_rad) > AGREEMENT_RAD:
        return f"the root tilted by {math.degrees(root_rad):+.1f} deg: exchanged axes, or mounted askew; see {where}"
    if turned_rad is None or abs(turned_rad - angle_rad) <= AGREEMENT_RAD:
        return ""
    turned_back = abs(turned_rad + angle_rad) <= AGREEMENT_RAD
    return f"{rate} has the wrong sign: turn it in {where}" if turned_back else f"{rate} is another axis, see {where}"


def _vertical_rad(force_mps2: Floats) -> float:
    return math.acos(min(1.0, max(-1.0, -float(force_mps2[2]) / GRAVITY_MPS2)))


def _scatter_mps2(values: Floats) -> float:
    return float(np.std(values[:, :3], axis=0).max())


def _name(station: Station) -> str:
    return station.name.lower()

"""Laws without a name: forces of deflection, speed and time, sensors' laws of acceleration and time, and regressors
of the measured toe.

They are tested like named effects and compete with them. They are described, and never given as a cause.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from companion.core.wing.effect import (
    Effect,
    Group,
    ModalMotion,
    ResidualPeak,
    harmonic,
    on_halves,
    parameter,
    with_vertical,
)
from companion.core.wing.structure import Structure
from companion.diagnosis.model.generic_sensing import GenericLag, GenericLeak, GenericPhase
from companion.diagnosis.model.generic_slip import GenericSlip
from companion.records import Complexes, Floats, Station

_Law = Callable[[Floats, Floats], Floats]
_Sway = Callable[[Floats], Floats]

LAWS: dict[str, _Law] = {
    "deflection times its amount": lambda w, v: np.abs(w) * w + 0.0 * v,
    "amount of deflection": lambda w, v: np.abs(w) + 0.0 * v,
    "deflection squared": lambda w, v: w**2 + 0.0 * v,
    "deflection cubed": lambda w, v: w * w * w + 0.0 * v,
    "fifth power of deflection": lambda w, v: w * w * w * w * w + 0.0 * v,
    "sign of deflection": lambda w, v: np.tanh(4.0 * w) + 0.0 * v,
    "speed times its amount": lambda w, v: np.abs(v) * v + 0.0 * w,
    "speed cubed": lambda w, v: v * v * v + 0.0 * w,
    "sign of speed": lambda w, v: np.tanh(4.0 * v) + 0.0 * w,
    "speed squared": lambda w, v: v**2 + 0.0 * w,
    "deflection squared times speed": lambda w, v: w**2 * v,
    "amount of deflection times sign of speed": lambda w, v: np.abs(w) * np.tanh(4.0 * v),
}
"""Over deflection and speed in units of their rms."""

TIMES: dict[str, _Sway] = {
    "deflection, drifting in time": lambda x: x,
    "deflection, bowed in time": lambda x: 1.5 * x**2 - 0.5,
    "deflection, swaying once": lambda x: np.sin(np.pi * x),
    "deflection, swaying twice": lambda x: np.cos(2.0 * np.pi * x),
    "deflection, swaying three times": lambda x: np.sin(3.0 * np.pi * x),
}
"""Over time from -1 to 1 across the recording."""

_INSTANTS = {"1/6": -2.0 / 3.0, "1/3": -1.0 / 3.0, "1/2": 0.0, "2/3": 1.0 / 3.0, "5/6": 2.0 / 3.0}
"""Instants of a recording, and where they lie from -1 to 1 across it."""
_SIDES = {"": False, ", left against right": True}
"""Both sides alike, or against each other, as a law's name says it."""
_SETTINGS = 23  # instants at which a clock that competes with names may have been set: 2.5 s apart in a minute (choice)


@dataclass(frozen=True, slots=True)
class GenericForce(Effect):
    """A force of either half's deflection and speed, in units of the rms spring force."""

    group: ClassVar[Group] = Group.STRUCTURE
    law: ClassVar[_Law]

    strength: float = parameter("", 0.1, "share of the rms spring force")

    def force(self, motion: ModalMotion) -> Floats:
        """Apply the law."""
        unit_m, unit_mps = float(np.std(motion.q_m[0])), float(np.std(motion.qdot_mps[0]))
        spring = motion.half_stiffness_radps2 * unit_m
        law = type(self).law
        return on_halves(motion, lambda w, v: -self.strength * spring * law(w / unit_m, v / unit_mps))


@dataclass(frozen=True, slots=True)
class GenericVaryingStiffness(GenericForce):
    """A spring force that changes in time."""

    sway: ClassVar[_Sway]

    def force(self, motion: ModalMotion) -> Floats:
        """Apply the law."""
        return -self.strength * type(self).sway(across(np.asarray(motion.t_s))) * motion.spring_mps2


@dataclass(frozen=True, slots=True)
class GenericStiffness(Effect):
    """A spring force along with the deflection: all modes alike, or the right side against the left."""

    group: ClassVar[Group] = Group.STRUCTURE
    against: ClassVar[bool] = False

    strength: float = parameter("", 0.2, "share of the stiffness, its logarithm where both sides are alike")

    def structure(self, structure: Structure) -> Structure:
        """Stiffen."""
        return dataclasses.replace(structure, stiffness_radps2=self._grown(structure, structure.stiffness_radps2))

    def _grown(self, structure: Structure, matrix: Floats) -> Floats:
        if not type(self).against:
            return np.asarray(matrix * np.exp(self.strength))
        grown = matrix.copy()
        for s, a in structure.pairs():
            for i, j in ((s, a), (a, s)):
                grown[i, j] += self.strength * np.sqrt(matrix[s, s] * matrix[a, a])
        return grown


@dataclass(frozen=True, slots=True)
class GenericDamping(GenericStiffness):
    """The same of the damping."""

    strength: float = parameter("", 0.5, "share of the damping, its logarithm where both sides are alike")

    def structure(self, structure: Structure) -> Structure:
        """Damp."""
        return dataclasses.replace(structure, damping_radps=self._grown(structure, structure.damping_radps))


SENSED: dict[str, Callable[[Floats, Floats], Floats]] = {
    "acceleration squared": lambda a, x: a**2 + 0.0 * x,
    "acceleration cubed": lambda a, x: a * a * a + 0.0 * x,
    "amount of acceleration times acceleration": lambda a, x: np.abs(a) * a + 0.0 * x,
    "acceleration, drifting in time": lambda a, x: a * x,
    "acceleration, bowed in time": lambda a, x: a * (1.5 * x**2 - 0.5),
}
"""Over upward acceleration in units of its rms, and time from -1 to 1."""


@dataclass(frozen=True, slots=True)
class GenericSensorLaw(Effect):
    """One law of the sensors' basis, on both sides alike or against each other, in units of the rms acceleration."""

    group: ClassVar[Group] = Group.SENSING
    law: ClassVar[_Law]
    against: ClassVar[bool] = False

    strength: float = parameter("", 0.05, "share of the rms acceleration")

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Apply the law to the upward axis."""
        if station is Station.ROOT:
            return values
        up = values[:, 2] - np.mean(values[:, 2])
        unit = max(float(np.std(up)), 1e-12)
        sign = -1.0 if self.against and station is Station.LEFT else 1.0
        bend = sign * self.strength * unit * type(self).law(up / unit, across(t_s))
        return with_vertical(values, values[:, 2] + bend)


@dataclass(frozen=True, slots=True)
class GenericToe(Effect):
    """Regressor of the measured toe, in units of its own rms."""

    group: ClassVar[Group] = Group.CAMERA
    follows: ClassVar[str]

    strength_rad: float = parameter("rad", 1e-3, "rms of what is added")

    def added(self, offered: Mapping[str, Floats]) -> Floats | float:
        """Share of the toe, (k,)."""
        return self.strength_rad * offered[self.follows] if self.follows in offered else 0.0


@dataclass(frozen=True, slots=True)
class GenericToeVariance(Effect):
    """Regressor of the measured toe's variance, in units of its own mean."""

    group: ClassVar[Group] = Group.CAMERA
    one_way: ClassVar[bool] = True
    adds_toe_variance: ClassVar[bool] = True
    grows_with: ClassVar[str]

    load_ratio: float = parameter("", 2.0, "of the variance that is there anyway")

    def growth(self, offered: Mapping[str, Floats]) -> Floats | float:
        """Share of the variance that is added, (k,)."""
        return max(self.load_ratio, 0.0) * offered[self.grows_with] if self.grows_with in offered else 0.0


@dataclass(frozen=True, slots=True)
class GenericBias(Effect):
    """Constant reading of one side at rest."""

    group: ClassVar[Group] = Group.SENSING
    station: ClassVar[Station]

    shown_mps2: float = parameter("m/s^2", 0.2, "constant on the upward axis")

    def bias(self, station: Station) -> float:
        """Add it on its side."""
        return self.shown_mps2 if station is self.station else 0.0


@dataclass(frozen=True, slots=True)
class GenericRollOff(Effect):
    """A gain that falls with the square of frequency at zero phase, on both sides alike or against each other."""

    group: ClassVar[Group] = Group.SENSING
    against: ClassVar[bool] = False

    fall: float = parameter("", 0.2, "logarithm of what is lost at the top of the band")

    def response(self, station: Station, f_hz: Floats) -> Complexes | None:
        """Damp whatever the station shows."""
        if station is Station.ROOT:
            return None
        sign = -1.0 if self.against and station is Station.LEFT else 1.0
        return np.exp(-sign * self.fall * (f_hz / max(float(f_hz[-1]), 1e-9)) ** 2).astype(np.complex128)


@dataclass(frozen=True, slots=True)
class GenericClockDrift(Effect):
    """The delay of one side grows in time; it is 0 in the middle, because a constant delay is a nuisance already."""

    group: ClassVar[Group] = Group.SENSING
    station: ClassVar[Station] = Station.RIGHT

    late_s: float = parameter("s", 0.002, "at the end, and as early at the start")

    def sample_time(self, station: Station, t_s: Floats) -> Floats:
        """The instant that a stamp shows, on its side."""
        return t_s - self.late_s * across(t_s) if station is self.station else t_s


@dataclass(frozen=True, slots=True)
class GenericClockStep(Effect):
    """The clock of one side is set at an instant: its stamps are late from then on."""

    group: ClassVar[Group] = Group.SENSING
    station: ClassVar[Station] = Station.RIGHT
    set_at: ClassVar[float] = 0.0  # from -1 to 1 across the recording

    late_s: float = parameter("s", 0.002, "by what the clock was set back")

    def sample_time(self, station: Station, t_s: Floats) -> Floats:
        """The instant that a stamp shows, on its side."""
        return t_s - self.late_s * (across(t_s) > self.set_at) if station is self.station else t_s


@dataclass(frozen=True, slots=True)
class GenericLine(Effect):
    """One frequency in the sensors' readings, in units of ``shares`` of left and right."""

    group: ClassVar[Group] = Group.SENSING
    starts_at: ClassVar = ResidualPeak.LINE
    shares: ClassVar[tuple[float, float]]

    cosine_mps2: float = parameter("m/s^2", 0.5, "in phase with the start")
    sine_mps2: float = parameter("m/s^2", 0.5, "a quarter period later")
    frequency_hz: float = parameter("Hz", 10.0, "frequency", default=12.0)

    def sense(self, station: Station, t_s: Floats, values: Floats) -> Floats:
        """Add it to the upward axis."""
        if station is Station.ROOT:
            return values
        line = harmonic(self.cosine_mps2, self.sine_mps2, self.frequency_hz, t_s)
        return with_vertical(values, values[:, 2] - self.shares[0 if station is Station.LEFT else 1] * line)


@dataclass(frozen=True, slots=True)
class GenericForceLine(Effect):
    """One frequency in the load of the first symmetric mode, or of the first antisymmetric one."""

    group: ClassVar[Group] = Group.FORCING
    starts_at: ClassVar = ResidualPeak.LINE
    mode: ClassVar[int]

    cosine_mps2: float = parameter("m/s^2", 0.5, "in phase with the start")
    sine_mps2: float = parameter("m/s^2", 0.5, "a quarter period later")
    frequency_hz: float = parameter("Hz", 10.0, "frequency", default=12.0)

    def force(self, motion: ModalMotion) -> Floats:
        """Load the mode, where there is one."""
        added = np.zeros_like(motion.q_m)
        added[self.mode : self.mode + 1] = harmonic(self.cosine_mps2, self.sine_mps2, self.frequency_hz, motion.t_s)
        return added


TOE = (
    "symmetric deflection",
    "its rate",
    "its square",
    "its cube",
    "its rate squared",
    "deflection drifting in time",
    "rate drifting in time",
    "load factor",
    "the whole reading",
    "inverse distance",
    "inverse distance squared",
    "deflection by inverse distance",
    "time",
    "time squared",
    "antisymmetric deflection",
    "antisymmetric rate",
    "deflection of a further mode",
    "rate of a further mode",
)
PLAY = {"little play of the mounts": 0.15, "play of the mounts": 0.3, "much play of the mounts": 0.6}
"""Half-width of a mount's play, in units of the deflection's rms."""
BOTH_LATE = "both sides late"
SPREAD = ("deflection", "its rate", "rates of both cameras", "inverse distance", "time")


def generic_effects() -> list[type[Effect]]:
    """Every law as an effect of its own."""
    return [
        *_force_laws(),
        *_sensor_laws(),
        _kind(GenericSlip, "springs that slip"),
        *_gains_and_clocks(),
        *(_kind(GenericToe, f"range residual against {name}", follows=name) for name in (*TOE, *PLAY)),
        *(_kind(GenericToeVariance, f"range residual growing with {name}", grows_with=name) for name in SPREAD),
    ]


def _force_laws() -> list[type[Effect]]:
    return [
        *(_kind(GenericForce, f"force with {name}", law=staticmethod(law)) for name, law in LAWS.items()),
        *(_kind(GenericVaryingStiffness, f"force with {name}", sway=staticmethod(law)) for name, law in TIMES.items()),
        *(
            _kind(base, f"force with {what}{sides}", against=against)
            for base, what in ((GenericStiffness, "deflection"), (GenericDamping, "speed"))
            for sides, against in _SIDES.items()
        ),
    ]


def _sensor_laws() -> list[type[Effect]]:
    return [
        *(
            _kind(GenericSensorLaw, f"sensors with {name}{sides}", law=staticmethod(law), against=against)
            for name, law in SENSED.items()
            for sides, against in _SIDES.items()
        ),
        *(
            _kind(base, f"{side.name.lower()} side {what}", station=side)
            for base, what in ((GenericBias, "at rest"), (GenericLeak, "showing the other side too"))
            for side in (Station.LEFT, Station.RIGHT)
        ),
        _kind(GenericPhase, "left side phase growing with frequency", stations=(Station.LEFT,)),
        _kind(GenericPhase, "right side phase growing with frequency", stations=(Station.RIGHT,)),
        _kind(GenericPhase, BOTH_LATE, stations=(Station.LEFT, Station.RIGHT)),
        _kind(GenericLag, "both sides lagging"),
    ]


def _gains_and_clocks() -> list[type[Effect]]:
    right_first = (Station.RIGHT, Station.LEFT)
    return [
        *(_kind(GenericRollOff, f"gain falling with frequency{sides}", against=by) for sides, by in _SIDES.items()),
        *(_kind(GenericClockDrift, f"{side.name.lower()} side ever later", station=side) for side in right_first),
        *(
            _kind(
                GenericClockStep,
                f"{side.name.lower()} clock set after {what} of the recording",
                station=side,
                set_at=at,
            )
            for side in right_first
            for what, at in _INSTANTS.items()
        ),
    ]


def generic_clock_settings() -> list[type[Effect]]:
    """Clocks that were set once, at many instants of a recording; those of one side have one name."""
    return [
        _kind(GenericClockStep, f"{side.name.lower()} clock set during the recording", station=side, set_at=at)
        for side in (Station.RIGHT, Station.LEFT)
        for at in np.linspace(-1.0, 1.0, _SETTINGS + 2)[1:-1].tolist()
    ]


def generic_lines() -> list[type[Effect]]:
    """Single frequencies in the sensors or the load, which begin where the residual has a line."""
    sensed = {"alike": (1.0, 1.0), "left against right": (-1.0, 1.0), "left": (1.0, 0.0), "right": (0.0, 1.0)}
    loads = {"both sides alike": 0, "left against right": 1}
    return [
        *(_kind(GenericLine, f"a line, {how}", shares=shares) for how, shares in sensed.items()),
        *(_kind(GenericForceLine, f"a line in the load, {how}", mode=mode) for how, mode in loads.items()),
    ]


def _kind(base: type[Effect], title: str, **constants: object) -> type[Effect]:
    return type(base.__name__, (base,), {"__slots__": (), "name": title, **constants})


def across(t_s: Floats) -> Floats:
    """Time (m,) from -1 to 1 across the recording."""
    return np.asarray(2.0 * (t_s - t_s[0]) / max(float(t_s[-1] - t_s[0]), 1e-9) - 1.0)

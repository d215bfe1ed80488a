"""One landing: aeroplane, gusts and autopilot, advanced a control period at a time while somebody measures ranges.

What the autopilot commands takes effect one period of its 50 Hz servo outputs later. So the truth always reaches at
least 20 ms ahead of the present, which is what sensors that average and cameras that expose need.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from companion.core.wing.model import WingModel
from companion.params.airframe import Airframe
from companion.sim.flight.perturb import TruthAirframe, draw_truth
from companion.sim.flight.truth import TipShape
from companion.sim.landing.aerodynamics import Controls
from companion.sim.landing.airplane import Airplane
from companion.sim.landing.approach import Approach, LandingParameters
from companion.sim.landing.autolander import Autolander, LandingStage
from companion.sim.landing.autopilot_senses import AutopilotSenses
from companion.sim.landing.control_loops import PERIOD_S, NavigationState
from companion.sim.landing.flexible_aircraft import STEP_NS, BodyState, FlexibleAircraft
from companion.sim.landing.growing_truth import GrowingTruth
from companion.sim.landing.trim import trimmed
from companion.sim.landing.turbulence import AirMotion, Turbulence

PERIOD_NS = round(PERIOD_S * 1e9)  # derived: the control loops' period
GUST_WIND_MPS = 6.0
"""Wind at 20 ft whose turbulence is flown: 0.6 m/s rms of vertical gust (choice)."""

_STEPS = PERIOD_NS // STEP_NS
_GUST_HEIGHT_M = 30.0  # chosen: a height of the approach, for which the Dryden scales are taken
_AFTER_TOUCH_S, _AFTER_GO_AROUND_S = 1.0, 3.0  # chosen: enough of the roll-out, or of the climb, to be seen
_SPARE_S = 1.0  # chosen: of room behind the longest flight, for exposures and averages


class RangeSource(Protocol):
    """A range finder that looks down."""

    def reading_m(self, now_ns: int) -> float | None:
        """Newest good range along the body's z axis at a boot time; None while there is none."""
        ...


class LandingPilot(Protocol):
    """Who steers: :class:`companion.sim.landing.autolander.Autolander`, or another autopilot in its place."""

    why: str

    @property
    def stage(self) -> LandingStage:
        """Part of the landing."""

    @property
    def flare(self) -> object | None:
        """Report of its flare, None before it begins."""

    @property
    def dropped(self) -> int:
        """Ranges that it took for a glitch."""

    def commands(self, state: NavigationState, range_m: float | None, *, on_wheels: bool) -> Controls:
        """Controls of the next period."""


@dataclass(frozen=True, slots=True)
class TouchDown:
    """First contact of a wheel; ``north_m`` is from the landing point, along the runway."""

    t_s: float
    north_m: float
    east_m: float
    sink_mps: float
    airspeed_mps: float


@dataclass(frozen=True, slots=True)
class FlareTruth:
    """The truth as the flare began; ``intended_m`` is the height that the rule asks for at this sink rate."""

    t_s: float
    height_m: float
    intended_m: float


class LandingFlight:
    """Flies; :meth:`advance` is one control period of 20 ms.

    The truth is drawn from the airframe's sigmas; ``seed`` determines everything but the ranges. ``gusts`` is
    turbulence, or still air. ``state`` is where it begins (16 numbers, see
    :class:`companion.sim.landing.flexible_aircraft.FlexibleAircraft`), trimmed on the level leg by default.
    """

    def __init__(
        self,
        airframe: Airframe,
        seed: int,
        *,
        gusts: bool,
        approach: Approach | None = None,
        limits: LandingParameters | None = None,
        state: Sequence[float] | None = None,
    ) -> None:
        self.airframe, self.seed = airframe, seed
        self.approach = approach or Approach()
        self.limits = limits or LandingParameters()
        self.real: TruthAirframe = draw_truth(airframe, np.random.default_rng(seed))
        self.model = WingModel.from_airframe(self.real.actual)
        plane = Airplane.of_airframe(airframe)
        if state is None:
            state = trimmed(plane, self.approach.airspeed_mps).state(
                self.approach.height_m, self.approach.start_north_m
            )
        self.aircraft = FlexibleAircraft(plane, self.model, list(state))
        self.senses = AutopilotSenses(np.random.default_rng([seed, *b"senses"]))
        self.pilot: LandingPilot = Autolander(plane, self.approach, self.limits)
        self.flare: FlareTruth | None = None
        self.touch: TouchDown | None = None
        steps = round((self.longest_s + _SPARE_S) * 1e9 / STEP_NS)
        self.truth = GrowingTruth(TipShape.from_model(self.model), STEP_NS, steps + 1)
        self._air = self._turbulence(steps) if gusts else Turbulence.calm()
        self._frame = 0
        self._sink_mps = 0.0
        self._over_s = self.longest_s
        self._bodies: list[BodyState] = []
        self._fly(Controls(*state[12:16]))

    @property
    def longest_s(self) -> float:
        """Time after which the flight ends in any case."""
        return self.approach.longest_s

    @property
    def now_ns(self) -> int:
        """Boot time of the next control period."""
        return self._frame * PERIOD_NS

    @property
    def over(self) -> bool:
        """Whether it has landed, gone around or flown too long."""
        return self.now_ns * 1e-9 >= self._over_s

    @property
    def on_ground(self) -> bool:
        """Whether a wheel has touched."""
        return self.touch is not None

    @property
    def present(self) -> BodyState:
        """The rigid motion at the present."""
        return self._bodies[0]

    def advance(self, range_m: float | None) -> None:
        """Command by the autopilot with the newest range, and fly the period after the next."""
        body, t_s = self.present, self.now_ns * 1e-9
        airspeed_mps = self._airspeed_mps(body)
        self._touched(t_s, body, airspeed_mps)
        measured = self.senses.measured(t_s, body, airspeed_mps)
        before = self.pilot.stage
        commands = self.pilot.commands(measured, range_m, on_wheels=body.wheels_n > 0.0)
        self._note_stage(t_s, body, before)
        self._fly(commands)
        self._frame += 1

    def _fly(self, commands: Controls) -> None:
        """Integrate one period; at the start also its first knot."""
        step = round(self.aircraft.wing.t_s * 1e9) // STEP_NS
        first = not len(self.truth.knots)
        if first:
            self.truth.add(*self.aircraft.knot(commands, self._air.at(step)))
            self._bodies.append(self.aircraft.body(commands, self._air.at(step)))
        for number in range(step, step + _STEPS):
            before, after = self._air.at(number), self._air.at(number + 1)
            self.aircraft.step(commands, before, after)
            self.truth.add(*self.aircraft.knot(commands, after))
        self._bodies.append(self.aircraft.body(commands, self._air.at(step + _STEPS)))
        if not first:
            del self._bodies[0]

    def _note_stage(self, t_s: float, body: BodyState, before: LandingStage) -> None:
        stage = self.pilot.stage
        if stage is LandingStage.FLARE and before is LandingStage.SLOPE and self.pilot.flare is not None:
            intended_m = max(self.limits.flare_alt_m, body.velocity_ned_mps[2] * self.limits.flare_sec)
            self.flare = FlareTruth(t_s, -body.position_ned_m[2], intended_m)
        if stage is LandingStage.GO_AROUND and before is not stage:
            self._over_s = min(t_s + _AFTER_GO_AROUND_S, self.longest_s)

    def _touched(self, t_s: float, body: BodyState, airspeed_mps: float) -> None:
        if self.touch is None and body.wheels_n > 0.0:
            north, east, _ = body.position_ned_m
            self.touch = TouchDown(t_s, north, east, self._sink_mps, airspeed_mps)
            self._over_s = min(t_s + _AFTER_TOUCH_S, self.longest_s)
        self._sink_mps = body.velocity_ned_mps[2]

    def _airspeed_mps(self, body: BodyState) -> float:
        gust: AirMotion = self._air.at(self.now_ns // STEP_NS)
        return math.hypot(*body.velocity_ned_mps) - gust.u_mps

    def _turbulence(self, steps: int) -> Turbulence:
        return Turbulence.dryden(
            np.random.default_rng([self.seed, *b"gusts"]),
            steps + 1,
            STEP_NS * 1e-9,
            wind_mps=GUST_WIND_MPS,
            height_m=_GUST_HEIGHT_M,
            airspeed_mps=self.approach.airspeed_mps,
            span_m=self.aircraft.plane.span_m,
        )


@dataclass(slots=True)
class TrueRange:
    """A perfect range finder: the distance along the body's z axis to the ground, ten times a second, 0.1 s late."""

    flight: LandingFlight
    _due_ns: int = 0
    _newest_m: float | None = None
    _coming_m: float | None = None

    def reading_m(self, now_ns: int) -> float | None:
        """As :class:`RangeSource`."""
        if now_ns >= self._due_ns:
            self._due_ns = now_ns + 100_000_000
            self._newest_m, self._coming_m = self._coming_m, self._now_m()
        return self._newest_m

    def _now_m(self) -> float | None:
        body, limits = self.flight.present, self.flight.limits
        roll, pitch, _ = body.euler_rad
        range_m = -body.position_ned_m[2] / (math.cos(roll) * math.cos(pitch))
        return range_m if limits.range_min_m <= range_m <= limits.range_max_m else None


def fly_landing(flight: LandingFlight, source: RangeSource) -> None:
    """Fly to the end with the ranges of a source."""
    while not flight.over:
        flight.advance(source.reading_m(flight.now_ns))

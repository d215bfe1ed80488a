"""The aeroplane around the wing: mass, inertia, size, aerodynamic derivatives, propeller and wheels.

Derivatives are those of a straight-winged aeroplane of aspect ratio 6.7 with flaps set for landing; signs and
normalisation as Stevens and Lewis, *Aircraft Control and Simulation*, section 2.3 (rates by b/2V and c/2V).
"""

from __future__ import annotations

from dataclasses import dataclass, field

from companion.params.airframe import Airframe

AIR_DENSITY_KGPM3 = 1.225  # ICAO standard atmosphere at sea level (convention)
_SPAN_M = 2.0  # of the aeroplane that the numbers below describe (choice)


@dataclass(frozen=True, slots=True)
class Longitudinal:
    """Coefficients of lift, drag and pitching moment, per radian where they multiply an angle."""

    lift_zero: float = 0.30
    lift_alpha: float = 4.8
    lift_pitch_rate: float = 4.0
    lift_elevator: float = 0.35
    drag_zero: float = 0.07
    drag_lift_square: float = 0.06
    moment_zero: float = 0.02
    moment_alpha: float = -0.9
    moment_pitch_rate: float = -14.0
    moment_elevator: float = -1.1


@dataclass(frozen=True, slots=True)
class Lateral:
    """Coefficients of side force, rolling and yawing moment, per radian."""

    side_beta: float = -0.6
    side_rudder: float = 0.15
    roll_beta: float = -0.08
    roll_roll_rate: float = -0.5
    roll_yaw_rate: float = 0.14
    roll_aileron: float = 0.17
    yaw_beta: float = 0.09
    yaw_roll_rate: float = -0.03
    yaw_yaw_rate: float = -0.12
    yaw_aileron: float = -0.005
    yaw_rudder: float = -0.07


@dataclass(frozen=True, slots=True)
class Gear:
    """Three wheels on springs and dampers; places are body FRD, two mains first."""

    places_m: tuple[tuple[float, float, float], ...] = ((-0.08, -0.35, 0.25), (-0.08, 0.35, 0.25), (0.55, 0.0, 0.25))
    sink_at_rest_m: float = 0.03
    damping_ratio: float = 0.5
    rolling_friction: float = 0.06
    side_friction: float = 0.6


@dataclass(frozen=True, slots=True)
class Airplane:
    """Everything rigid about it.

    ``inertia_kgm2`` is Ixx, Iyy, Izz; products are left out. Beyond ``alpha_limits_rad`` of angle of attack the lift
    stays constant: the model has no stall. ``thrust_n`` is static, at full throttle, and falls by ``thrust_per_mps``
    per m/s of airspeed; ``servo_time_s`` and ``motor_time_s`` are first-order lags of the surfaces and the propeller.
    """

    mass_kg: float = 6.0
    inertia_kgm2: tuple[float, float, float] = (0.75, 0.6, 1.25)
    span_m: float = _SPAN_M
    chord_m: float = 0.3
    alpha_limits_rad: tuple[float, float] = (-0.15, 0.22)
    thrust_n: float = 35.0
    thrust_per_mps: float = 0.7
    servo_time_s: float = 0.05
    motor_time_s: float = 0.2
    longitudinal: Longitudinal = field(default_factory=Longitudinal)
    lateral: Lateral = field(default_factory=Lateral)
    gear: Gear = field(default_factory=Gear)

    @property
    def area_m2(self) -> float:
        """Wing area."""
        return self.span_m * self.chord_m

    @classmethod
    def of_airframe(cls, airframe: Airframe) -> Airplane:
        """Scale the two-metre aeroplane to an airframe's span.

        Mass goes with the cube of the length and inertia with its fifth power, so that wing loading per length, and
        with it the angle of attack at ``sqrt(length)`` times the speed, stays (Froude's similarity).
        """
        ratio = 2.0 * airframe.wing.semispan_m / _SPAN_M
        base = cls()
        ix, iy, iz = (ratio**5 * value for value in base.inertia_kgm2)
        x, y, z = (ratio * value for value in base.gear.places_m[2])
        mains = tuple((ratio * a, ratio * b, ratio * c) for a, b, c in base.gear.places_m[:2])
        return cls(
            mass_kg=ratio**3 * base.mass_kg,
            inertia_kgm2=(ix, iy, iz),
            span_m=ratio * base.span_m,
            chord_m=ratio * base.chord_m,
            thrust_n=ratio**3 * base.thrust_n,
            thrust_per_mps=ratio**2.5 * base.thrust_per_mps,
            gear=Gear((*mains, (x, y, z)), ratio * base.gear.sink_at_rest_m),
        )

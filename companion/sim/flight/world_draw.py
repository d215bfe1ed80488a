"""One flight's draw from a world: the aircraft as that world has worn it, its disturbances, its gusts, its ground.

Everything comes from a generator of its own, so that the same seed flies the same aircraft in every world.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from companion.params.airframe import Airframe, Camera, Sensor, Uncertain
from companion.records import Floats, Station
from companion.sim.flight.aircraft import FlightPlan, PullUp, altitude_m
from companion.sim.flight.gauss_markov import between, wandering
from companion.sim.flight.gust import GustKind
from companion.sim.flight.perturb import TruthAirframe
from companion.sim.flight.truth import FlightTruth
from companion.sim.flight.vibration import SensorDisturbance, ShaftTurns, StationVibration, VibrationLine
from companion.sim.flight.worlds import Conditions, Harmonic, LensResiduals, Propulsion, Span, Weather
from companion.units import GRAVITY_MPS2

CRUISE_THROTTLE = 0.6
"""Share of full throttle in level flight, as the simulated autopilot has always reported it (choice)."""

# throttle for a metre a second of climb (choice; 0.067 by 20 N of full thrust on 3 kg at 22 m/s)
_CLIMB_PER_MPS = 0.06
_FIX_S = 0.2  # time between two updates of a navigation filter by its GPS (ArduPilot's default GPS1_RATE_MS, 5 Hz)
_NAVIGATION_S = 10.0  # correlation time of a navigation filter's velocity error (choice: some updates of its GPS)
_LEAST_HEIGHT_M = 10.0  # that a gust downward leaves (choice)
_LOOKS = 60  # along a gust, to find the least height: some five a second (choice)
_LEAST_THROTTLE = 0.1  # of full throttle: a running propeller idles (choice)


def log_uniform(span: Span, rng: np.random.Generator) -> float:
    """One value of a span; an end of 0 is a value of 0."""
    low, high = span
    u = float(rng.random())
    return low * (high / low) ** u if low > 0.0 else 0.0


def gusty(plan: FlightPlan, weather: Weather, rng: np.random.Generator) -> FlightPlan:
    """The plan with 1-cosine gusts: heave that changes the load factor by the drawn amount within the drawn time.

    Half of them go down, where the flight is high enough. An aircraft on its wheels feels none.
    """
    first_s, last_s = plan.airborne_s
    count = rng.poisson(weather.discrete_per_min * (last_s - first_s) / 60.0) if weather.discrete_per_min else 0
    for _ in range(count):
        length_s = log_uniform(weather.discrete_s, rng)
        peak_mps2 = log_uniform(weather.discrete_g, rng) * GRAVITY_MPS2
        from_s, up = float(rng.uniform(first_s, last_s)), bool(rng.random() < 0.5)
        # smoothstep's steepest place is 35/16 of its mean, so climb = peak * length / (35/16)
        gust = PullUp(from_s, 16.0 / 35.0 * peak_mps2 * length_s, length_s)
        if plan.rolls_on_ground and gust.until_s > last_s:
            continue
        down = dataclasses.replace(
            plan, pull_ups=(*plan.pull_ups, dataclasses.replace(gust, climb_mps=-gust.climb_mps))
        )
        t_s = np.linspace(gust.from_s, gust.until_s, _LOOKS)
        if up or altitude_m(down, t_s).min() < _LEAST_HEIGHT_M:
            plan = dataclasses.replace(plan, pull_ups=(*plan.pull_ups, gust))
        else:
            plan = down
    return plan


def gust_kind(weather: Weather, rng: np.random.Generator) -> GustKind:
    """Spectrum of this flight's gusts."""
    return weather.kinds[int(rng.integers(len(weather.kinds)))] if weather.kinds else GustKind.AIRFRAME


def as_calibrated(airframe: Airframe, world: Conditions) -> Airframe:
    """The airframe file as the calibration of a world's cameras writes it: with the sigmas that it states."""
    return airframe.with_cameras(lambda _, camera: _stated(camera, world.stated))


def _stated(camera: Camera, lenses: LensResiduals) -> Camera:
    """The camera with these sigmas, as terms of ``core.stereo.lens_residual``: a tilt is ``2 P - c``, a prism ``P``."""
    tilt_rad = math.hypot(lenses.principal_px / camera.focal_px.value, 2.0 * lenses.tangential)
    return dataclasses.replace(
        camera, tilt_sigma_rad=tilt_rad, prism_sigma=lenses.tangential, radial_sigma=lenses.radial
    )


def worn(real: TruthAirframe, world: Conditions, rng: np.random.Generator) -> TruthAirframe:
    """The aircraft with the world's sensor noise and lenses, and its gusts as strong as the weather makes them."""
    drawn = (world.sensors.noise_ratio, world.weather.deflection_ratio, world.lenses)
    if drawn == ((1.0, 1.0), (1.0, 1.0), LensResiduals()):
        return real
    actual = real.actual
    ratio = log_uniform(world.weather.deflection_ratio, rng)
    rms = Uncertain(actual.wing.gust.deflection_rms_m.value * ratio)
    gust = dataclasses.replace(actual.wing.gust, deflection_rms_m=rms)
    actual = dataclasses.replace(actual, wing=dataclasses.replace(actual.wing, gust=gust))
    actual = actual.with_sensors(lambda _, sensor: _noisy(sensor, world.sensors.noise_ratio, rng))
    actual = actual.with_cameras(lambda _, camera: _residual(camera, world.lenses, rng))
    return dataclasses.replace(real, actual=actual, antisymmetric_rms_m=real.antisymmetric_rms_m * ratio)


def _noisy(sensor: Sensor, ratio: Span, rng: np.random.Generator) -> Sensor:
    return dataclasses.replace(
        sensor,
        accel_noise_mps2_rthz=sensor.accel_noise_mps2_rthz * log_uniform(ratio, rng),
        gyro_noise_radps_rthz=sensor.gyro_noise_radps_rthz * log_uniform(ratio, rng),
    )


def _residual(camera: Camera, lenses: LensResiduals, rng: np.random.Generator) -> Camera:
    k1, p1, p2, column, row, focal, place = rng.standard_normal(7).tolist()
    # a calibration knows where the middle of the image looks: a wrong principal point comes with the turn that hides it
    across, down = lenses.principal_px * column, lenses.principal_px * row
    turn = np.array(camera.rotation_rad) + np.array([-down, across, 0.0]) / camera.focal_px.value
    pitch, yaw, roll = turn.tolist()
    added = np.array([lenses.radial * k1, 0.0, lenses.tangential * p1, lenses.tangential * p2, 0.0])
    x, y, z = camera.position_m
    return dataclasses.replace(
        camera,
        distortion=tuple((np.array(camera.distortion) + added).tolist()),
        principal_px=(camera.principal_px[0] + across, camera.principal_px[1] + down),
        rotation_rad=(pitch, yaw, roll),
        focal_px=Uncertain(camera.focal_px.value * (1.0 + lenses.focal_ratio * focal)),
        position_m=(x, y + lenses.place_m * place, z),
    )  # fmt: skip


def throttle(truth: FlightTruth, t_s: Floats) -> Floats:
    """Share of full throttle that holds the speed on this path, at instants (n,)."""
    t_ns = np.minimum(np.round(t_s * 1e9).astype(np.int64), truth.t_boot_ns[-1])
    climb_mps = -truth.series(t_ns).velocity_ned_mps[:, 2]
    return np.clip(CRUISE_THROTTLE + _CLIMB_PER_MPS * climb_mps, _LEAST_THROTTLE, 1.0)


class NavigationError:
    """Errors of what the autopilot's navigation filter tells.

    Velocity over ground, north, east and down, is a Gauss-Markov process of :data:`_NAVIGATION_S` that each update by
    GPS moves. ``euler_rad`` (3,), what is added to roll, pitch and yaw, is constant: how the autopilot is mounted, and
    its compass.
    """

    def __init__(self, world: Conditions, duration_s: float, rng: np.random.Generator) -> None:
        self._nodes_s = np.arange(round(duration_s / _FIX_S) + 2) * np.float64(_FIX_S)
        self._nodes_mps = world.velocity_mps * wandering((len(self._nodes_s), 3), _FIX_S / _NAVIGATION_S, rng)
        self.euler_rad: Floats = np.array([world.level_rad] * 2 + [world.heading_rad]) * rng.standard_normal(3)

    def ned_mps(self, t_s: Floats) -> Floats:
        """Error (n, 3) of the velocity at instants (n,)."""
        return between(self._nodes_s, self._nodes_mps, t_s)


class HeatTurn:
    """Turn of each camera by heat since its calibration at the start of the flight, as it warms or cools."""

    def __init__(self, world: Conditions, duration_s: float, rng: np.random.Generator) -> None:
        self._nodes_s = np.arange(0.0, duration_s + 2.0)
        path = world.heat_rad * wandering((len(self._nodes_s), 2 * 3), 1.0 / world.heat_s, rng)
        self._nodes_rad = path - path[0]

    def rotation_rad(self, t_s: float) -> Floats:
        """Rotation vectors (2, 3) of left and right camera at an instant, camera axes."""
        return between(self._nodes_s, self._nodes_rad, np.array([t_s])).reshape(2, 3)


def disturbances(
    world: Conditions, truth: FlightTruth, rng: np.random.Generator
) -> Mapping[Station, SensorDisturbance]:
    """Disturbance of every sensor by the world; nothing at all in a world without vibration and warm-up."""
    wear, propulsion = world.sensors, world.propulsion
    if propulsion is None and not wear.accel_thermal_mps2 and not wear.gyro_thermal_radps:
        return {}
    shaft = None if propulsion is None else _shaft(propulsion, truth, rng)
    sigma = np.repeat([wear.accel_thermal_mps2, wear.gyro_thermal_radps], 3)
    drawn = {}
    for station in Station:
        thermal = sigma * rng.standard_normal(6)
        shaken = None if propulsion is None or shaft is None else _vibration(propulsion, shaft, station, rng)
        drawn[station] = SensorDisturbance(thermal, wear.thermal_s, shaken)
    return drawn


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class _Shaft:
    cruise_hz: float
    turns: ShaftTurns


def _shaft(propulsion: Propulsion, truth: FlightTruth, rng: np.random.Generator) -> _Shaft:
    cruise_hz = log_uniform(propulsion.shaft_hz, rng)
    t_s = ShaftTurns.table_s(truth.duration_s)
    wander = wandering((len(t_s),), float(t_s[1]) / propulsion.wander_s, rng)
    ratio = (throttle(truth, t_s) / CRUISE_THROTTLE) ** propulsion.throttle_exponent
    return _Shaft(cruise_hz, ShaftTurns.from_rate(cruise_hz * ratio * (1.0 + propulsion.wander_ratio * wander)))


def _vibration(propulsion: Propulsion, shaft: _Shaft, station: Station, rng: np.random.Generator) -> StationVibration:
    lines = tuple(_line(propulsion, line, shaft.cruise_hz, station, rng) for line in propulsion.lines)
    accel = [log_uniform(propulsion.broadband_mps2_rthz, rng) for _ in range(3)]
    gyro = [log_uniform(propulsion.broadband_radps_rthz, rng) for _ in range(3)]
    return StationVibration(shaft.turns, lines, np.array(accel + gyro), propulsion.band_hz)


def _line(
    propulsion: Propulsion, line: Harmonic, shaft_hz: float, station: Station, rng: np.random.Generator
) -> VibrationLine:
    vertical_mps2 = log_uniform(line.root_mps2 if station is Station.ROOT else line.tip_mps2, rng)
    rate_radps = vertical_mps2 / (2.0 * math.pi * line.order * shaft_hz * log_uniform(propulsion.arm_m, rng))
    lateral = [log_uniform(propulsion.lateral_ratio, rng) for _ in range(5)]
    amplitude = np.array([vertical_mps2] * 3 + [rate_radps] * 3) * np.array([*lateral[:2], 1.0, *lateral[2:]])
    return VibrationLine(line.order, amplitude, rng.uniform(0.0, 2.0 * math.pi, 6))

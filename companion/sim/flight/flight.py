"""A simulated flight from a seed: the truth of aircraft and wing, and everything that its inertial sensors will say."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from companion.core.wing.model import WingModel
from companion.core.wing.structure import SLOT_NAMES
from companion.params.airframe import Airframe, NamedEffect, Sensor
from companion.records import ClockName, Floats, Station
from companion.sim.flight.aircraft import FlightPlan, demo_plan, fly, jolted, lift_share
from companion.sim.flight.gust import (
    DrydenScales,
    GustKind,
    LoadSpectrum,
    dryden_roll,
    dryden_vertical,
    modal_rms,
    pole_spectrum,
    white_spectrum,
)
from companion.sim.flight.perturb import TruthAirframe, draw_truth, exact_truth
from companion.sim.flight.sensors import (
    BackendImu,
    RealSensor,
    SensorStream,
    autopilot_stream,
    backend_imu,
    node_stream,
)
from companion.sim.flight.truth import MODAL, FlightTruth, TipShape
from companion.sim.flight.wing import SUBSTEP_S, integrate
from companion.sim.flight.world_draw import (
    CRUISE_THROTTLE,
    HeatTurn,
    NavigationError,
    disturbances,
    gust_kind,
    gusty,
    throttle,
    worn,
)
from companion.sim.flight.worlds import IDEAL, Conditions
from companion.units import GRAVITY_MPS2

LOOP_HZ = 400.0  # chosen: a main loop that sends 400 Hz, as SCHED_LOOP_RATE is set for the wing's streams
_TAIL_S = 2.0  # chosen: longer than any sensor's averaging and any exposure reaches behind the end
_BURN_IN_S = 12.0  # chosen: a mode of 5 Hz and 3 % damping has forgotten its start to one in 80,000
_DRYDEN_WIND_MPS = 10.0  # chosen: a breezy day; MIL-F-8785C calls 15 knots light, 30 moderate
_DRYDEN_ALTITUDE_M = 60.0  # chosen: the height of the demo's level flight
_WORLD_PURPOSES = (b"weather", b"wear", b"shake")  # names of generators: one more draw in one changes no other
# derived: of a uniform cantilever's bending modes in a shaken root, by slot
_PARTICIPATION = {0: 1.566, 2: -0.868, 4: 0.509}


@dataclass(frozen=True, slots=True)
class Flight:
    """One flight, deterministic from its seed.

    Attributes
    ----------
    airframe : Airframe
        The belief that the service is given.
    real : TruthAirframe
        The aircraft that flies.
    model : WingModel
        The true wing, hidden effects included.
    truth : FlightTruth
        Some two seconds longer than the flight.
    backends : mapping
        IMUs inside the autopilot, for stations whose source is component 1.
    nodes : mapping
        Streams of the wing nodes.
    world : Conditions
        What it flies in.
    """

    airframe: Airframe
    real: TruthAirframe
    model: WingModel
    truth: FlightTruth
    plan: FlightPlan
    seed: int
    backends: Mapping[Station, BackendImu]
    nodes: Mapping[Station, SensorStream]
    world: Conditions = IDEAL

    @property
    def duration_s(self) -> float:
        """Length that was asked for."""
        return self.plan.duration_s

    def generator(self, purpose: str) -> np.random.Generator:
        """A generator of its own for each purpose, so that one more draw in one place changes nothing elsewhere."""
        return np.random.default_rng([self.seed, *purpose.encode()])

    def throttle(self, t_s: Floats) -> Floats:
        """Share of full throttle at instants (n,); a world without propulsion leaves it where cruise has it."""
        if self.world.propulsion is None:
            return np.full(len(t_s), CRUISE_THROTTLE)
        return throttle(self.truth, t_s)

    def navigation_error(self) -> NavigationError:
        """Error of velocity over ground and attitude that the autopilot tells."""
        return NavigationError(self.world, self.duration_s, self.generator("navigation"))

    def heat_turn(self) -> HeatTurn:
        """Slow turn of the cameras against their wing sections."""
        return HeatTurn(self.world, self.duration_s, self.generator("heat"))

    def streams(self) -> dict[Station, SensorStream]:
        """Stream of every sensor at the rates that the airframe states."""
        sensors = dict(self.nodes)
        for station, imu in self.backends.items():
            sensor = imu.sensor
            interval_ms = max(int(1000.0 / sensor.rate_hz), 1)
            filters = (sensor.lowpass_accel_hz, sensor.lowpass_gyro_hz)
            rng = self.generator(f"sends {station}")
            sensors[station] = autopilot_stream(imu, interval_ms, LOOP_HZ, filters, self.duration_s, rng)
        return dict(sorted(sensors.items()))


def build_flight(
    airframe: Airframe,
    seed: int,
    duration_s: float = 60.0,
    *,
    plan: FlightPlan | None = None,
    effects: tuple[NamedEffect, ...] = (),
    gust: GustKind = GustKind.AIRFRAME,
    perturbed: bool = True,
    world: Conditions = IDEAL,
) -> Flight:
    """Fly an airframe: the truth is drawn from the priors of this belief, and the seed determines everything.

    Without a ``plan`` the demo's is flown, for ``duration_s``. ``effects`` are hidden in the truth, unknown to the
    belief. Without ``perturbed`` the belief is taken as truth (noise and bias stay): for tests that need it. ``world``
    has vibration, sensors, lenses and weather, drawn by a generator of their own; ``gust``, the spectrum of the load,
    overrides the weather's where it is another than the airframe's.
    """
    weather_rng, wear_rng, shake_rng = (np.random.default_rng([seed, *purpose]) for purpose in _WORLD_PURPOSES)
    plan = gusty(plan or demo_plan(duration_s), world.weather, weather_rng)
    if gust is GustKind.AIRFRAME:
        gust = gust_kind(world.weather, weather_rng)
    rng = np.random.default_rng(seed)
    real = draw_truth(airframe, rng, effects) if perturbed else exact_truth(airframe, effects)
    real = worn(real, world, wear_rng)
    model = WingModel.from_airframe(real.actual)
    truth = _fly(real, model, plan, gust, rng)
    disturbed = disturbances(world, truth, shake_rng)
    sensors = [
        RealSensor(truth, model, station, real.actual.sensor(station), real.errors[station], disturbed.get(station))
        for station in Station
    ]
    backends, nodes = _sampled(sensors, real, plan.duration_s, seed)
    return Flight(airframe, real, model, truth, plan, seed, backends, nodes, world)


def undisturbed(flight: Flight) -> Flight:
    """The same aircraft on the same path with no vibration or warm-up, its belief told the sensors' true noise."""
    actual, belief = flight.real.actual, flight.airframe
    sensors = [
        RealSensor(flight.truth, flight.model, station, actual.sensor(station), flight.real.errors[station])
        for station in Station
    ]
    backends, nodes = _sampled(sensors, flight.real, flight.duration_s, flight.seed)
    airframe = belief.with_sensors(lambda station, sensor: _as_noisy(sensor, actual.sensor(station)))
    return dataclasses.replace(flight, airframe=airframe, backends=backends, nodes=nodes)


def _as_noisy(belief: Sensor, actual: Sensor) -> Sensor:
    return dataclasses.replace(
        belief, accel_noise_mps2_rthz=actual.accel_noise_mps2_rthz, gyro_noise_radps_rthz=actual.gyro_noise_radps_rthz
    )


def _fly(
    real: TruthAirframe, model: WingModel, plan: FlightPlan, gust: GustKind, rng: np.random.Generator
) -> FlightTruth:
    """Motion of the rigid aircraft by the plan, with the wing bending in its load factor and the gust."""
    knots, derivatives = fly(plan, rng, round((plan.duration_s + _TAIL_S) * 1000) + 1)
    shape = TipShape.from_model(model)
    further = ((0, 0), (0, model.structure.slot_count - len(SLOT_NAMES)))
    knots, derivatives = np.pad(knots, further), np.pad(derivatives, further)
    rigid = FlightTruth(knots, derivatives, shape)
    load_factor = rigid.series(rigid.t_boot_ns).load_factor
    q, qdot = _bend(real, model, plan, gust, load_factor, rng)
    knots[:, MODAL], derivatives[:, MODAL] = model.all_slots(q), model.all_slots(qdot)
    return FlightTruth(knots, derivatives, shape)


def _sampled(
    sensors: Sequence[RealSensor], real: TruthAirframe, duration_s: float, seed: int
) -> tuple[dict[Station, BackendImu], dict[Station, SensorStream]]:
    """Samples of the autopilot's own sensors, and of those that nodes send on clocks of their own."""
    backends: dict[Station, BackendImu] = {}
    nodes: dict[Station, SensorStream] = {}
    for sensor in sensors:
        draws = np.random.default_rng([seed, 1, sensor.station])
        clock = sensor.sensor.source.clock
        if clock is ClockName.BOOT:
            backends[sensor.station] = backend_imu(sensor, draws)
        else:
            nodes[sensor.station] = node_stream(sensor, real.clocks[clock], duration_s, draws)
    return backends, nodes


def _bend(
    real: TruthAirframe,
    model: WingModel,
    plan: FlightPlan,
    kind: GustKind,
    load_factor: Floats,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Modal coordinates and rates at the knots, after a burn-in that makes the start stationary."""
    burn = round(_BURN_IN_S / SUBSTEP_S)
    steps = burn + 2 * (len(load_factor) - 1)
    load = np.zeros((steps, model.count))
    if kind is not GustKind.CALM:
        load = _gust_load(real, model, plan, kind, steps, rng)
    t_s = (np.arange(steps) - burn) * np.float64(SUBSTEP_S)
    for effect in model.effects:
        load = effect.forcing(t_s, load, rng)
    middle_s = t_s[burn:] + 0.5 * SUBSTEP_S
    blow_mps2 = jolted(plan, middle_s)[2]
    for column, slot in enumerate(model.structure.slots):
        load[burn:, column] -= _PARTICIPATION.get(slot, 0.0) * blow_mps2
    middles = np.arange(steps - burn) / 2 + 0.25
    flown = np.interp(middles, np.arange(len(load_factor)), load_factor) - blow_mps2 / GRAVITY_MPS2  # lift alone bends
    if plan.rolls_on_ground:
        lifted = lift_share(plan, middle_s)
        flown *= lifted
        load[burn:] *= lifted[:, None]
    factor = np.concatenate([np.full(burn, flown[0]), flown])
    q, qdot = integrate(model, load, factor, -_BURN_IN_S)
    return q[burn::2], qdot[burn::2]


def _gust_load(
    real: TruthAirframe, model: WingModel, plan: FlightPlan, kind: GustKind, steps: int, rng: np.random.Generator
) -> Floats:
    """Load (m, n) in m/s^2: one gust for all symmetric modes and one for all antisymmetric ones, as in nature."""
    wing = real.actual.wing
    load = np.zeros((steps, model.count))
    for parity, (mode, rms) in enumerate(
        ((wing.symmetric, wing.gust.deflection_rms_m.value), (wing.antisymmetric, real.antisymmetric_rms_m))
    ):
        spectrum = _spectrum(real, plan, kind, parity)
        scale = rms / modal_rms(spectrum, mode.frequency_hz.value, mode.damping.value)
        path = scale * spectrum.draw(rng, steps, SUBSTEP_S)
        for column, slot in enumerate(model.structure.slots):
            if slot % 2 == parity:
                load[:, column] = path
    return load


def _spectrum(real: TruthAirframe, plan: FlightPlan, kind: GustKind, parity: int) -> LoadSpectrum:
    if kind is GustKind.WHITE:
        return white_spectrum()
    if kind is GustKind.DRYDEN:
        scales = DrydenScales.low_altitude(_DRYDEN_ALTITUDE_M, _DRYDEN_WIND_MPS)
        span_m = 2 * real.actual.wing.semispan_m
        return dryden_roll(scales, plan.airspeed_mps, span_m) if parity else dryden_vertical(scales, plan.airspeed_mps)
    return pole_spectrum(real.actual.wing.gust.corners_hz)

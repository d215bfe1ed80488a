"""The laboratory: an aircraft that hangs still before a target while its wing is driven, as a :class:`Flight`.

Same truth, sensors, clocks and faults as the flights of the demo; only path and load are prescribed here.
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from companion.core.wing.model import WingModel
from companion.params.airframe import Airframe
from companion.records import Floats, Station
from companion.sim.flight.aircraft import FlightPlan
from companion.sim.flight.flight import Flight
from companion.sim.flight.gust import modal_rms, white_spectrum
from companion.sim.flight.perturb import TrueClock, TruthAirframe, draw_truth
from companion.sim.flight.sensors import RealSensor, SensorStream, node_stream
from companion.sim.flight.truth import COLUMNS, MODAL, POSITION, VELOCITY, FlightTruth, TipShape
from companion.sim.flight.wing import SUBSTEP_S, integrate
from companion.sim.vision.scene import Plane, Scene, board, ground
from companion.units import GRAVITY_MPS2

_BURN_IN_S = 8.0  # chosen: many decay times of the driven modes
_TAIL_S = 2.0  # chosen: longer than averaging and exposures reach behind the end
_NOISE_FROM_HZ = 5.0  # chosen: below it a shaker would travel too far
_NOISE_TO_HZ = 200.0  # convention: the paper's band of the random drive


class Drive(enum.StrEnum):
    """Motion that drives the wing."""

    STILL = "at rest"
    SHAKER_SINE = "shaker, sine near the first mode"
    SHAKER_NOISE = "shaker, random 0-200 Hz"
    SINE = "sine on the first symmetric mode"
    NOISE = "random load on all modes"
    ANTISYMMETRIC = "random load on the antisymmetric mode alone"


@dataclass(frozen=True, slots=True)
class Setup:
    """One experiment's set-up.

    ``amplitude_m`` is that of the first mode's deflection under a sine, and rms under noise.
    """

    airframe: Airframe
    drive: Drive
    amplitude_m: float
    distance_m: float
    seed: int
    duration_s: float = 16.0


_Path = Callable[[Floats], Floats]
"""Height above the rest place and its two derivatives, upward, (3, n), as a function of instants (n,), s."""


def still_plan(duration_s: float) -> FlightPlan:
    """Path that the records show: no speed, no wobble."""
    return FlightPlan(duration_s, 0.0, 0.0, (), (), (), 0.0, 0.0, 0.0, 0.0)


def laboratory_flight(setup: Setup) -> Flight:
    """Make the experiment happen: truth drawn from the airframe's priors, drive, sensors."""
    rng = np.random.default_rng([setup.seed, 0xBE])
    real = draw_truth(setup.airframe, rng)
    model = WingModel.from_airframe(real.actual)
    path = _shaken(setup, model, rng)
    steps = round((setup.duration_s + _TAIL_S) * 1000)
    knots, derivatives = _rigid(setup, path, steps)
    q, qdot = _bend(setup, model, path, steps, rng)
    knots[:, MODAL], derivatives[:, MODAL] = model.all_slots(q), model.all_slots(qdot)
    truth = FlightTruth(knots, derivatives, TipShape.from_model(model))
    nodes = {station: _stream(truth, model, real, setup, station) for station in Station}
    plan = still_plan(setup.duration_s)
    return Flight(setup.airframe, real, model, truth, plan, setup.seed, {}, nodes)


def target_scene(setup: Setup) -> Scene:
    """A flat textured target across the sight, at the distance from the cameras."""
    if setup.airframe.looks_down:
        return Scene((ground(),), setup.seed)
    wall: Plane = board(np.array([setup.distance_m, 0.0, -_height(setup)]), 0.0, (400.0, 400.0), 1)
    return Scene((wall,), setup.seed, sight_m=1000.0)


def _height(setup: Setup) -> float:
    """Body origin above NED zero; the cameras of the laboratory airframes sit at the body's origin height."""
    return setup.distance_m if setup.airframe.looks_down else 60.0


# ------------------------------------------------------------------------------------------------ drive


def _shaken(setup: Setup, model: WingModel, rng: np.random.Generator) -> _Path:
    """Rows height, speed, acceleration of the clamp, upward, (3, n), at any instants."""
    if setup.drive is Drive.SHAKER_SINE:
        return _sine_path(setup, model)
    if setup.drive is Drive.SHAKER_NOISE:
        return _noise_path(setup, model, rng)
    return lambda t_s: np.zeros((3, len(t_s)))


def _sine_path(setup: Setup, model: WingModel) -> _Path:
    """At the believed frequency, which is not quite the real one; as strong as the wanted deflection needs."""
    omega = 2 * np.pi * setup.airframe.wing.symmetric.frequency_hz.value
    mode_radps, zeta = float(model.omega_radps[0]), float(model.zeta[0])
    gain = abs(1.0 / complex(mode_radps**2 - omega**2, 2 * zeta * mode_radps * omega))
    per_mps2 = abs(float(model.structure.static_per_g_m[0])) / GRAVITY_MPS2 * mode_radps**2 * gain
    accel = setup.amplitude_m / per_mps2

    def path(t_s: Floats) -> Floats:
        sine, cosine = np.sin(omega * t_s), np.cos(omega * t_s)
        return accel * np.stack([-sine / omega**2, -cosine / omega, sine])

    return path


def _noise_path(setup: Setup, model: WingModel, rng: np.random.Generator) -> _Path:
    """Band noise as a sum of many sines, so that height and speed follow exactly."""
    hertz = np.arange(_NOISE_FROM_HZ, _NOISE_TO_HZ, 0.25) + rng.uniform(-0.1, 0.1, int(4 * (_NOISE_TO_HZ - 5.0)))
    omega, phase = 2 * np.pi * hertz, rng.uniform(0, 2 * np.pi, len(hertz))
    mode_radps, zeta = float(model.omega_radps[0]), float(model.zeta[0])
    gain = np.abs(1.0 / (mode_radps**2 - omega**2 + 2j * zeta * mode_radps * omega))
    per_mps2 = abs(float(model.structure.static_per_g_m[0])) / GRAVITY_MPS2 * mode_radps**2
    accel = setup.amplitude_m / (per_mps2 * float(np.sqrt(np.sum(gain**2) / 2)))

    def path(t_s: Floats) -> Floats:
        rows = np.zeros((3, len(t_s)))
        for w, p in zip(omega.tolist(), phase.tolist(), strict=True):
            wave = np.exp(1j * (w * t_s + p))
            rows += accel * np.stack([-wave.imag / w**2, -wave.real / w, wave.imag])
        return rows

    return path


def _load(setup: Setup, model: WingModel, t_s: Floats, rng: np.random.Generator) -> Floats:
    """Load on the modes (m, n) over the half-millisecond steps that begin at ``t_s``."""
    load = np.zeros((len(t_s), model.count))
    wing = setup.airframe.wing
    if setup.drive is Drive.SINE:
        omega = float(model.omega_radps[0])
        load[:, 0] = 2 * float(model.zeta[0]) * omega**2 * setup.amplitude_m * np.cos(omega * t_s)
    elif setup.drive in (Drive.NOISE, Drive.ANTISYMMETRIC):
        white = white_spectrum()
        for parity in (0, 1):
            if setup.drive is Drive.ANTISYMMETRIC and parity == 0:
                continue
            mode = (wing.symmetric, wing.antisymmetric)[parity]
            unit = modal_rms(white, mode.frequency_hz.value, mode.damping.value)
            path = setup.amplitude_m / unit * white.draw(rng, len(t_s), SUBSTEP_S)
            for column, slot in enumerate(model.structure.slots):
                if slot % 2 == parity:
                    load[:, column] = path
    return load


def _rigid(setup: Setup, path: _Path, steps: int) -> tuple[Floats, Floats]:
    t_s: Floats = np.arange(steps + 1) * np.float64(1e-3)
    height, speed, accel = path(t_s)
    knots, derivatives = np.zeros((steps + 1, COLUMNS)), np.zeros((steps + 1, COLUMNS))
    knots[:, POSITION.stop - 1] = -_height(setup) - height
    knots[:, VELOCITY.stop - 1] = derivatives[:, POSITION.stop - 1] = -speed
    derivatives[:, VELOCITY.stop - 1] = -accel
    return knots, derivatives


def _bend(setup: Setup, model: WingModel, path: _Path, steps: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    burn = round(_BURN_IN_S / SUBSTEP_S)
    t_s = (np.arange(burn + 2 * steps) - burn) * np.float64(SUBSTEP_S)
    factor = 1.0 + path(t_s + np.float64(SUBSTEP_S / 2))[2] / GRAVITY_MPS2
    q, qdot = integrate(model, _load(setup, model, t_s, rng), factor, -_BURN_IN_S)
    return q[burn::2], qdot[burn::2]


def _stream(truth: FlightTruth, model: WingModel, real: TruthAirframe, setup: Setup, station: Station) -> SensorStream:
    """All three accelerometers hang on a laboratory's recorder: averaged samples, no autopilot's loop in between.

    (An autopilot sends its newest sample at each turn of its loop; a shaker's 200 Hz would fold into the mode.)
    """
    sensor = RealSensor(truth, model, station, real.actual.sensor(station), real.errors[station])
    clock = real.clocks.get(sensor.sensor.source.clock, TrueClock(0, 0.0))
    return node_stream(sensor, clock, setup.duration_s, np.random.default_rng([setup.seed, 1, station]))


def at_rest(setup: Setup, distance_m: float) -> Setup:
    """The same aircraft at rest before a target elsewhere, for calibration: the same truth is drawn."""
    return dataclasses.replace(setup, drive=Drive.STILL, amplitude_m=0.0, distance_m=distance_m, duration_s=2.0)

"""The aircraft's own turning leaves nothing in what diagnosis takes for bending, and wrong scales what they must."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import pytest

from companion.core.wing.model import WingModel
from companion.core.wing.sensing import ModalPath, RigidMotion, sense_station
from companion.diagnosis.data.observations import Observations, RawRecording, RawStream
from companion.diagnosis.data.resampling import observe
from companion.diagnosis.data.rigid_motion import bending_load, roll_share
from companion.diagnosis.model.flight_model import FlightModel
from companion.evaluation.flight_models import belief_for, top_of
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import load_airframe
from companion.records import Floats, Side

GRAVITY = 9.80665
RATE_HZ = 1000.0
T_S = np.arange(0.0, 30.0, 1.0 / RATE_HZ)
INSIDE = slice(2000, -2000)


@pytest.fixture(scope="module")
def airframe() -> Airframe:
    """One that load does not bend."""
    loaded = load_airframe("nadir-2m")
    assert loaded.root.lowpass_gyro_hz > 0.0, "the test wants gyros that are filtered"
    stiff = dataclasses.replace(loaded.wing, bend_per_g_m=Uncertain(0.0, 0.0))
    return dataclasses.replace(loaded, wing=stiff)


@dataclasses.dataclass(frozen=True)
class Wave:
    """A sum of sines: (amplitude, Hz, phase)."""

    parts: tuple[tuple[float, float, float], ...]

    def seen_through(self, corner_hz: float) -> Floats:
        """Steady response of a second-order Butterworth low-pass."""
        total = np.zeros(len(T_S))
        for amplitude, f_hz, phase in self.parts:
            gain = 1.0 / (1.0 + math.sqrt(2.0) * 1j * f_hz / corner_hz - (f_hz / corner_hz) ** 2)
            total += amplitude * np.imag(gain * np.exp(1j * (2.0 * math.pi * f_hz * T_S + phase)))
        return total

    def value(self) -> Floats:
        return self._sum(lambda a, w, p: a * np.sin(w * T_S + p))

    def rate(self) -> Floats:
        return self._sum(lambda a, w, p: a * w * np.cos(w * T_S + p))

    def second(self) -> Floats:
        return self._sum(lambda a, w, p: -a * w**2 * np.sin(w * T_S + p))

    def _sum(self, of: Callable[[float, float, float], Floats]) -> Floats:
        return np.sum([of(a, 2.0 * math.pi * f_hz, p) for a, f_hz, p in self.parts], axis=0)


P = Wave(((0.8, 0.37, 0.2), (0.5, 1.4, 1.0)))
Q = Wave(((0.3, 0.21, 0.5), (0.1, 1.1, 0.1)))
R = Wave(((0.25, 0.3, 1.5),))
GUST = ((0.005, 4.7, 0.0), (0.005, 5.05, 1.0), (0.004, 5.6, 2.0))
"""Deflections (m, Hz, rad) whose envelope swings with 0.35, 0.55 and 0.9 Hz."""
HEAVE = Wave(((3.0, 0.4, 0.3), (1.0, 1.2, 2.0)))


def recorded(
    airframe: Airframe, heave_scale: float = 0.0, tip_scale: float = 0.0, late_s: tuple[float, float] = (0.0, 0.0)
) -> Observations:
    """A rigid aircraft in manoeuvres; its root's rates and forces come filtered."""
    root, z = airframe.root, HEAVE.value() - GRAVITY
    p, q, r = P.value(), Q.value(), R.value()
    tips = {}
    for side, sensor in ((Side.LEFT, airframe.left), (Side.RIGHT, airframe.right)):
        x, y, down = np.subtract(sensor.position_m, root.position_m)
        omega, turn = np.stack([p, q, r], 1), np.stack([P.rate(), Q.rate(), R.rate()], 1)
        arm = np.broadcast_to([x, y, down], omega.shape)
        felt = z + (np.cross(turn, arm) + np.cross(omega, np.cross(omega, arm)))[:, 2]
        felt = np.interp(T_S - late_s[side], T_S, felt)
        tips[side] = RawStream(T_S, (1.0 + (tip_scale if side is Side.LEFT else 0.0)) * felt)
    shown = (1.0 + heave_scale) * (HEAVE.seen_through(root.lowpass_accel_hz) - GRAVITY)
    rates = {
        letter: (T_S, wave.seen_through(root.lowpass_gyro_hz)) for letter, wave in zip("pqr", (P, Q, R), strict=True)
    }
    raw = RawRecording(tips, RawStream(T_S, shown), None, {}, rates)
    return observe(raw, airframe, top_of(airframe))[0]


def within(observations: Observations, values: Floats) -> Floats:
    ratio = observations.rate_hz / RATE_HZ
    return values[round(INSIDE.start * ratio) : round(INSIDE.stop * ratio)]


def test_a_rigid_aircraft_that_rolls_and_pulls_does_not_bend(airframe: Airframe) -> None:
    observations = recorded(airframe)
    assert observations.turning_mps2 is not None
    assert within(observations, observations.turning_mps2).std(0).min() > 2.0, "there is much to take out"
    assert np.abs(within(observations, observations.up_mps2 - observations.up_mps2.mean(0))).max() < 0.02


def test_wrong_scales_leave_what_their_nuisances_take_out(airframe: Airframe) -> None:
    observations = recorded(airframe, heave_scale=0.01, tip_scale=-0.006)
    assert within(observations, observations.up_mps2).std(0)[0] > 0.03
    model = FlightModel(belief_for(airframe, [[observations]]), observations, top_of(airframe))
    keys = [entry.key for entry in model.belief.nuisances]
    deviations = np.zeros(len(keys))
    deviations[keys.index("root.scale")] = 0.01
    deviations[keys.index("left.scale")] = -0.006
    before, after = model.expect(np.zeros(len(keys))), model.expect(deviations)
    power = [float(np.sum(np.abs(expectation.residual) ** 2)) for expectation in (before, after)]
    assert power[1] < 0.01 * power[0]
    assert np.abs(after.rest_residual).max() < 0.01 < np.abs(before.rest_residual).max()


def test_a_window_keeps_its_share_of_the_turning(airframe: Airframe) -> None:
    observations = recorded(airframe)
    window = observations.window(10.0, 20.0)
    assert window.turning_mps2 is not None
    assert observations.turning_mps2 is not None
    first = round(10.0 * observations.rate_hz)
    np.testing.assert_array_equal(window.turning_mps2, observations.turning_mps2[first : first + len(window.up_mps2)])


def test_a_roll_in_a_climb_bends_no_wing_that_the_gust_shakes() -> None:
    airframe = load_airframe("nadir-2m")
    model, wave = WingModel.from_airframe(airframe), Wave(GUST)
    q_m = np.zeros((len(T_S), model.count))
    qdot_mps, qddot_mps2 = q_m.copy(), q_m.copy()
    q_m[:, 0], qdot_mps[:, 0], qddot_mps2[:, 0] = wave.value(), wave.rate(), wave.second()
    q_m[:, 0] += airframe.wing.trim_bend_m.value
    bank = Wave(((0.2, 0.25, 0.0),))
    rates = np.stack([bank.rate(), 0.0 * T_S, 0.0 * T_S], axis=1)
    turns = np.stack([bank.second(), 0.0 * T_S, 0.0 * T_S], axis=1)
    force = np.stack([0.0 * T_S, Wave(((2.4, 0.25, 0.4),)).value(), Wave(((0.5, 0.1, 0.0),)).value() - GRAVITY], axis=1)
    motion, path = RigidMotion(force, rates, turns), ModalPath(q_m, qdot_mps, qddot_mps2)
    tips = {}
    for side, sensor in ((Side.LEFT, airframe.left), (Side.RIGHT, airframe.right)):
        shown = sense_station(model, side, np.array(sensor.position_m), motion, path)
        tips[side] = RawStream(T_S, shown[:, 2], shown[:, 1])
    assert np.mean(np.abs(tips[Side.LEFT].force_z_mps2) < 3.0) > 0.05, (
        "the test wants tips that are weightless at times"
    )
    rigid = {"y": (T_S, force[:, 1]), "p": (T_S, rates[:, 0])}
    raw = RawRecording(tips, RawStream(T_S, force[:, 2]), None, {}, rigid)
    unfiltered = dataclasses.replace(airframe.root, lowpass_accel_hz=0.0, lowpass_gyro_hz=0.0)
    observations = observe(raw, dataclasses.replace(airframe, root=unfiltered), top_of(airframe))[0]
    felt = observations.up_mps2.mean(1) - np.interp(observations.t_s, T_S, qddot_mps2[:, 0])
    f_hz = np.fft.rfftfreq(len(felt), 1.0 / observations.rate_hz)
    spectrum = np.fft.rfft(felt * np.hanning(len(felt)))
    spectrum[(f_hz < 0.75) | (f_hz > 2.5)] = 0.0  # where a slow error of the acceleration is a large deflection
    assert np.fft.irfft(spectrum, len(felt)).std() < 5e-4


@pytest.mark.parametrize("key", ["left.delay_s", "right.delay_s"])
def test_a_late_tip_is_late_with_the_rigid_motion_too(airframe: Airframe, key: str) -> None:
    late_s = {"left.delay_s": (0.01, 0.0), "right.delay_s": (0.0, 0.01)}[key]
    observations = recorded(airframe, late_s=late_s)
    model = FlightModel(belief_for(airframe, [[observations]]), observations, top_of(airframe))
    keys = [entry.key for entry in model.belief.nuisances]
    deviations = np.zeros(len(keys))
    deviations[keys.index(key)] = 0.01
    before, after = model.expect(np.zeros(len(keys))), model.expect(deviations)
    power = [float(np.sum(np.abs(expectation.residual) ** 2)) for expectation in (before, after)]
    assert power[1] < 0.01 * power[0]


def test_what_the_fuselage_recoils_is_no_load_on_the_wing() -> None:
    """A pull-up of 0.5 Hz stays as it is; a recoil at the first mode is gone."""
    slow, ringing = np.sin(2.0 * math.pi * 0.5 * T_S), np.sin(2.0 * math.pi * 5.0 * T_S)
    left = bending_load(1.0 + 0.3 * slow + 0.1 * ringing, RATE_HZ, 5.0)
    assert left[INSIDE] == pytest.approx(1.0 + 0.3 * slow[INSIDE], abs=0.01)


def rolling(recoil: float, other: float, noise_radps: float = 1e-3) -> tuple[Floats, Floats]:
    """Gyro's roll (m,) and the tips' specific force (m, 2).

    Bending up to 30 Hz, of which the gyro shows ``recoil`` (1/m), and an antisymmetric motion of the size ``other``
    that turns no fuselage.
    """
    rng = np.random.default_rng(8)
    spectrum = np.fft.rfft(rng.standard_normal((2, len(T_S))), axis=1)
    spectrum[:, np.fft.rfftfreq(len(T_S), 1.0 / RATE_HZ) > 30.0] = 0.0
    bent, still = np.fft.irfft(spectrum, len(T_S), axis=1)
    rate = noise_radps * rng.standard_normal(len(T_S)) + recoil * np.cumsum(bent) / RATE_HZ
    tips = bent + other * still
    return rate, np.stack([-tips, tips], 1)


def share_of(airframe: Airframe, rate: Floats, tips: Floats) -> Callable[[float, float], Floats]:
    """Share of the gyro's roll that is taken out between two frequencies."""
    bare = dataclasses.replace(airframe, root=dataclasses.replace(airframe.root, lowpass_gyro_hz=0.0))
    ratio, f_hz = roll_share({"p": (T_S, rate)}, T_S, RATE_HZ, bare, tips), np.fft.rfftfreq(len(T_S), 1.0 / RATE_HZ)
    return lambda low_hz, top_hz: np.asarray(ratio[(f_hz > low_hz) & (f_hz < top_hz)])


@pytest.mark.parametrize("other", [0.0, 3.0])
def test_a_roll_above_the_gyros_noise_is_taken_out_whole(airframe: Airframe, other: float) -> None:
    """Antisymmetric bending up to 30 Hz rolls a light fuselage, whatever else the tips show there."""
    roll_ratio = share_of(airframe, *rolling(1.0, other))
    assert np.all(roll_ratio(0.0, 28.0) > 0.9)
    assert np.all(roll_ratio(35.0, 400.0) < 0.5)
    assert np.mean(roll_ratio(35.0, 400.0)) < 0.15


def test_of_a_fuselage_that_no_wing_rolls_only_manoeuvres_are_taken_out(airframe: Airframe) -> None:
    roll_ratio = share_of(airframe, *rolling(0.0, 1.0))
    assert np.all(roll_ratio(0.0, 6.0) == 1.0)
    assert np.mean(roll_ratio(16.0, 400.0)) < 0.15


def test_a_gyro_that_shakes_on_its_mount_shakes_no_tip(airframe: Airframe) -> None:
    shake = 2.0 * math.pi * 22.0
    rate, tips = rolling(0.0, 1.0)
    rate += np.random.default_rng(9).standard_normal(len(T_S)) * 0.1 * np.sin(shake * T_S)
    assert np.mean(share_of(airframe, rate, tips)(18.0, 30.0)) < 0.15

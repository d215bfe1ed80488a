"""Closed forms of the catalogue's later effects, and what is seen in samples without a model."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.wing.effect import CameraView, Effect, ModalMotion
from companion.core.wing.effects import catalogue
from companion.core.wing.model import WingModel
from companion.core.wing.structure import structure_of
from companion.diagnosis.data.grid import fast_length
from companion.diagnosis.data.observations import Observations
from companion.diagnosis.data.sample_defects import find_sample_defects, interpolate_clipped
from companion.diagnosis.data.transforms import Transforms
from companion.diagnosis.model.effect_term import EffectTerm
from companion.diagnosis.model.nonlinear_correction import SensorLineariser
from companion.params.files import load_airframe
from companion.records import Floats, Side, Station
from companion.sim.flight.wing import WingStepper

AIRFRAME = load_airframe("nadir-2m")
T_S = np.arange(8000) / 1000.0


def made(name: str, **values: float) -> Effect:
    return catalogue()[name].from_values(values)


def sensed(effect: Effect, station: Station, z: Floats, **columns: Floats) -> Floats:
    values = np.zeros((len(z), 6))
    values[:, 2] = z
    for letter, column in columns.items():
        values[:, "xyzpqr".index(letter)] = column
    return effect.sense(station, T_S[: len(z)], values)[:, 2]


def moving(model: WingModel, q: Floats, qdot: Floats, covariate: Floats | float = 0.0) -> ModalMotion:
    whole_q, whole_qdot = np.zeros((model.count, len(q))), np.zeros((model.count, len(q)))
    whole_q[0], whole_qdot[0] = q, qdot
    return ModalMotion(T_S[: len(q)], whole_q, whole_qdot, np.zeros((model.count, 1)), 1.0, model.structure, covariate)


@pytest.fixture(scope="module")
def model() -> WingModel:
    return WingModel(AIRFRAME.wing)


def test_the_whole_catalogue_of_the_plan_is_there() -> None:
    wanted = """frequency-shift frequency-drift damping-shift coulomb-friction quadratic-damping cubic-stiffness
    quadratic-stiffness freeplay hysteresis second-mode close-mode torsion-coupling left-right-frequency
    left-right-damping left-right-forcing parametric-stiffness airspeed-dependence load-dependent-bend
    covariate-frequency accel-scale accel-bias accel-misalignment accel-cubic gravity-tilt stream-delay
    clock-skew sensor-filter saturation quantisation dropout-jitter tone rigid-body-leak exposure-delay
    exposure-jitter rolling-shutter baseline-error focal-error convergence-offset camera-asymmetry mount-lag
    mount-resonance coloured-gust periodic-forcing impulsive-forcing"""
    assert set(wanted.split()) <= set(catalogue())


def test_a_slipping_spring_loses_what_its_loop_encloses(model: WingModel) -> None:
    """Amplitude A beyond all yields y: each spring's loop encloses 4 k y (A - y) per cycle (Jenkins)."""
    amplitude, reach, slip_ratio = 0.006, 0.002, 0.1
    omega = 2 * np.pi * 2.0
    q, qdot = amplitude * np.sin(omega * T_S), amplitude * omega * np.cos(omega * T_S)
    force = made("hysteresis", share=slip_ratio, yield_m=reach).force(moving(model, q, qdot))
    assert force is not None
    steady = slice(500, 7500)  # fourteen whole cycles
    lost = -np.mean(force[0, steady] * qdot[steady]) / 2.0
    stiffness = model.structure.stiffness_radps2[0, 0]
    yields = reach * np.array([0.2, 0.6, 1.0, 1.4, 1.8])
    assert lost == pytest.approx(np.mean(4 * slip_ratio * stiffness * yields * (amplitude - yields)), rel=1e-3)


def test_slipping_springs_give_way_one_by_one(model: WingModel) -> None:
    """Pushed from rest: between the first yield and the second one spring of five holds still, beyond the last all."""
    w = np.linspace(0.0, 0.006, 601)
    force = made("hysteresis", share=0.1, yield_m=0.003).force(moving(model, w, 0 * w))
    assert force is not None
    slope = np.diff(force[0]) / np.diff(w) / (0.1 * model.structure.stiffness_radps2[0, 0])
    assert slope[::120] == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8], abs=1e-9)
    assert slope[-1] == pytest.approx(1.0)


def test_a_further_mode_is_one_where_its_band_is_clear_of_those_that_are_there(model: WingModel) -> None:
    for place in (place for place, slot in enumerate(model.structure.slots) if slot % 2 == 0):
        own_hz = float(model.omega_radps[place]) / (2 * np.pi)
        half_widths_hz = float(model.structure.damping_radps[place, place]) / (4 * np.pi) + 0.01 * own_hz
        for apart, distinct in ((0.0, False), (0.9, False), (-0.9, False), (1.1, True), (-1.1, True)):
            frequency_hz = own_hz + apart * half_widths_hz
            mode = made("second-mode", participation=0.01, frequency_hz=frequency_hz, damping=0.01)
            assert mode.is_distinct(model.structure) is distinct


def test_a_slipping_spring_remembers_in_the_simulator(model: WingModel) -> None:
    """Pulled beyond the yield and brought back to rest by hand, the spring stays stretched the other way."""
    slipping = WingModel(AIRFRAME.wing, (made("hysteresis", share=0.2, yield_m=0.001),))
    stepper, q = WingStepper(slipping), np.zeros(model.count)
    static = slipping.q_static(1.0)
    memories = None
    for offset in (0.0, 0.004, 0.0):
        q[0] = offset
        memories = slipping.remembered(0.0, static + q, 0.0 * q, 1.0, memories)
    still = slipping.acceleration(0.0, static, 0.0 * q, 0.0 * q, 1.0, memories)
    stiffness = slipping.structure.stiffness_radps2[0, 0]
    assert still[0] == pytest.approx(0.2 * stiffness * 0.001, rel=1e-9)
    assert stepper.model is slipping


def test_two_coupled_modes_have_the_frequencies_of_their_quadratic(model: WingModel) -> None:
    grown = WingModel(AIRFRAME.wing, (made("torsion-coupling", coupling=0.04, frequency_hz=18.0, damping=0.02),))
    first, torsion = model.omega_radps[0] ** 2, (2 * np.pi * 18.0) ** 2
    both = np.roots([1.0, -(first + torsion), first * torsion * (1.0 - 0.04)])
    pair = grown.structure.stiffness_radps2[np.ix_([0, -1], [0, -1])]
    assert np.sort(np.linalg.eigvalsh(pair)) == pytest.approx(np.sort(both.real))
    assert grown.structure.slope_radpm[:, -1] == pytest.approx([0.0, 0.0])


def test_stiffness_swings_as_mathieus_does(model: WingModel) -> None:
    q = 0.003 * np.sin(2 * np.pi * 5.0 * T_S)
    force = made("parametric-stiffness", cosine=0.1, sine=0.0, frequency_hz=3.0).force(moving(model, q, 0 * q))
    assert force is not None
    expected = -0.1 * np.cos(2 * np.pi * 3.0 * T_S) * model.structure.stiffness_radps2[0, 0] * q
    assert force[0] == pytest.approx(expected)


def test_airspeed_moves_spring_and_damper(model: WingModel) -> None:
    q, qdot = np.full(4, 0.002), np.full(4, 0.05)
    effect = made("airspeed-dependence", frequency_per_rms=0.02, damping_per_rms=0.5)
    force = effect.force(moving(model, q, qdot, 1.0))
    assert force is not None
    spring, damper = model.structure.stiffness_radps2[0, 0], model.structure.damping_radps[0, 0]
    assert force[0] == pytest.approx(-(1.02**2 - 1) * spring * q - 0.5 * damper * qdot)
    assert catalogue()["airspeed-dependence"].may_follow("airspeed_mps")
    assert not catalogue()["covariate-frequency"].may_follow("airspeed_mps")


def test_a_kick_changes_the_speed_by_what_it_says(model: WingModel) -> None:
    force = made("impulsive-forcing", symmetric1_mps=0.3, at1_s=2.0).force(moving(model, 0 * T_S, 0 * T_S))
    assert force is not None
    assert np.sum(force[0]) / 1000.0 == pytest.approx(0.3, rel=1e-6)


def test_a_misaligned_sensor_feels_the_side(model: WingModel) -> None:
    side = np.sin(T_S)
    effect = made("accel-misalignment", left_rad=0.02)
    assert sensed(effect, Station.LEFT, -9.8 + 0 * side, y=side) == pytest.approx(-9.8 + 0.02 * side)
    assert sensed(effect, Station.RIGHT, -9.8 + 0 * side, y=side) == pytest.approx(-9.8 + 0 * side)


def test_a_longer_arm_feels_roll_acceleration() -> None:
    rate = 0.3 * np.sin(2 * T_S)
    shown = sensed(made("rigid-body-leak", arm_m=0.1), Station.RIGHT, 0 * T_S, p=rate)
    assert shown[5:-5] == pytest.approx(0.1 * 0.6 * np.cos(2 * T_S)[5:-5], abs=1e-5)


def test_tilt_leaks_gravity_in_proportion_to_deflection() -> None:
    """w'' + leak w of a sine is (1 - leak/omega^2) times its acceleration."""
    omega = 2 * np.pi * 2.0
    up = -(omega**2) * 0.01 * np.sin(omega * T_S)
    shown = sensed(made("gravity-tilt", leak_ps2=3.0), Station.LEFT, -9.80665 - up)
    assert -9.80665 - shown == pytest.approx(up + 3.0 * 0.01 * np.sin(omega * T_S), abs=1e-9)


def test_a_ringing_mount_gains_and_a_slow_shutter_loses() -> None:
    omega = 2 * np.pi * 5.0
    ringing = CameraView(softness_s2=1.0 / (2 * np.pi * 25.0) ** 2).follows(np.array([omega]))
    assert abs(ringing[0]) == pytest.approx(1.0 / (1.0 - 0.04), rel=1e-4)
    damped = CameraView(softness_s2=1.0 / (2 * np.pi * 25.0) ** 2, damper_s=0.002).follows(np.array([omega]))
    assert np.angle(damped[0]) == pytest.approx(-np.arctan2(0.002 * omega + 2 * 0.02 * 0.04, 1.0 - 0.04), rel=1e-4)
    slow = CameraView(readout2_s2=0.02**2).follows(np.array([omega]))
    rows = np.linspace(-0.01, 0.01, 2001)
    assert slow[0].real == pytest.approx(np.mean(np.cos(omega * rows)), rel=1e-4)


@pytest.mark.parametrize("chance", ["gaussian", "even"])
def test_the_linear_part_of_a_cubic_spring_is_its_mean_slope(model: WingModel, chance: str) -> None:
    """-k kappa q^3 has the mean slope -3 k kappa var(q), however q is spread (regression says 1.8 for even)."""
    rng, m = np.random.default_rng(3), 6000
    q = np.zeros((model.count, m))
    q[0] = 0.005 * (rng.standard_normal(m) if chance == "gaussian" else rng.uniform(-(3.0**0.5), 3.0**0.5, m))
    speed = rng.permuted(q, axis=1)
    observations = Observations(100.0, (Side.LEFT,), np.zeros((m, 1)), np.zeros(1), False, np.ones(m), {}, None)
    transforms = Transforms(m, 0.01, 0.0)
    push = SensorLineariser(observations, transforms).linearise_forces(
        model, (EffectTerm(made("cubic-stiffness", kappa_per_m2=2000.0)),), q, speed
    )
    stiffness = structure_of(AIRFRAME.wing).stiffness_radps2[0, 0]
    variance = np.sum(transforms.taper**2 * q[0] ** 2) / np.sum(transforms.taper**2)
    assert push.per_q[0, 0] == pytest.approx(-3.0 * 2000.0 * stiffness * variance, rel=0.01)
    # nothing of the force is lost
    force = (push.per_q @ q + push.per_qdot @ speed + push.residual_mps2)[0]
    assert force == pytest.approx(-2000.0 * stiffness * q[0] ** 3, abs=1e-9 * np.abs(force).max())


@pytest.mark.parametrize("kappa", [3e-4, -5e-5])
def test_a_bent_characteristic_is_undone(kappa: float) -> None:
    """The first-order inverse a - kappa a^3 of a + kappa a^3 is wrong by 3 kappa^2 a^5; the samples come back."""
    rng, m = np.random.default_rng(4), 4000
    up = 10.0 * np.tanh(rng.standard_normal(m))
    up -= up.mean()
    bent = up + kappa * up**3
    observations = Observations(
        1000.0, (Side.LEFT,), (bent - bent.mean())[:, None], np.zeros(1), False, np.ones(m), {}, None
    )
    straight, scale = SensorLineariser(observations, Transforms(m, 0.001, 0.0)).corrected_mps2(
        [made("accel-cubic", kappa_s4pm2=kappa)]
    )
    assert straight[0] / scale[0] == pytest.approx(up, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("kappa", [5e-4, 2e-4, -1e-4])
def test_how_much_a_gaussian_was_bent_is_told_without_bias(kappa: float) -> None:
    """White samples of unknown size: log L = -m log(size x scale) is largest at the truth, however much is bent.

    (With the arithmetic mean of the slopes for the scale, 1 + 3 kappa s^2, it is largest at two thirds of it.)
    """
    rng, m = np.random.default_rng(6), 100_000
    up = 10.0 * rng.standard_normal(m)
    bent = up + kappa * up**3
    observations = Observations(1000.0, (Side.LEFT,), bent[:, None], np.zeros(1), False, np.ones(m), {}, None)
    lineariser = SensorLineariser(observations, Transforms(m, 0.001, 0.0))

    def log_likelihood(ratio: float) -> float:
        straight, scale = lineariser.corrected_mps2([made("accel-cubic", kappa_s4pm2=ratio * kappa)])
        return -m * float(np.log(np.std(straight[0] / scale[0])) + np.log(scale[0]))

    shares = np.linspace(0.6, 1.3, 15)
    curve = np.polynomial.Polynomial.fit(shares, [log_likelihood(ratio) for ratio in shares], 4)
    best = shares[0] + (shares[-1] - shares[0]) * np.argmax(curve(np.linspace(shares[0], shares[-1], 1001))) / 1000
    assert best == pytest.approx(1.0, abs=0.08)


def test_laws_of_a_sensor_are_undone_one_after_the_other() -> None:
    """The last of c(b(a)) is undone first: what is left of a is nothing."""
    rng, m = np.random.default_rng(7), 4000
    up = rng.uniform(-25.0, 25.0, m)
    once = up + 2e-4 * up**3
    both = once + 1e-4 * once**3
    observations = Observations(1000.0, (Side.LEFT,), both[:, None], np.zeros(1), False, np.ones(m), {}, None)
    laws = [made("accel-cubic", kappa_s4pm2=kappa) for kappa in (2e-4, 1e-4)]
    straight, scale = SensorLineariser(observations, Transforms(m, 0.001, 0.0)).corrected_mps2(laws)
    assert straight[0] / scale[0] == pytest.approx(up, abs=1e-6)


def test_samples_show_their_faults_and_nothing_else() -> None:
    rng, sensor = np.random.default_rng(1), AIRFRAME.left
    good = -9.8 + np.round(rng.standard_normal(20000), 5)
    t_s = np.arange(20000) / 1000.0 + 5e-5 * rng.standard_normal(20000)
    assert find_sample_defects(t_s, good, sensor) == []
    for limit in (11.5, 10.8):  # of the second, one sample in 38 repeats the one before, clipped like it
        assert [entry.name for entry in find_sample_defects(t_s, np.clip(good, -limit, limit), sensor)] == [
            "saturation"
        ]
    assert [entry.name for entry in find_sample_defects(t_s, np.round(good / 0.5) * 0.5, sensor)] == ["quantisation"]
    lost = rng.uniform(size=20000) < 0.02
    assert [entry.name for entry in find_sample_defects(t_s[~lost], good[~lost], sensor)] == ["dropout-jitter"]


def test_cut_peaks_are_bridged() -> None:
    uncut = 12.0 * np.sin(2 * np.pi * 5.0 * T_S)
    cut = np.clip(uncut, -11.5, 11.5)
    mended = interpolate_clipped(T_S, cut, find_sample_defects(T_S, cut, AIRFRAME.left))
    assert np.abs(mended - uncut).max() < 0.05 < np.abs(cut - uncut).max()


@pytest.mark.parametrize("count", [7, 100, 6757, 12345])
def test_fast_lengths_are_even_and_near(count: int) -> None:
    for up in (True, False):
        length = fast_length(count, up)
        assert length % 2 == 0
        assert (count <= length <= 1.35 * count) if up else (0.7 * count <= length <= count)
        for prime in (2, 3, 5):
            while length % prime == 0:
                length //= prime
        assert length == 1

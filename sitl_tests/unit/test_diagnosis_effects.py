"""The catalogue as diagnosis asks it: neutral at nothing, and each hook true to its own closed form."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import butter, freqs

from companion.core.wing.effect import Effect, ModalMotion, viewed
from companion.core.wing.effects import catalogue
from companion.core.wing.model import WingModel
from companion.params.files import load_airframe
from companion.records import Side, Station

F_HZ = np.linspace(0.5, 40.0, 80)
KINDS = list(catalogue().values())


def motion(model: WingModel, rows: int = 500) -> ModalMotion:
    t_s = np.arange(rows) / 200.0
    n = model.count
    phase = 2 * np.pi * 5.0 * t_s
    q = 0.005 * np.stack([np.sin(phase + k) for k in range(n)])
    qdot = 0.005 * 2 * np.pi * 5.0 * np.stack([np.cos(phase + k) for k in range(n)])
    return ModalMotion(t_s, q, qdot, np.zeros((n, 1)), 1.0, model.structure, np.sin(0.7 * t_s))


@pytest.fixture(scope="module")
def model() -> WingModel:
    return WingModel(load_airframe("nadir-2m").wing)


@pytest.mark.parametrize("kind", KINDS, ids=[kind.name for kind in KINDS])
def test_every_hook_is_neutral_at_nothing(kind: type[Effect], model: WingModel) -> None:
    effect = kind()
    force = effect.force(motion(model))
    assert force is None or not np.any(force)
    for station in (Station.LEFT, Station.RIGHT):
        response = effect.response(station, F_HZ)
        assert response is None or np.allclose(response, 1.0, atol=1e-15)
        assert effect.bias(station) == 0.0
        assert np.array_equal(effect.sample_time(station, F_HZ), F_HZ)
    gain = effect.load_gain(F_HZ, 3)
    assert gain is None or np.allclose(gain, np.eye(3), atol=1e-15)
    assert effect.structure(model.structure).count == model.count
    for side in Side:
        view = viewed([effect], side, 0.0)
        assert (view.focal_ratio, view.slope_gain, view.lag_s, view.jitter_s, view.exposure_delay_s) == (1, 1, 0, 0, 0)


BOTH_WAYS = [kind for kind in KINDS if kind.response is not Effect.response and kind.sense is not Effect.sense]


@pytest.mark.parametrize("station", Station)
@pytest.mark.parametrize("kind", BOTH_WAYS, ids=[kind.name for kind in BOTH_WAYS])
def test_response_and_samples_agree(kind: type[Effect], station: Station) -> None:
    """A sine through the time-domain hook comes out as the frequency-domain hook says."""
    effect = kind.from_values({entry.name: entry.sigma for entry in kind.parameters()})
    t_s = np.arange(4000) / 1000.0  # whole cycles
    f_hz = 5.0
    values = np.zeros((len(t_s), 6))
    values[:, 2] = np.sin(2 * np.pi * f_hz * t_s)
    shown = effect.sense(station, t_s, values)[:, 2]
    gain = 2.0 * np.mean(shown * np.exp(-2j * np.pi * f_hz * t_s)) * 1j
    response = effect.response(station, np.array([f_hz]))
    assert response is not None
    assert gain == pytest.approx(complex(response[0]), abs=1e-6)


ADDITIVE = [kind for kind in KINDS if kind.additive]


@pytest.mark.parametrize("kind", ADDITIVE, ids=[kind.name for kind in ADDITIVE])
def test_what_is_additive_is_the_same_whatever_is_read_and_however_the_wing_moves(
    kind: type[Effect], model: WingModel
) -> None:
    effect = kind.from_values({entry.name: entry.default + entry.sigma for entry in kind.parameters()})
    moving = motion(model)
    still = dataclasses.replace(moving, q_m=0.0 * moving.q_m, qdot_mps=0.0 * moving.qdot_mps)
    assert np.array_equal(effect.force(still), effect.force(moving))
    values = np.random.default_rng(1).normal(0.0, 10.0, (500, 6))
    for station in Station:
        added = effect.sense(station, still.t_s, values) - values
        assert added == pytest.approx(effect.sense(station, still.t_s, 0.0 * values), abs=1e-12)


def test_a_filter_of_second_order_is_the_butterworth_s() -> None:
    corner_radps = 2.0 * np.pi * 45.0
    effect = catalogue()["sensor-filter"](2.0**0.5 / corner_radps, corner_radps**-2)
    response = effect.response(Station.LEFT, F_HZ)
    assert response is not None
    top, bottom = butter(2, corner_radps, analog=True)
    assert response == pytest.approx(freqs(top, bottom, 2.0 * np.pi * F_HZ)[1])


def test_one_camera_alone_turns_more() -> None:
    effect = catalogue()["camera-asymmetry"](0.1, 0.1)
    assert [viewed([effect], side, 0.0).slope_gain for side in Side] == pytest.approx([1.0, 1.2])


@pytest.mark.parametrize("delay_s", [0.004, -0.004])
def test_a_late_stream_is_late_on_one_side_only(delay_s: float) -> None:
    effect = catalogue()["stream-delay"](delay_s)
    late, other = (Station.RIGHT, Station.LEFT) if delay_s > 0 else (Station.LEFT, Station.RIGHT)
    assert effect.sample_time(late, np.array([1.0]))[0] == pytest.approx(1.0 - 0.004)
    assert effect.sample_time(other, np.array([1.0]))[0] == 1.0
    response = effect.response(late, np.array([10.0]))
    assert response is not None
    assert np.angle(response[0]) == pytest.approx(-2 * np.pi * 10.0 * 0.004)


def test_quadratic_damping_takes_the_energy_that_its_law_says(model: WingModel) -> None:
    """Over whole periods of v = V cos, the mean of -beta |v| v v is -beta V^3 4/(3 pi)."""
    t_s = np.arange(2000) / 2000.0
    speed = np.zeros((model.count, len(t_s)))
    speed[0] = 0.2 * np.cos(2 * np.pi * 5.0 * t_s)
    state = ModalMotion(t_s, np.zeros_like(speed), speed, np.zeros((model.count, 1)), 1.0, model.structure)
    force = catalogue()["quadratic-damping"](10.0).force(state)
    assert force is not None
    assert np.mean(force[0] * speed[0]) == pytest.approx(-10.0 * 0.2**3 * 4 / (3 * np.pi), rel=1e-4)
    assert np.allclose(force[1], 0.0, atol=1e-15)


def test_freeplay_has_no_spring_inside_its_gap(model: WingModel) -> None:
    t_s = np.linspace(0.0, 1.0, 101)
    q = np.zeros((model.count, len(t_s)))
    q[0] = np.linspace(-0.002, 0.002, 101)
    state = ModalMotion(t_s, q, np.zeros_like(q), np.zeros((model.count, 1)), 1.0, model.structure)
    force = catalogue()["freeplay"](0.0005).force(state)
    assert force is not None
    total = force[0] - model.structure.stiffness_radps2[0, 0] * q[0]
    inside = np.abs(q[0]) <= 0.0005
    assert np.allclose(total[inside], 0.0, atol=1e-12)
    assert total[-1] == pytest.approx(-model.structure.stiffness_radps2[0, 0] * 0.0015)


def test_a_mode_without_participation_is_no_mode(model: WingModel) -> None:
    grown = WingModel(load_airframe("nadir-2m").wing, (catalogue()["second-mode"](0.4, 18.0, 0.02),))
    assert grown.count == model.count + 1
    assert grown.omega_radps[-1] == pytest.approx(2 * np.pi * 18.0)
    assert grown.structure.lift[:, -1] == pytest.approx(np.sqrt([0.4, 0.4]))


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.starts_at is not None])
def test_what_begins_at_a_peak_of_the_residual_is_there_and_does_nothing_yet(kind: type[Effect]) -> None:
    begun = kind.at_peaks((11.0, 12.0, 13.0))
    values = {entry.name: getattr(begun, entry.name) for entry in kind.parameters()}
    assert 11.0 in values.values()
    # what is no peak and no size (the width of a kick) is as declared; sizes are declared as nothing
    declared = {entry.name: entry.default for entry in kind.parameters()}
    assert all(value == declared[name] for name, value in values.items() if value not in (11.0, 12.0, 13.0))
    assert not any(declared[name] for name in values if not name.endswith(("_s", "_hz")))


@pytest.mark.parametrize("kind", [kind for kind in KINDS if not kind.scan])
def test_an_effect_at_nothing_changes_no_airframe_value(kind: type[Effect]) -> None:
    airframe = load_airframe("nadir-2m")
    assert kind().apply_to_airframe(airframe) in (None, airframe)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind.in_samples])
def test_what_samples_show_is_not_seen_in_good_ones(kind: type[Effect]) -> None:
    rng = np.random.default_rng(1)
    t_s = np.arange(8000) / 1000.0
    force = -9.81 + rng.normal(0.0, 2.0, len(t_s))
    assert kind.sample_defect(t_s, force, load_airframe("nadir-2m").left) is None
    assert not kind.clipped(force).any()


def test_a_fast_second_mode_takes_hold_of_a_friction() -> None:
    """A dry friction's mean slope under Gaussian speeds is c sqrt(2 / pi) over the rms of the whole tip's speed."""
    model = WingModel(load_airframe("nadir-2m").wing)
    second = next(k for k, slot in enumerate(model.structure.slots) if slot == 2)
    rng = np.random.default_rng(12)
    speed = np.zeros((model.count, 200_000))
    speed[0] = 0.2 * rng.standard_normal(speed.shape[1])
    friction = catalogue()["coulomb-friction"].from_values({"friction_mps2": 0.3})
    for dither in (0.0, 0.2):
        speed[second] = dither * rng.standard_normal(speed.shape[1])
        state = ModalMotion(np.arange(200_000.0), 0.0 * speed, speed, np.zeros((model.count, 1)), 1.0, model.structure)
        force = friction.force(state)
        assert force is not None
        slope = float(force[0] @ speed[0]) / float(speed[0] @ speed[0])
        assert slope == pytest.approx(-0.3 * np.sqrt(2.0 / np.pi) / np.hypot(0.2, dither), rel=0.02)
        assert not np.any(force[second])


@pytest.mark.parametrize("softness_s2", [0.0, 1.8e-5])
def test_a_mount_never_shakes_its_camera_by_itself(softness_s2: float) -> None:
    """However negative its damper: phases lag about its resonance of 37 Hz, where some loss is left."""
    kind = catalogue()["mount-resonance"]
    view = viewed([kind.from_values({"softness_s2": softness_s2, "damper_s": -1e-3})], Side.LEFT, 0.0)
    followed = view.follows(2.0 * np.pi * np.linspace(30.0, 80.0, 4000))
    assert np.all(followed.imag <= 0.0)
    assert np.abs(followed).max() < 150.0

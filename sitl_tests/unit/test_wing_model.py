"""The wing model: its matrices, its static bend, its named effects and how they are extended."""

from __future__ import annotations

import dataclasses
import math
from typing import ClassVar

import numpy as np
import pytest

from companion.core.wing.effect import CameraView, Effect, Group, ModalMotion, parameter, sensed, viewed
from companion.core.wing.effects import catalogue, make_effect, make_effects
from companion.core.wing.effects.damping.damping_shift import DampingShift
from companion.core.wing.effects.stiffness.cubic_stiffness import CubicStiffness
from companion.core.wing.effects.stiffness.frequency_shift import FrequencyShift
from companion.core.wing.effects.stiffness.left_right_frequency import LeftRightFrequency
from companion.core.wing.model import WingModel
from companion.errors import ConfigError
from companion.params.airframe import Gust, Mode, NamedEffect, Uncertain, Wing
from companion.params.files import load_airframe
from companion.records import Side, Station


def _mode(frequency_hz: float, damping: float, slope: float, twist: float = 0.0) -> Mode:
    return Mode(Uncertain(frequency_hz), Uncertain(damping), Uncertain(slope), Uncertain(twist))


WING = Wing(
    1.0,
    _mode(5.0, 0.03, 1.39, 0.2),
    _mode(6.4, 0.04, 1.41, -0.1),
    Gust(Uncertain(0.005)),
    Uncertain(0.0149),
    Uncertain(0.012),
    _mode(27.0, 0.02, 4.78),
)
MODEL = WingModel(WING)


def test_coordinates_are_in_order_and_missing_modes_are_left_out() -> None:
    assert MODEL.count == 3
    assert MODEL.structure.slots == (0, 1, 2)
    assert MODEL.omega_radps == pytest.approx(2 * math.pi * np.array([5.0, 6.4, 27.0]))
    assert MODEL.zeta == pytest.approx([0.03, 0.04, 0.02])
    q = np.array([0.01, 0.02, 0.003])
    assert MODEL.all_slots(q) == pytest.approx([0.01, 0.02, 0.003, 0.0])
    assert MODEL.present(MODEL.all_slots(q)) == pytest.approx(q)


def test_a_third_symmetric_mode_is_one_coordinate_more_whoever_adds_it() -> None:
    third = dataclasses.replace(WING, further_symmetric=(_mode(60.0, 0.02, 7.85),))
    added = make_effects([NamedEffect("second-mode", {"participation": 0.3, "frequency_hz": 60.0})])
    for model in (WingModel(third), WingModel(WING, added)):
        assert model.structure.slots == (0, 1, 2, 4)
        assert model.omega_radps / (2.0 * math.pi) == pytest.approx([5.0, 6.4, 27.0, 60.0])
        q = np.array([0.01, 0.02, 0.003, 0.0004])
        assert model.all_slots(q) == pytest.approx([0.01, 0.02, 0.003, 0.0, 0.0004])
        assert model.present(model.all_slots(q)) == pytest.approx(q)


def test_tips_move_by_the_sum_with_the_antisymmetric_part_reversed_on_the_left() -> None:
    q = np.array([0.01, 0.002, 0.0005])
    assert MODEL.structure.lift @ q == pytest.approx([0.0085, 0.0125])
    symmetric, antisymmetric = 1.39 * 0.01 + 4.78 * 0.0005, 1.41 * 0.002
    assert MODEL.tip_slope_rad(q) == pytest.approx([symmetric - antisymmetric, symmetric + antisymmetric])
    assert MODEL.structure.twist_radpm @ q == pytest.approx([0.002 + 0.0002, 0.002 - 0.0002])


def test_load_factor_bends_the_first_symmetric_mode_alone() -> None:
    assert MODEL.q_static(1.0) == pytest.approx([0.0149, 0.0, 0.0])
    assert MODEL.q_static(2.5) == pytest.approx([0.0149 + 1.5 * 0.012, 0.0, 0.0])
    at_rest = MODEL.acceleration(0.0, MODEL.q_static(2.5), np.zeros(3), np.zeros(3), 2.5)
    assert at_rest == pytest.approx(np.zeros(3))


def test_state_space_is_the_right_hand_side() -> None:
    generator = np.random.default_rng(1)
    space = MODEL.state_space()
    q, rate, load = generator.normal(size=(3, 3)) * 0.01
    x = np.concatenate([q, rate])
    dx = space.a @ x + space.b_load @ load + space.offset_trim + 0.7 * space.offset_per_g
    assert dx == pytest.approx(np.concatenate([rate, MODEL.acceleration(0.0, q, rate, load, 1.7)]))


@pytest.mark.parametrize("bad", [0.0, -5.0, math.nan])
def test_frequencies_must_be_positive(bad: float) -> None:
    with pytest.raises(ValueError, match="symmetric frequency"):
        WingModel(dataclasses.replace(WING, symmetric=_mode(bad, 0.03, 1.39)))


# ------------------------------------------------------------------------------------------------ effects


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_effect_declares_itself_and_does_nothing_at_zero(name: str) -> None:
    kind = catalogue()[name]
    assert kind.name == name
    assert kind.__doc__
    assert all(entry.sigma > 0.0 and entry.doc for entry in kind.parameters())
    effect = make_effect(NamedEffect(name, {entry.name: 0.0 for entry in kind.parameters()}))
    changed = WingModel(WING, [effect])
    q, rate, load = np.array([0.02, -0.01, 0.001]), np.array([0.3, 0.2, -0.1]), np.array([1.0, 2.0, 3.0])
    expected = MODEL.acceleration(1.3, q, rate, load, 1.2)
    assert changed.acceleration(1.3, q, rate, load, 1.2) == pytest.approx(expected)


def test_frequency_and_damping_shift_are_apart() -> None:
    model = WingModel(WING, (FrequencyShift(0.1), DampingShift(-0.5)))
    assert model.omega_radps == pytest.approx(1.1 * MODEL.omega_radps)
    assert model.zeta == pytest.approx(0.5 * MODEL.zeta)
    assert model.q_static(1.0) == pytest.approx(MODEL.q_static(1.0))


def test_left_right_frequency_makes_each_half_ring_at_its_own() -> None:
    equal = dataclasses.replace(WING, antisymmetric=WING.symmetric, second_symmetric=None)
    model = WingModel(equal, (LeftRightFrequency(0.02),))
    squared, vectors = np.linalg.eigh(model.structure.stiffness_radps2)
    assert np.sqrt(squared) / (2 * math.pi) == pytest.approx([5.0 * 0.98, 5.0 * 1.02])
    tips = (model.structure.lift @ vectors).T
    assert np.abs(tips[0]) == pytest.approx([math.sqrt(2.0), 0.0], abs=1e-12)  # the low one is the left half alone
    assert np.abs(tips[1]) == pytest.approx([0.0, math.sqrt(2.0)], abs=1e-12)


def test_cubic_stiffness_acts_on_each_half_by_itself() -> None:
    equal = dataclasses.replace(WING, antisymmetric=WING.symmetric, second_symmetric=None)
    effect, kappa = CubicStiffness(1000.0), 1000.0
    model = WingModel(equal, (effect,))
    static = model.q_static(1.0)
    left_only = static + np.array([0.005, -0.005])  # left tip 10 mm up, right at rest
    motion = ModalMotion(0.0, left_only, np.zeros(2), static, 1.0, model.structure)
    left, right = model.structure.lift @ effect.force(motion)
    assert left == pytest.approx(-kappa * (2 * math.pi * 5.0) ** 2 * 0.01**3)
    assert right == pytest.approx(0.0, abs=1e-12)


def test_effects_are_built_from_the_airframe_file() -> None:
    made = make_effects([NamedEffect("cubic-stiffness", {"kappa_per_m2": 500.0}), NamedEffect("frequency-shift", {})])
    assert made == (CubicStiffness(500.0), FrequencyShift(0.0))
    airframe = dataclasses.replace(load_airframe("nadir-2m"), effects=(NamedEffect("frequency-shift", {"ratio": 0.1}),))
    assert WingModel.from_airframe(airframe).omega_radps[0] == pytest.approx(2 * math.pi * 5.5)


def test_unknown_effects_and_parameters_are_named() -> None:
    with pytest.raises(ConfigError, match=r"no effect 'gremlins'; known: .*cubic-stiffness"):
        make_effect(NamedEffect("gremlins"))
    with pytest.raises(ConfigError, match=r"'damping-shift' has no parameter 'ration'; it has: ratio"):
        make_effect(NamedEffect("damping-shift", {"ration": 0.1}))


@pytest.mark.parametrize("value", [-1.0, -5.0, math.nan])
def test_a_frequency_of_0_or_less_is_refused(value: float) -> None:
    with pytest.raises(ConfigError, match=r"'frequency-shift': ratio is \S+, and must be above -1"):
        make_effect(NamedEffect("frequency-shift", {"ratio": value}))


@dataclasses.dataclass(frozen=True, slots=True)
class _Everything(Effect):
    name: ClassVar[str] = "everything"
    group: ClassVar[Group] = Group.SENSING
    scale: float = parameter("", 0.1, "test")

    def sense(self, station: Station, t_s: np.ndarray, values: np.ndarray) -> np.ndarray:
        return values * (1.0 + self.scale) if station is Station.LEFT else values

    def camera(self, side: Side, t_s: float, view: CameraView) -> CameraView:
        return dataclasses.replace(view, focal_ratio=view.focal_ratio * (1.0 + self.scale))


def test_sensing_and_camera_hooks_chain_in_order() -> None:
    effects = (_Everything(0.5), _Everything(1.0))
    values = np.ones((2, 6))
    assert sensed(effects, Station.LEFT, np.zeros(2), values) == pytest.approx(3.0 * values)
    assert sensed(effects, Station.RIGHT, np.zeros(2), values) == pytest.approx(values)
    assert viewed(effects, Side.LEFT, 0.0).focal_ratio == pytest.approx(3.0)

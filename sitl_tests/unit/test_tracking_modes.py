"""Any number of modes a family: where their states and parameters lie, and what the filter's model makes of them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from companion.core.tracking.model import build_model, modal_propagation, slope_rows, stationary
from companion.core.tracking.parameters import parameter_index, parameter_limits, prior_parameters
from companion.core.tracking.states import StateLayout, make_layout, make_noise
from companion.errors import ConfigError
from companion.params.airframe import Airframe, Mode, Uncertain
from companion.params.files import dump_airframe, load_airframe, parse_airframe

STEP_S = 0.004
COUNTS = [(1, 1), (2, 2), (3, 2), (1, 4)]


def mode(frequency_hz: float) -> Mode:
    slope = 0.3 * frequency_hz
    return Mode(Uncertain(frequency_hz, 0.05 * frequency_hz), Uncertain(0.02, 0.01), Uncertain(slope, 0.01 * slope))


def airframe_of(symmetric: int, antisymmetric: int) -> Airframe:
    """The demo's aircraft with so many modes a family."""
    airframe = load_airframe("nadir-2m")
    changes: dict[str, Any] = {"assume_second": False}
    for name, first_hz, count in (("symmetric", 5.0, symmetric), ("antisymmetric", 6.4, antisymmetric)):
        modes = [mode(first_hz * (2 * rank + 1)) for rank in range(count)]
        changes |= {name: modes[0], f"second_{name}": modes[1] if count > 1 else None, f"further_{name}": (*modes[2:],)}
    return dataclasses.replace(airframe, wing=dataclasses.replace(airframe.wing, **changes))


def frequencies_hz(layout: StateLayout) -> list[list[float]]:
    return [[mode.frequency_hz.value for mode in family.modes] for family in layout.families]


@pytest.mark.parametrize("counts", COUNTS)
def test_each_mode_of_the_file_has_four_states_and_a_slope_of_its_own(counts: tuple[int, int]) -> None:
    layout = make_layout(airframe_of(*counts))
    assert layout.size == 4 * sum(counts) + 2 + len(layout.row_bias_states)
    assert [q for q, _ in layout.pairs] == list(range(0, 4 * sum(counts), 4))
    assert len({column for column, *_ in layout.slope_factors}) == sum(counts)
    rows = slope_rows(layout)
    for at, (frequency_hz, sign) in enumerate(
        (hz, family.sign) for family, each in zip(layout.families, frequencies_hz(layout), strict=True) for hz in each
    ):
        np.testing.assert_allclose(rows[:, 4 * at], 0.3 * frequency_hz * np.array(sign))


@pytest.mark.parametrize("counts", COUNTS)
def test_each_mode_rings_at_its_own_frequency_and_damping(counts: tuple[int, int]) -> None:
    airframe = airframe_of(*counts)
    layout = make_layout(airframe)
    symmetric, antisymmetric = (prior_parameters(family, airframe.wing.gust) for family in layout.families)
    transition, _ = modal_propagation(layout, (symmetric, antisymmetric), STEP_S)
    poles = np.log(np.linalg.eigvals(transition).astype(complex)) / STEP_S
    ringing = np.sort(np.abs(poles[poles.imag > 1.0])) / (2.0 * np.pi)
    np.testing.assert_allclose(ringing, sorted(hz for each in frequencies_hz(layout) for hz in each), rtol=1e-6)
    noise = make_noise(airframe, layout, STEP_S)
    model = build_model(layout, noise, (symmetric, antisymmetric), (-1.0, 1.0), STEP_S)
    assert np.linalg.eigvalsh(stationary(layout, noise, model)).min() > -1e-12


@pytest.mark.parametrize("modes", [1, 2, 3, 5])
def test_parameters_survive_their_logarithms_and_lie_within_their_limits(modes: int) -> None:
    family = make_layout(airframe_of(modes, 1)).symmetric
    prior = prior_parameters(family, airframe_of(modes, 1).wing.gust)
    low, high = parameter_limits(modes)
    log_params = prior.log_params()
    assert len(log_params) == len(prior.log_sigma) == len(low) == len(high) == 5 + 4 * (modes - 1)
    assert ((np.log(low) <= log_params) & (log_params <= np.log(high))).all()
    again = prior.with_log_params(log_params, prior.log_sigma)
    np.testing.assert_allclose(again.log_params(), log_params, rtol=1e-12)
    assert [round(mode.frequency_hz, 9) for mode in again.modes] == [m.frequency_hz.value for m in family.modes]


def test_places_of_joined_parameters_are_those_of_each_family_one_after_the_other() -> None:
    places = parameter_index([3, 1, 2])
    assert places.first.tolist() == [0, 13, 18]
    assert places.end.tolist() == [13, 18, 27]
    assert places.further.tolist() == [5, 9, 23]
    assert places.further_first.tolist() == [0, 0, 18]
    assert parameter_index([1]).further.tolist() == []


def test_a_second_mode_that_the_file_leaves_out_is_assumed_unless_the_file_says_that_there_is_none() -> None:
    alone = airframe_of(1, 1)
    assumed = dataclasses.replace(alone, wing=dataclasses.replace(alone.wing, assume_second=True))
    assert [len(family.modes) for family in make_layout(alone).families] == [1, 1]
    assert [len(family.modes) for family in make_layout(assumed).families] == [2, 2]


def test_further_modes_come_back_from_their_file_and_need_the_mode_below() -> None:
    airframe = airframe_of(4, 3)
    assert parse_airframe(dump_airframe(airframe), "file") == airframe
    without = dataclasses.replace(airframe, wing=dataclasses.replace(airframe.wing, second_symmetric=None))
    with pytest.raises(ConfigError, match=r"'wing.further_symmetric' needs 'wing.second_symmetric'"):
        parse_airframe(dump_airframe(without), "file")
    wild = dataclasses.replace(airframe.wing, further_antisymmetric=(mode(900.0),))
    with pytest.raises(ConfigError, match=r"wing.further_antisymmetric\[0\].frequency_hz"):
        parse_airframe(dump_airframe(dataclasses.replace(airframe, wing=wild)), "file")

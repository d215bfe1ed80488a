"""The beam against closed forms, against the paper's audited tables, and against finite elements that share no code."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh

from companion.core.wing.beam import Beam, BeamMode, characteristic_roots


def _unit_beam(mass_ratio: float, inertia_ratio: float) -> Beam:
    return Beam(1.0, 1.0, 1.0, 1.0, 1.0, mass_ratio, inertia_ratio)


def _finite_element_roots(count: int, mass_ratio: float, inertia_ratio: float, elements: int = 60) -> np.ndarray:
    """beta*l from Hermite beam elements with a lumped mass and inertia at the last node."""
    h = 1.0 / elements
    k = (
        np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h**2, -6 * h, 4 * h**2],
            ]
        )
        / h**3
    )
    m = (
        np.array(
            [
                [156, 22 * h, 54, -13 * h],
                [22 * h, 4 * h**2, 13 * h, -3 * h**2],
                [54, 13 * h, 156, -22 * h],
                [-13 * h, -3 * h**2, -22 * h, 4 * h**2],
            ]
        )
        * h
        / 420
    )
    size = 2 * (elements + 1)
    stiffness, mass = np.zeros((size, size)), np.zeros((size, size))
    for i in range(elements):
        rows = slice(2 * i, 2 * i + 4)
        stiffness[rows, rows] += k
        mass[rows, rows] += m
    mass[-2, -2] += mass_ratio
    mass[-1, -1] += inertia_ratio
    squared = eigh(stiffness[2:, 2:], mass[2:, 2:], eigvals_only=True)[:count]
    return np.sqrt(np.sqrt(squared))


def test_the_bare_cantilever_has_the_textbook_roots() -> None:
    assert characteristic_roots(4, 0.0) == pytest.approx([1.87510407, 4.69409113, 7.85475744, 10.99554073], abs=5e-9)


def test_a_heavy_tip_mass_turns_the_higher_modes_into_a_clamped_pinned_beam() -> None:
    # tan x = tanh x
    assert characteristic_roots(3, 1e9)[1:] == pytest.approx([3.92660231, 7.06858275], abs=1e-7)


def test_a_light_beam_under_a_heavy_mass_is_a_spring_of_3_e_i_over_l_cubed() -> None:
    mass_ratio = 1e5
    omega = characteristic_roots(1, mass_ratio)[0] ** 2
    assert omega == pytest.approx(math.sqrt(3.0 / (mass_ratio + 33.0 / 140.0)), rel=1e-9)


def test_high_modes_stay_exact_and_finite() -> None:
    roots = characteristic_roots(300, 0.0)
    asymptote = (np.arange(1, 301) - 0.5) * math.pi
    assert roots[10:] == pytest.approx(asymptote[10:], rel=1e-14)
    top = BeamMode(roots[-1], roots[-1] ** 2, 1.0, 0.0, 0.0)
    ends = top.shape(np.array([0.0, 1.0]))
    assert ends == pytest.approx([0.0, 1.0], abs=1e-12)
    assert top.slope_at_tip_radpm == pytest.approx(roots[-1], rel=1e-12)  # far from the root Y' = beta Y at a free end


@pytest.mark.parametrize(
    ("mass_ratio", "inertia_ratio"), [(0.0, 0.0), (2.389, 0.0), (0.0, 0.3), (0.5, 0.02), (2.0, 1.5), (30.0, 40.0)]
)
def test_roots_agree_with_finite_elements(mass_ratio: float, inertia_ratio: float) -> None:
    expected = _finite_element_roots(5, mass_ratio, inertia_ratio)
    assert characteristic_roots(5, mass_ratio, inertia_ratio) == pytest.approx(expected, rel=2e-6)


@settings(max_examples=60, deadline=None)
@given(mass_ratio=st.floats(0.0, 50.0), inertia_ratio=st.floats(0.0, 50.0), number=st.integers(1, 12))
def test_shapes_satisfy_the_clamp_and_the_tip_conditions(mass_ratio: float, inertia_ratio: float, number: int) -> None:
    root = float(characteristic_roots(number, mass_ratio, inertia_ratio)[-1])
    mode = BeamMode(root, root**2, 1.0, mass_ratio, inertia_ratio)
    scale = root**2 * float(np.max(np.abs(mode.shape(np.linspace(0, 1, 400)))))
    clamp = np.array([0.0])
    assert abs(mode.shape(clamp)[0]) < 1e-9 * scale
    assert abs(mode.slope(clamp)[0]) < 1e-9 * scale * root
    # moment: Y'' = eta x^4 Y'
    moment = mode.curvature(np.ones(1))[0] - inertia_ratio * root**4 * mode.slope_at_tip_radpm
    assert abs(moment) < 1e-7 * scale * max(1.0, inertia_ratio * root**3)
    # shear: Y''' = -mu x^4 Y, the third derivative by differences inside the beam
    step = 1e-4 / root
    curvature = mode.curvature(np.array([1.0 - 2 * step, 1.0 - step, 1.0]))
    third = (3 * curvature[2] - 4 * curvature[1] + curvature[0]) / (2 * step)
    assert abs(third + mass_ratio * root**4) < 1e-5 * scale * root * max(1.0, mass_ratio * root)


@pytest.mark.parametrize(("mass_ratio", "inertia_ratio"), [(0.0, 0.0), (2.389, 0.0), (1.0, 0.4)])
def test_different_modes_are_orthogonal_under_the_mass(mass_ratio: float, inertia_ratio: float) -> None:
    modes = _unit_beam(mass_ratio, inertia_ratio).modes(5)
    node, weight = np.polynomial.legendre.leggauss(120)
    shapes = np.array([mode.shape(0.5 * (node + 1.0)) for mode in modes])
    slopes = np.array([mode.slope_at_tip_radpm for mode in modes])
    gram = (shapes * 0.5 * weight) @ shapes.T + mass_ratio + inertia_ratio * np.outer(slopes, slopes)
    scale = np.sqrt(np.outer(np.diag(gram), np.diag(gram)))
    assert np.abs(gram / scale - np.eye(5)).max() < 1e-9
    assert np.diag(gram) == pytest.approx([mode.modal_mass_ratio() for mode in modes], rel=1e-9)


def test_rayleigh_quotient_of_each_shape_is_its_frequency() -> None:
    for mode in _unit_beam(2.389, 0.1).modes(4):
        node, weight = np.polynomial.legendre.leggauss(120)
        strain = float(0.5 * weight @ mode.curvature(0.5 * (node + 1.0)) ** 2)
        assert math.sqrt(strain / mode.modal_mass_ratio()) == pytest.approx(mode.omega_radps, rel=1e-10)


@pytest.mark.slow
def test_a_shaken_root_drives_all_modes_with_the_whole_mass() -> None:
    # sum over all modes of (participation)^2 modal mass is the total moving mass; the n-th carries 1/n^2 of it, so that
    # what n modes leave falls with 1/n and twice the sum of 2n less that of n is the whole but for 1/n^2
    modes = _unit_beam(0.7, 0.0).modes(32)
    sums = np.cumsum([mode.base_participation() ** 2 * mode.modal_mass_ratio() for mode in modes])
    assert 2.0 * sums[31] - sums[15] == pytest.approx(1.7, rel=5e-4)
    assert np.all(sums < 1.7)


def test_slope_per_metre_at_the_tip_of_a_bare_beam() -> None:
    mode = Beam(70e9, 1e-10, 2700.0, 1e-4, 0.8).modes(1)[0]
    assert mode.slope_at_tip_radpm == pytest.approx(1.3765 / 0.8, rel=1e-4)


@pytest.mark.parametrize(("mass_ratio", "number", "printed"), [(2.260, 1, 1.047), (2.389, 2, 3.974), (2.329, 3, 7.098)])
def test_table_2_needs_a_different_mass_ratio_for_each_root(mass_ratio: float, number: int, printed: float) -> None:
    assert characteristic_roots(3, mass_ratio)[number - 1] == pytest.approx(printed, abs=5e-4)


def test_table_2_frequencies_fit_one_mass_ratio_and_one_scale() -> None:
    printed_radps = np.array([126.305, 1865.8, 5952.3])
    roots = characteristic_roots(3, 2.389)
    assert roots[0] == pytest.approx(1.034, abs=5e-4)
    assert 118.156 * roots**2 == pytest.approx(printed_radps, rel=2e-4)
    assert printed_radps / np.array([1.047, 3.974, 7.098]) ** 2 == pytest.approx([115.220, 118.143, 118.144], abs=2e-3)


@pytest.mark.parametrize(("mass_kg", "percent"), [(0.0365, (0.07, 0.075, 0.07)), (0.035, (1.945, 0.175, 0.095))])
def test_table_1_as_corrected_gives_the_printed_frequencies(mass_kg: float, percent: tuple[float, ...]) -> None:
    beam = Beam(70e9, 0.0507 * 0.001**3 / 12.0, 2700.0, 0.0507 * 0.001, 0.1115, mass_kg)
    assert beam.second_moment_m4 == pytest.approx(4.225e-12, rel=1e-9)
    deviation = np.array([mode.omega_radps for mode in beam.modes(3)]) / (126.305, 1865.8, 5952.3) - 1.0
    assert np.all(np.abs(deviation) * 100.0 <= percent)


def test_table_1_as_printed_is_far_from_any_of_it() -> None:
    beam = Beam(70e18, 4.225e-10, 2700.0, 3.07e-8, 0.1115, 0.035e-3)
    ratio = np.array([mode.omega_radps for mode in beam.modes(3)]) / (126.305, 1865.8, 5952.3)
    assert np.all((ratio > 10.0) | (ratio < 0.1))


@pytest.mark.parametrize("bad", [-0.1, math.nan, math.inf])
def test_ratios_that_are_not_physical_are_refused(bad: float) -> None:
    with pytest.raises(ValueError, match="mass ratio"):
        characteristic_roots(1, bad)
    with pytest.raises(ValueError, match="inertia ratio"):
        characteristic_roots(1, 0.0, bad)


def test_a_beam_without_length_is_refused() -> None:
    with pytest.raises(ValueError, match="length_m"):
        Beam(70e9, 1e-10, 2700.0, 1e-4, 0.0)
    with pytest.raises(ValueError, match="one mode"):
        characteristic_roots(0, 0.0)

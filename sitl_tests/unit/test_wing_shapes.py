"""Measured shapes: exact on what they can represent, honest about noise, and clear about what cannot be fitted."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.wing.shapes import EdgePoints, WingShape, fit_polynomial

SPAN = np.linspace(0.0, 1.0, 13)


def _bent(span_m: np.ndarray) -> np.ndarray:
    return 0.3 * span_m**2 + 0.7 * span_m**3


def test_a_polynomial_is_found_exactly_with_its_slope_and_twist() -> None:
    lead = fit_polynomial(EdgePoints(SPAN, _bent(SPAN) + 0.01 * SPAN), 3)
    trail = fit_polynomial(EdgePoints(SPAN, _bent(SPAN) - 0.01 * SPAN), 3)
    at = WingShape(lead, trail).at(0.8, 0.25, 0.2)
    assert at.deflection == pytest.approx(_bent(0.8) + 0.01 * 0.8 * 0.5)
    assert at.slope == pytest.approx(0.6 * 0.8 + 2.1 * 0.64 + 0.005)
    assert at.twist == pytest.approx(0.016 / 0.2)  # leading edge up is nose up
    assert np.all(np.sqrt(np.diag(at.covariance)) < 1e-9)


def test_a_clamped_edge_starts_flat_and_reaches_back_to_the_root() -> None:
    outer = np.linspace(0.3, 1.0, 9)
    fit = fit_polynomial(EdgePoints(outer, _bent(outer)), 3, clamped=True)
    assert fit.deflection(np.array([0.0, 0.1])) == pytest.approx([0.0, _bent(0.1)])
    assert fit.slope(np.array([0.0]))[0] == 0.0


@pytest.mark.slow
def test_sigma_is_the_spread_of_repeated_measurements() -> None:
    generator = np.random.default_rng(11)
    span = np.linspace(0.0, 1.0, 25)
    place, tip = (0.9, 0.3, 0.2), (1.0, 0.5, 0.2)
    errors, factor_errors = [], []
    truth = np.array([_bent(0.9), 0.6 * 0.9 + 2.1 * 0.81, 0.0])
    for _ in range(300):
        edges = [EdgePoints(span, _bent(span) + generator.normal(0.0, 0.004, 25)) for _ in range(2)]
        shape = WingShape(*(fit_polynomial(edge, 3, clamped=True) for edge in edges))
        at = shape.at(*place)
        errors.append((np.array([at.deflection, at.slope, at.twist]) - truth) / np.sqrt(np.diag(at.covariance)))
        factors = shape.factors(place, tip)
        values = np.array([factors.lift_gain, factors.slope_factor_radpm, factors.twist_factor_radpm])
        factor_errors.append((values - truth) / np.sqrt(np.diag(factors.covariance)))  # the tip moves by 1
    assert np.std(errors, axis=0) == pytest.approx(np.ones(3), abs=0.25)
    assert np.std(factor_errors, axis=0) == pytest.approx(np.ones(3), abs=0.25)


def test_factors_do_not_depend_on_how_hard_the_wing_was_shaken() -> None:
    def factors(amplitude: float) -> tuple[float, float]:
        fit = fit_polynomial(EdgePoints(SPAN, amplitude * _bent(SPAN)), 3, clamped=True)
        got = WingShape(fit, fit).factors((0.9, 0.5, 0.2), (1.0, 0.5, 0.2))
        return got.lift_gain, got.slope_factor_radpm

    assert factors(0.02) == pytest.approx(factors(-3.0))


def test_given_sigma_is_used_in_place_of_the_scatter() -> None:
    fit = fit_polynomial(EdgePoints(SPAN[:4], _bent(SPAN[:4]), sigma=0.01), 3)
    assert fit.residual_sigma == 0.01
    assert np.all(np.diag(fit.covariance) > 0.0)


def test_too_few_points_are_refused_by_number() -> None:
    with pytest.raises(ValueError, match=r"4 distinct stations are too few: 5"):
        fit_polynomial(EdgePoints(SPAN[:4], _bent(SPAN[:4])), 3)
    with pytest.raises(ValueError, match="2 distinct stations are too few"):
        fit_polynomial(EdgePoints(np.array([0.1, 0.1, 0.2, 0.2, 0.1, 0.2]), np.zeros(6)), 3)


def test_nothing_is_said_outside_the_measured_span() -> None:
    fit = fit_polynomial(EdgePoints(SPAN[2:10], _bent(SPAN[2:10])), 3)
    for station in (0.0, 0.99):
        with pytest.raises(ValueError, match="outside the measured span"):
            fit.deflection(np.array([station]))


def test_a_node_cannot_be_the_reference() -> None:
    generator = np.random.default_rng(2)
    fit = fit_polynomial(EdgePoints(SPAN, (SPAN - 0.5) * SPAN**2 + generator.normal(0, 1e-3, 13)), 4)
    with pytest.raises(ValueError, match="does not move"):
        WingShape(fit, fit).factors((0.9, 0.5, 0.2), (0.5, 0.5, 0.2))


@pytest.mark.parametrize(
    ("span", "deflection", "message"),
    [(np.zeros(3), np.zeros(4), "equal length"), (np.array([0.0, np.nan]), np.zeros(2), "not finite")],
)
def test_points_that_make_no_sense_are_refused(span: np.ndarray, deflection: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        EdgePoints(span, deflection)


def test_a_chord_must_have_a_length() -> None:
    fit = fit_polynomial(EdgePoints(SPAN, _bent(SPAN)), 3)
    with pytest.raises(ValueError, match="chord"):
        WingShape(fit, fit).at(0.5, 0.5, 0.0)

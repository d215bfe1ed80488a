"""Exact discretisation: against closed forms and brute-force integration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.tracking.discretise import stationary_covariance, van_loan


@given(rate=st.floats(0.01, 1e4), intensity=st.floats(1e-6, 1e3), step=st.floats(1e-4, 0.1))
def test_one_pole_has_its_closed_form(rate: float, intensity: float, step: float) -> None:
    a, q = van_loan(np.array([[-rate]]), np.array([[intensity]]), step)
    assert a[0, 0] == pytest.approx(np.exp(-rate * step), rel=1e-9, abs=1e-12)
    assert q[0, 0] == pytest.approx(intensity * -np.expm1(-2 * rate * step) / (2 * rate), rel=1e-9)


def test_noise_of_an_oscillator_is_the_integral_of_its_impulse_response() -> None:
    omega, zeta, h = 30.0, 0.04, 0.004
    system = np.array([[0.0, 1.0], [-(omega**2), -2 * zeta * omega]])
    _, q = van_loan(system, np.diag([0.0, 2.0]), h)
    damped = omega * np.sqrt(1 - zeta**2)
    s = (np.arange(20000) + 0.5) * h / 20000
    x = np.exp(-zeta * omega * s) * np.sin(damped * s) / damped
    v = np.exp(-zeta * omega * s) * (np.cos(damped * s) - zeta * omega / damped * np.sin(damped * s))
    brute = 2.0 * h / 20000 * np.array([[x @ x, x @ v], [x @ v, v @ v]])
    np.testing.assert_allclose(q, brute, rtol=1e-6)


def test_a_pole_far_faster_than_the_step_does_not_overflow() -> None:
    a, q = van_loan(np.array([[-1e5, 0.0], [30.0, -30.0]]), np.diag([2e5, 0.0]), 0.01)
    assert np.isfinite(a).all()
    assert np.isfinite(q).all()
    assert q[0, 0] == pytest.approx(1.0, rel=1e-6)


def test_stationary_covariance_of_a_mode_in_white_load() -> None:
    omega, zeta, density = 2 * np.pi * 5, 0.03, 0.2
    system = np.array([[0.0, 1.0], [-(omega**2), -2 * zeta * omega]])
    covariance = stationary_covariance(*van_loan(system, np.diag([0.0, density / 2]), 0.004))
    assert covariance[0, 0] == pytest.approx(density / (8 * zeta * omega**3), rel=1e-6)
    assert covariance[1, 1] == pytest.approx(omega**2 * covariance[0, 0], rel=1e-6)


def test_an_unstable_model_is_refused() -> None:
    with pytest.raises(ValueError, match="not stable"):
        stationary_covariance(np.array([[1.0]]), np.array([[1.0]]))

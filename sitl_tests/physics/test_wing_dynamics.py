"""The wing's motion against closed forms: decay, resonance, static bend, amplitude-dependent frequency, energy."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import find_peaks

from companion.core.wing.effects.stiffness.cubic_stiffness import CubicStiffness
from companion.core.wing.model import WingModel
from companion.params.airframe import Gust, Mode, Uncertain, Wing

F, ZETA = 5.0, 0.03


def _wing(damping: float = ZETA) -> Wing:
    mode = Mode(Uncertain(F), Uncertain(damping), Uncertain(1.39))
    return Wing(1.0, mode, mode, Gust(Uncertain(0.005)), Uncertain(0.015), Uncertain(0.015))


def _fly(model: WingModel, q: np.ndarray, t_s: np.ndarray, load_factor: float = 1.0) -> np.ndarray:
    n = model.count

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        return np.concatenate([x[n:], model.acceleration(t, x[:n], x[n:], np.zeros(n), load_factor)])

    start = np.concatenate([q, np.zeros(n)])
    return solve_ivp(rates, (t_s[0], t_s[-1]), start, t_eval=t_s, rtol=1e-10, atol=1e-13).y.T


def test_a_released_wing_decays_to_its_trim_at_its_own_frequency() -> None:
    t = np.linspace(0.0, 3.0, 3001)
    path = _fly(WingModel(_wing()), np.array([0.025, 0.004]), t)
    omega = 2 * math.pi * F
    damped = omega * math.sqrt(1 - ZETA**2)
    swing = np.exp(-ZETA * omega * t) * (np.cos(damped * t) + ZETA * omega / damped * np.sin(damped * t))
    assert path[:, 0] == pytest.approx(0.015 + 0.010 * swing, abs=1e-9)
    assert path[:, 1] == pytest.approx(0.004 * swing, abs=1e-9)


def test_a_steady_pull_up_bends_by_the_bend_per_g() -> None:
    path = _fly(WingModel(_wing(0.3)), np.array([0.015, 0.0]), np.linspace(0.0, 6.0, 50), load_factor=3.0)
    assert path[-1, 0] == pytest.approx(0.015 + 2.0 * 0.015, abs=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("kappa", [pytest.param(1500.0, marks=pytest.mark.long), -800.0])
def test_a_cubic_spring_rings_higher_by_three_eighths_kappa_a_squared(kappa: float) -> None:
    amplitude = 0.008
    model = WingModel(_wing(0.0), (CubicStiffness(kappa),))
    t = np.linspace(0.0, 4.0, 40001)
    swing = _fly(model, np.array([0.015 + amplitude, 0.0]), t)[:, 0] - 0.015
    peaks = find_peaks(swing)[0]
    frequency = (len(peaks) - 1) / (t[peaks[-1]] - t[peaks[0]])
    shift = 0.375 * kappa * amplitude**2
    assert frequency / F - 1.0 == pytest.approx(shift, rel=0.06)  # next term is of order shift squared


@pytest.mark.slow
def test_an_undamped_cubic_wing_keeps_its_energy() -> None:
    kappa = 1500.0
    path = _fly(WingModel(_wing(0.0), (CubicStiffness(kappa),)), np.array([0.025, -0.006]), np.linspace(0.0, 2.0, 400))
    omega2 = (2 * math.pi * F) ** 2
    tips = (path[:, :1] - 0.015) + path[:, 1:2] * np.array([-1.0, 1.0])
    kinetic = 0.5 * np.sum((path[:, 2:3] + path[:, 3:4] * np.array([-1.0, 1.0])) ** 2, axis=1)
    potential = np.sum(omega2 * (0.5 * tips**2 + 0.25 * kappa * tips**4), axis=1)
    total = kinetic + potential
    assert total == pytest.approx(np.full(400, total[0]), rel=1e-7)

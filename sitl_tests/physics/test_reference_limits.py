"""The reference held against what was published and against the Wiener integral."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.linalg

from tools.reference.discretise import Discrete, averages, riccati, stacked
from tools.reference.load import chain, intensity
from tools.reference.single_tip import ACCEL_DENSITY, GYRO_DENSITY, SLOPE_RADPM, averaged, gust_density, held
from tools.reference.spec import DRYDEN, FIVE_TWENTY, GRAVITY_MPS2, WHITE, ModeSpec

# an independent computation: (f, zeta, rms, drift) -> axes -> percent causal / smoothed, relative slope in mrad
TABLE = {
    (3.0, 0.05, 0.008, False): {"z": (9.9, 6.5, 1.03), "zy": (1.0, 0.5, 0.08), "zp": (2.0, 1.9, 0.30)},
    (5.0, 0.03, 0.005, False): {"z": (7.2, 4.3, 0.43), "zy": (1.5, 0.8, 0.08), "zyp": (0.6, 0.5, 0.05)},
    (10.0, 0.03, 0.002, False): {"z": (6.0, 3.7, 0.15), "zy": (3.2, 1.9, 0.07), "zp": (2.3, 2.0, 0.08)},
    (3.0, 0.05, 0.008, True): {"z": (14, 7.0, 1.10), "zy": (3.1, 2.8, 0.44), "zyp": (2.9, 2.7, 0.43)},
    (5.0, 0.03, 0.005, True): {"z": (9.8, 4.7, 0.47), "zp": (4.1, 3.3, 0.33), "zyp": (2.9, 2.5, 0.24)},
    (10.0, 0.03, 0.002, True): {"z": (7.9, 4.0, 0.16), "zp": (4.0, 2.8, 0.11), "zyp": (3.5, 2.5, 0.10)},
}
ROWS = [(key, axes, figures) for key, row in TABLE.items() for axes, figures in row.items()]


def steady_errors(step: Discrete, lag_steps: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Covariance of the prediction and of the estimate ``lag_steps`` later (None: with all data to come)."""
    P = riccati(step)
    innovation = np.linalg.inv(step.H @ P @ step.H.T + step.R)
    closed = step.F - (step.F @ P @ step.H.T + step.S) @ innovation @ step.H
    gain = step.H.T @ innovation @ step.H
    if lag_steps is None:
        information = scipy.linalg.solve_discrete_lyapunov(closed.T, gain)
        return P, P - P @ information @ P
    information = np.zeros_like(P)
    for _ in range(lag_steps):
        information = gain + closed.T @ information @ closed
    return P, P - P @ information @ P


def _percent(step, rms_m: float, lag_steps: int | None) -> tuple[float, float]:
    P, smooth = steady_errors(step, lag_steps)
    return 100 * np.sqrt(P[0, 0]) / rms_m, 100 * np.sqrt(smooth[0, 0]) / rms_m


@pytest.mark.parametrize(("wing", "axes", "figures"), ROWS)
def test_the_published_table_of_limits_is_found_again(wing, axes, figures) -> None:
    frequency, damping, rms, drift = wing
    causal, smoothed = _percent(held(frequency, damping, rms, axes, 0.001, drift), rms, 1000)
    # printed with two digits: half a unit of the last one is up to 5 %; the 3 Hz gyro row differs by 10 %
    slack = 0.11 if (frequency, axes) == (3.0, "zp") else 0.05
    digit = 0.05 if figures[0] < 10 else 0.5
    assert causal == pytest.approx(figures[0], rel=slack, abs=digit)
    assert smoothed == pytest.approx(figures[1], rel=slack, abs=0.05)
    slope_mrad = smoothed / 100 * rms * SLOPE_RADPM * np.sqrt(2) * 1e3
    assert slope_mrad == pytest.approx(figures[2], rel=slack, abs=0.006)


@pytest.mark.parametrize("wing", [(3.0, 0.05, 0.008), (5.0, 0.03, 0.005), (10.0, 0.03, 0.002), (20.0, 0.1, 0.0007)])
@pytest.mark.parametrize("axes", ["z", "zy", "zp", "zyp"])
def test_the_smoother_attains_the_wiener_integral(wing, axes) -> None:
    """Error of the best estimate from all data, past and coming: S_qq less what is coherent with the measurements."""
    frequency, damping, rms = wing
    _, smoothed = _percent(averaged(frequency, damping, rms, axes, 0.0001, False), rms, None)
    f = np.geomspace(1e-6, 3000, 1_000_000)
    s, load, H, noise = _spectra(frequency, damping, rms, axes, f)
    # one load behind all rows: coherent part = load |h|^2 G/(1 + load G), G = sum |H_i|^2/N_i
    gain = (np.abs(H) ** 2 / noise[:, None]).sum(axis=0)
    error = np.abs(s) ** 2 * load / (1 + load * gain)
    wiener = 100 * np.sqrt(2 * np.trapezoid(error, f)) / rms
    assert smoothed == pytest.approx(wiener, rel=0.01)


@pytest.mark.parametrize("wing", [(3.0, 0.05, 0.008), (5.0, 0.03, 0.005), (10.0, 0.03, 0.002)])
@pytest.mark.parametrize("axes", ["z", "p"])
def test_the_filter_attains_the_causal_wiener_error(wing, axes) -> None:
    """Causal Wiener filter of one axis in continuous time, by spectral factorisation (polynomial roots)."""
    frequency, damping, rms = wing
    causal, _ = _percent(averaged(frequency, damping, rms, axes, 0.0001, False), rms, 1)
    omega = 2 * np.pi * frequency
    load = gust_density(frequency, damping, rms)
    noise = (ACCEL_DENSITY if axes == "z" else GYRO_DENSITY) ** 2 / 2
    den = np.array([1.0, 2 * damping * omega, omega**2])
    num = np.array([1.0, 0, 0]) if axes == "z" else np.array([SLOPE_RADPM, 0])
    total = np.polyadd(load * _square(num), noise * _square(den))
    stable = np.real(np.poly([r for r in np.roots(total) if r.real < 0])) * np.sqrt(total[0])
    # S_qy / Psi(-s) = load num(-s) / (den(s) stable(-s)); keep its stable part r(s)/den(s)
    poles = np.roots(den)
    residues = [load * _at(num, -p) / (_at(stable, -p) * (p - poles[1 - i])) for i, p in enumerate(poles)]
    explained = sum(
        (a * b / -(p + q)).real
        for a, p in zip(residues, poles, strict=True)
        for b, q in zip(residues, poles, strict=True)
    )
    assert causal == pytest.approx(100 * np.sqrt(rms**2 - explained) / rms, rel=0.01)


def _square(polynomial):
    """p(s) p(-s)."""
    mirrored = polynomial * (-1.0) ** np.arange(len(polynomial) - 1, -1, -1)
    return np.polymul(polynomial, mirrored)


def _at(polynomial, s):
    return np.polyval(polynomial, s)


def _spectra(frequency, damping, rms, axes, f):
    s, omega = 2j * np.pi * f, 2 * np.pi * frequency
    h = 1 / (s**2 + 2 * damping * omega * s + omega**2)
    rows = {"z": s**2 * h, "y": SLOPE_RADPM * GRAVITY_MPS2 * h, "p": SLOPE_RADPM * s * h}
    noise = {"z": ACCEL_DENSITY, "y": ACCEL_DENSITY, "p": GYRO_DENSITY}
    H = np.array([rows[axis] for axis in axes])
    return h, gust_density(frequency, damping, rms), H, np.array([noise[axis] ** 2 / 2 for axis in axes])


def test_gust_taken_for_measurement_noise_would_be_three_times_too_pessimistic() -> None:
    step = averaged(5.0, 0.03, 0.005, "z", 0.001, False)
    right = riccati(step)
    blind = riccati(type(step)(step.F, step.H, step.Q, step.R, np.zeros_like(step.S)))
    assert 2.0 < np.sqrt(blind[0, 0] / right[0, 0]) < 6.0


@pytest.mark.parametrize("gust", [WHITE, FIVE_TWENTY, DRYDEN])
def test_one_long_step_is_many_short_ones(gust) -> None:
    mode = ModeSpec(5.0, 0.03, 0.005)
    A, b, row = chain(5.0, 0.03, gust)
    W = np.diag([intensity(mode, gust), 1e-6])
    C, B = row[None], np.stack([b, np.zeros_like(b)], axis=1)
    D = np.array([[b[1], 1.0]])
    long = averages(A, B, C, D, W, 0.004)
    joined = stacked(averages(A, B, C, D, W, 0.0005), 8).project(np.full((1, 8), 1 / 8))
    for name in ("F", "H", "Q", "R", "S"):
        assert getattr(joined, name) == pytest.approx(getattr(long, name), rel=1e-6, abs=1e-12), name


def test_the_mean_acceleration_is_the_change_of_rate() -> None:
    """With noiseless averages the measurement is dv/T: its noise and the rate's noise are one and the same."""
    mode = ModeSpec(5.0, 0.03, 0.005)
    A, b, row = chain(5.0, 0.03, WHITE)
    step = averages(A, b[:, None], row[None], np.array([[b[1]]]), np.array([[intensity(mode, WHITE)]]), 0.004)
    assert step.H[0] == pytest.approx((step.F[1] - [0, 1]) / 0.004, rel=1e-9, abs=1e-9)
    assert step.R[0, 0] == pytest.approx(step.Q[1, 1] / 0.004**2, rel=1e-9)
    assert step.S[:, 0] == pytest.approx(step.Q[:, 1] / 0.004, rel=1e-9)


@pytest.mark.parametrize(("frequency", "rms", "loss"), [(5.0, 0.005, 1.05), (10.0, 0.002, 1.3), (20.0, 0.0006, 1.6)])
def test_averages_alone_lose_a_white_gust_that_the_first_moment_keeps(frequency, rms, loss) -> None:
    fine = averaged(frequency, 0.03, rms, "z", 0.001, True)
    joined = stacked(fine, 4)
    mean = np.full((1, 4), 0.25)
    both = np.vstack([mean, (np.arange(4) - 1.5) / 4])
    _, best = _percent(fine, rms, 500)
    _, lossy = _percent(joined.project(mean), rms, 125)
    _, with_moment = _percent(joined.project(both), rms, 125)
    assert with_moment == pytest.approx(best, rel=1e-3)
    assert lossy > loss * best

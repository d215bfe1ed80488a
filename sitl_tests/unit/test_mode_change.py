"""What a filter knows when its wing's parameters change under way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from companion.core.mode.kalman import Kalman
from companion.core.mode.layout import make_layout, make_noise
from companion.core.mode.model import Parameters, build_model
from companion.core.mode.parameters import prior_parameters
from companion.params.files import load_airframe

AIRFRAME = load_airframe("nadir-2m")
STEP_S = 0.004
LAYOUT = make_layout(AIRFRAME)
NOISE = make_noise(AIRFRAME, LAYOUT, STEP_S)
OLD: Parameters = (
    prior_parameters(LAYOUT.symmetric, AIRFRAME.wing.gust),
    prior_parameters(LAYOUT.antisymmetric, AIRFRAME.wing.gust),
)
NEW: Parameters = (
    replace(OLD[0], frequency_hz=1.12 * OLD[0].frequency_hz, damping=1.6 * OLD[0].damping),
    replace(OLD[1], frequency_hz=0.9 * OLD[1].frequency_hz, frequency_2_hz=1.1 * OLD[1].frequency_2_hz),
)


def _filter() -> Kalman:
    wing, rng = AIRFRAME.wing, np.random.default_rng(2)
    model = build_model(LAYOUT, NOISE, OLD, (-0.99, 0.99), STEP_S)
    kalman = Kalman(LAYOUT, NOISE, model, wing.trim_bend_m.value, wing.bend_per_g_m.value, 8)
    kalman.columns[:, 0] = rng.normal(size=LAYOUT.size + 1)
    root = rng.normal(size=(LAYOUT.size, LAYOUT.size))
    kalman.covariance[:] = root @ root.T
    return kalman


def _acceleration_rows(parameters: Parameters) -> np.ndarray:
    """Acceleration of every mode: load less damper less spring, which is at rest at the static bend; (4, n + 1)."""
    rows = np.zeros((4, LAYOUT.size + 1))
    for k, (family, p) in enumerate(zip(LAYOUT.families, parameters, strict=True)):
        for turn, (q, hz, zeta) in enumerate(
            ((family.q, p.frequency_hz, p.damping), (family.q2, p.frequency_2_hz, p.damping_2))
        ):
            omega, row = 2.0 * math.pi * hz, rows[2 * k + turn]
            row[q], row[q + 1], row[q + 3] = -(omega**2), -2.0 * zeta * omega, 1.0
    rows[0, LAYOUT.size] = -rows[0, LAYOUT.symmetric.q]
    return rows


def test_other_springs_and_dampers_change_neither_motion_nor_acceleration_nor_how_well_they_are_known() -> None:
    kalman = _filter()
    before, after, n = _acceleration_rows(OLD), _acceleration_rows(NEW), LAYOUT.size
    columns, covariance = kalman.columns.copy(), kalman.covariance.copy()
    kalman.use(build_model(LAYOUT, NOISE, NEW, (-0.99, 0.99), STEP_S))
    np.testing.assert_allclose(after @ kalman.columns, before @ columns, rtol=1e-9, atol=1e-6)
    known, was = (
        rows[:, :n] @ spread @ rows[:, :n].T for rows, spread in ((after, kalman.covariance), (before, covariance))
    )
    np.testing.assert_allclose(known, was, rtol=1e-7, atol=1e-6 * np.abs(was).max())
    loads = [q + 2 + k for family in LAYOUT.families for q in (family.q, family.q2) for k in (0, 1)]
    rest = np.delete(np.arange(n), loads)
    np.testing.assert_array_equal(kalman.columns[rest], columns[rest])
    np.testing.assert_array_equal(kalman.covariance[np.ix_(rest, rest)], covariance[np.ix_(rest, rest)])


def test_the_same_wing_again_changes_nothing() -> None:
    kalman = _filter()
    columns, covariance = kalman.columns.copy(), kalman.covariance.copy()
    kalman.use(build_model(LAYOUT, NOISE, OLD, (-0.99, 0.99), STEP_S))
    np.testing.assert_array_equal(kalman.columns, columns)
    np.testing.assert_allclose(kalman.covariance, covariance, rtol=1e-12)

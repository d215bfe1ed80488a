"""What a filter knows when its wing's parameters change under way."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from companion.core.mode.kalman import Kalman
from companion.core.mode.layout import ROWS, make_layout, make_noise
from companion.core.mode.model import Parameters, build_model
from companion.core.mode.parameters import prior_parameters
from companion.core.mode.rigid import Cells
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


def test_what_was_learned_of_a_wandering_bias_ages_and_what_cannot_move_stays_learned() -> None:
    wing, restless = AIRFRAME.wing, replace(NOISE, bias_time_s=1.0)
    model = build_model(LAYOUT, restless, OLD, (-0.99, 0.99), STEP_S)
    kalman = Kalman(LAYOUT, restless, model, wing.trim_bend_m.value, wing.bend_per_g_m.value, 8)
    sigma = LAYOUT.constant_sigma
    kalman._memory.information[1:, 1:] = np.diag(100.0 / sigma**2)
    blind = _nothing_measured(1000)
    kalman.run(blind.span(0, 25))
    learned = np.sqrt(np.diag(kalman.constants_covariance)) / sigma
    kalman.run(blind.span(25, 1000))
    later = np.sqrt(np.diag(kalman.constants_covariance)) / sigma
    ages = np.array([name in ("root.bp", "root.br") for name in LAYOUT.constants])
    moves = np.array([name.startswith("root.") for name in LAYOUT.constants]) & ~ages  # considered: never learned
    assert ages.sum() == 2
    np.testing.assert_allclose(learned[~moves], 101.0**-0.5, rtol=1e-6)
    np.testing.assert_allclose(later[~moves & ~ages], 101.0**-0.5, rtol=1e-6)
    # information falls with exp(-2 t / tau), at the end of every tenth of a second but the last
    np.testing.assert_allclose(later[ages], (1.0 + 100.0 * math.exp(-2.0 * 3.9)) ** -0.5, rtol=1e-6)


def _nothing_measured(count: int) -> Cells:
    per_row, per_side = np.zeros((count, ROWS)), np.zeros((count, 2))
    return Cells(
        start_ns=np.arange(count, dtype=np.int64) * 4_000_000,
        rows=per_row,
        present=np.zeros((count, ROWS), dtype=np.bool_),
        vertical=per_side,
        lateral=per_side,
        tilted=per_side,
        lateral_gain=per_side,
        load=np.zeros(count),
        rate=np.zeros((count, 3)),
        sensitivity=np.zeros((count, ROWS, len(LAYOUT.constants))),
        cut=per_side,
    )

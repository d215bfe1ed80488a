"""Equations 1 to 12: ours hold, the misprints do not, by numbers worked out here."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.paper import equations

EQUATIONS = {entry.label: entry for entry in equations.audit()}


def test_every_equation_is_there() -> None:
    assert list(EQUATIONS) == [str(n) for n in range(1, 13)]


@pytest.mark.parametrize("label", sorted(EQUATIONS, key=int))
def test_ours_holds(label: str) -> None:
    differenced = label in ("9", "12")  # checked by finite differences
    assert EQUATIONS[label].error < (1e-6 if differenced else 1e-12)


def test_equation_7_as_printed_is_no_rotation() -> None:
    z_turn = equations.eq_7_as_printed(np.array([0.0, 0.0, 1.0]), math.pi / 2)
    assert np.linalg.det(z_turn) == pytest.approx(-1.0)  # [[0, 1], [1, 0]] is a mirror
    assert equations.wrong_entries() == ["12", "23", "31", "32"]


def test_equation_7_repaired_in_four_signs_is_equation_6() -> None:
    x, y, z = 0.48, -0.6, 0.64
    angle = 0.7
    printed = equations.eq_7_as_printed(np.array([x, y, z]), angle)
    v, s = 1 - math.cos(angle), math.sin(angle)
    printed[0, 1] = x * y * v - z * s
    printed[1, 2] = y * z * v - x * s
    printed[2, 0] = x * z * v - y * s
    printed[2, 1] = y * z * v + x * s
    assert printed @ printed.T == pytest.approx(np.eye(3), abs=1e-12)
    assert printed @ [x, y, z] == pytest.approx([x, y, z])


def test_equation_12_as_printed_has_its_first_root_at_3_87() -> None:
    mu = 2.389
    root = equations.eq_12_root(mu)
    assert round(root, 2) == 3.87
    wrong = 1 + math.cos(root) * math.cosh(root)
    wrong -= mu * root * (math.cos(root) * math.sinh(root) - math.sin(root) * math.cosh(root))
    assert wrong == pytest.approx(0.0, abs=1e-6 * math.cosh(root))


def test_convergence_lengthens_and_divergence_is_table_3() -> None:
    convergence = equations.convergence()
    still, theta = 5.137, 1.98 * (1 / 5.078 - 1 / 5.137)
    assert convergence["converged_px"] < convergence["still_px"] < convergence["diverged_px"]
    assert convergence["converged_range_m"] == pytest.approx(1 / (1 / still - theta / 1.98), abs=0.0015)
    assert convergence["diverged_range_m"] == pytest.approx(5.078, abs=0.0005)

"""The other hand's truth: beam, steps and recoil against closed forms, and a plan that every kind of trial is in."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

from tools.trial_generators import STRANGER
from tools.trial_plan import strangers_acceptance
from tools.trial_truths.stranger import beam, cases
from tools.trial_truths.stranger.cases import OUTSIDE, SIGMA, fly_all, hide
from tools.trial_truths.stranger.flight import STEP_HZ, Motion, _gust, drawn, fly
from tools.trial_truths.stranger.sensors import _tip
from tools.trial_truths.stranger.steps import propagated


def test_elements_ring_like_a_uniform_cantilever() -> None:
    """Beam of unit stiffness, mass and length: (1.8751)^2, (4.6941)^2 rad/s."""
    count = 8
    stiffness, mass = (np.zeros((2 * count + 2, 2 * count + 2)) for _ in range(2))
    for i in range(count):
        at = np.ix_(range(2 * i, 2 * i + 4), range(2 * i, 2 * i + 4))
        stiffness[at] += beam._element_stiffness(1.0 / count)
        mass[at] += beam._element_mass(1.0 / count)
    squares = eigh(stiffness[2:, 2:], mass[2:, 2:], eigvals_only=True)
    assert np.sqrt(squares[:2]) == pytest.approx([1.8751**2, 4.6941**2], rel=1e-3)


def test_the_fuselage_recoils_against_the_tips() -> None:
    modes = beam.modes()
    assert list(modes.symmetric) == [True, False] * beam.FAMILY
    assert modes.heave[0] < -0.02
    assert modes.roll_radpm[1] < -0.02
    # what a tip does against the ground is what it does against the fuselage, and what that does
    arms = np.array([[-beam.SEMISPAN_M], [beam.SEMISPAN_M]])
    assert modes.tip_free == pytest.approx(modes.tip + modes.heave + arms * modes.roll_radpm, abs=1e-9)


@pytest.mark.long
def test_tips_feel_the_roll_of_the_fuselage_once() -> None:
    """Tips rise against the ground as much as their free modes do: roll that the gyro shows is no further motion."""
    rng = np.random.default_rng(4)
    motion = fly({}, {}, False, 0.0, 4.0, rng, drawn(rng))
    turning = np.gradient(motion.roll_rate_radps, 1.0 / STEP_HZ)
    shown = np.stack([_tip(motion, {}, side, np.zeros(len(turning)), turning) for side in range(2)])
    against, together = 0.5 * (shown[1] - shown[0]), 0.5 * (motion.up_mps2[1] - motion.up_mps2[0])
    # below the second pair each deflection has its own mode; up is -z, and both are low-passed far above
    slow = slice(int(3.0 * 4.0), int(7.0 * 4.0))
    recorded = np.fft.rfft(against[: 4 * int(STEP_HZ)])[slow]
    moved = np.fft.rfft(together[: 4 * int(STEP_HZ)])[slow]
    free = beam.modes().tip_free[1, 1] / beam.modes().tip[1, 1]
    assert -np.vdot(moved, recorded).real / np.vdot(moved, moved).real == pytest.approx(free, abs=0.02)


def test_a_step_is_the_exact_free_vibration() -> None:
    omega, zeta, dt = np.array([30.0]), np.array([0.05]), 0.01
    q_of_q, _, v_of_q, _, q_of_f, _ = propagated(omega, zeta, dt)
    ringing = omega * np.sqrt(1.0 - zeta**2)
    expected = np.exp(-zeta * omega * dt) * (np.cos(ringing * dt) + zeta * omega / ringing * np.sin(ringing * dt))
    assert q_of_q == pytest.approx(expected)
    assert v_of_q[0] < 0.0
    assert q_of_f[0] == pytest.approx(0.5 * dt**2, rel=0.05)


def test_tables_show_gravity_and_ranges_that_read_short() -> None:
    label = hide([], (8.0, 14.0), np.random.default_rng(3))
    (tables,) = fly_all([label], [20.0], 3, 10.0)
    assert np.mean(tables.force_z_mps2) == pytest.approx(np.mean(tables.root["z"][1]), abs=0.1)
    assert np.mean(tables.root["z"][1]) == pytest.approx(-9.80665, abs=1.0)
    # 13.5 mm in trim diverge the axes by 37 mrad
    short = np.mean(2.34 * (1.0 / tables.range_m - 1.0 / tables.reference_m))
    assert short == pytest.approx(2.0 * 1.37 * 0.0135, rel=0.1)


def test_an_uneven_gust_mixes_the_first_two_loads_by_the_ratio_that_is_told() -> None:
    rng, tilt, corner, design = np.random.default_rng(8), 0.1, 0.0, beam.modes()
    omega = 2.0 * np.pi * design.frequency_hz
    load = _gust(design, omega, np.full(len(omega), 0.03), {"left-right-forcing": tilt}, {}, corner, 400_000, rng)
    power = load[:2] @ load[:2].T
    # loads a and b that are mixed by r: cross density r (a^2 + b^2), their powers hardly changed
    mixed = power[0, 1] / (power[0, 0] + power[1, 1])
    assert mixed == pytest.approx(STRANGER.units["left-right-forcing"] * tilt, rel=0.05)


def test_the_plan_has_every_name_with_and_without_it_and_what_no_catalogue_has() -> None:
    trials = [trial for batch in strangers_acceptance(1) for trial in batch]
    assert sum(len(trial.judged) for trial in trials) >= 200
    single = [trial for trial in trials if trial.kind == "single"]
    assert {name for trial in single for name in trial.label.effects} == set(STRANGER.names)
    assert all(trial.judged == (False, True) for trial in single)
    outside = {name for trial in trials if trial.kind == "outside" for name in trial.label.effects}
    assert outside == set(OUTSIDE)
    assert len(outside) >= 12


@pytest.mark.parametrize("name", sorted(SIGMA))
def test_what_is_hidden_is_as_strong_as_asked(name: str) -> None:
    label = hide([name], (8.0, 8.0), np.random.default_rng(4))
    assert label.strength(name, 20.0) == pytest.approx(8.0, rel=1e-6)


def test_a_wing_that_breaks_in_every_gust_is_flown_in_calmer_air() -> None:
    """A spring that softens to nothing at 26 mm, and a gust that bends the wing by as much in every minute."""
    label = hide(["cubic-stiffness"], (13.5, 13.6), np.random.default_rng(3))
    label = dataclasses.replace(
        label, effects={"cubic-stiffness": -1218.0}, extra=label.extra | {"loudness": 2.0, "manoeuvres": 0.0}
    )
    (tables,) = fly_all([label], [20.0], 3, 20.0)
    assert np.all(np.isfinite(tables.force_z_mps2))


def test_a_wing_that_breaks_is_flown_again_in_another_gust(monkeypatch: pytest.MonkeyPatch) -> None:
    label, flown = hide([], (8.0, 8.0), np.random.default_rng(4)), []

    def breaking(*plan: Any) -> Motion:
        motion = fly(*plan)
        flown.append(motion.up_mps2[0, 100])
        return motion if len(flown) == 3 else dataclasses.replace(motion, up_mps2=np.full_like(motion.up_mps2, np.nan))

    monkeypatch.setattr(cases, "fly", breaking)
    (tables,) = fly_all([label], [20.0], 3, 4.0)
    assert np.all(np.isfinite(tables.force_z_mps2))
    assert len(set(flown)) == 3

"""Blind trials in small: one independent flight each, a hidden effect to be found, nothing to be invented."""

from __future__ import annotations

import numpy as np
import pytest

from tools.trial_plan import Trial
from tools.trial_truths.cases import Hidden, noise_density
from tools.trial_truths.wing import World, integrate
from tools.trials import run

LABELS = [Hidden({}), Hidden({"stream-delay": -0.003}), Hidden({"exposure-delay": 0.0025})]


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, object]]:
    """Nothing, and cameras 5 ms late, in 20 s each."""
    labels = [Hidden({}), Hidden({"exposure-delay": 0.005})]
    return run([[Trial("single", label) for label in labels]], 5, tmp_path_factory.mktemp("quick"), 20.0)


@pytest.mark.long
def test_twenty_seconds_are_enough_for_late_cameras_and_for_nothing(quick: list[dict[str, object]]) -> None:
    assert quick[0]["verdict"] == "adequate"
    assert quick[1]["verdict"] == "explained"
    assert any("exposure-delay" in group for group in quick[1]["groups"])  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, object]]:
    return run([[Trial("single", label) for label in LABELS]], 3, tmp_path_factory.mktemp("trials"), 30.0)


@pytest.mark.long
def test_nothing_hidden_is_nothing_named(rows: list[dict[str, object]]) -> None:
    assert rows[0]["verdict"] == "adequate"


@pytest.mark.long
@pytest.mark.parametrize("index", [1, 2])
def test_what_is_hidden_is_named(rows: list[dict[str, object]], index: int) -> None:
    (name,) = LABELS[index].effects
    assert rows[index]["verdict"] == "explained"
    assert any(name in group for group in rows[index]["groups"])  # type: ignore[attr-defined]


@pytest.mark.long
def test_the_trials_wing_has_the_variance_of_theory() -> None:
    """A white load of the right intensity gives the rms asked for, and halves swing at the frequencies asked for."""
    n = 6
    world = World(np.array([[5.0], [6.4]]) * np.ones((2, n)), np.full((2, n), 0.05), np.array([[0.005], [0.003]]) *
                  np.ones((2, n)), np.full(n, 1.39), np.zeros(n), np.zeros(n))  # fmt: skip
    flight = integrate(world, {}, 30.0, np.random.default_rng(2))
    symmetric = flight["w_m"].mean(1)
    # six flights of 30 s with a correlation time of 1/(zeta omega) = 0.64 s: some 140 independent variances
    assert symmetric.std() == pytest.approx(0.005, rel=0.25)
    power = np.mean(np.abs(np.fft.rfft(symmetric, axis=0)) ** 2, axis=1)
    f_hz = np.fft.rfftfreq(len(symmetric), 1e-3)
    assert np.sum(f_hz * power) / np.sum(power) == pytest.approx(5.0, abs=0.3)


def test_more_noise_for_less_snr() -> None:
    assert noise_density(10.0) == pytest.approx(noise_density(20.0) * np.sqrt(10.0))

"""The scores themselves: closed forms of toe error and of the split into slow and fast."""

from __future__ import annotations

import numpy as np
import pytest

from companion.evaluation.metrics import Scored, range_summary, slow_part, toe_summary


def test_toe_error_is_the_divergence_that_shortened_the_range() -> None:
    scored = Scored(1.98, np.array([0.0]), np.array([60.0]), np.array([1 / 60.0 + 4.5e-3 / 1.98]))
    assert scored.toe_error_rad[0] == pytest.approx(4.5e-3)
    assert scored.range_m[0] == pytest.approx(52.8, abs=0.05)


def test_slow_and_fast_parts_split_at_the_cutoff() -> None:
    t = np.arange(600) * 0.1 + np.random.default_rng(0).uniform(-0.01, 0.01, 600)  # shots: near even, never quite
    middle = (t > 5) & (t < 55)
    for hz, low, high in ((0.05, 0.97, 1.01), (0.5, 0.6, 0.8), (3.7, 0.0, 0.12)):
        wave = np.sin(2 * np.pi * hz * t)
        gain = np.linalg.norm(slow_part(t, wave, 0.5)[middle]) / np.linalg.norm(wave[middle])
        assert low <= gain <= high, hz


def test_a_straight_line_is_slow_to_its_very_ends() -> None:
    t = np.linspace(0, 10, 101)
    np.testing.assert_allclose(slow_part(t, 3 * t - 1, 0.5), 3 * t - 1, atol=1e-9)


def test_ranges_beyond_infinity_are_counted_and_never_a_number() -> None:
    inverse = np.array([1 / 61.0, -0.001, -0.002, 1 / 60.0])
    scored = Scored(1.98, np.arange(4.0), np.full(4, 60.0), inverse)
    entry = range_summary(scored)["60"]
    assert isinstance(entry, dict)
    assert entry["beyond"] == 2
    assert entry["rms"] is None
    assert entry["p95"] is None
    assert toe_summary(scored)["n"] == 4

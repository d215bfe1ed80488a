"""Few matches, all of them right: none is refused for the scatter that a plane through them leaves."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.stereo.inverse_depth import consistent
from companion.core.stereo.triangulation import Depths

SIGMA_RAD = 1e-4


def _depths(count: int, seed: int) -> Depths:
    """Matches at 50 m with Gaussian parallaxes of the stated sigma."""
    rng = np.random.default_rng([seed, count])
    sigma = np.full(count, SIGMA_RAD)
    parallax_rad = SIGMA_RAD * rng.standard_normal(count)
    return Depths(np.full(count, 0.02), sigma, rng.uniform(-0.35, 0.35, (count, 2)), parallax_rad, sigma)


@pytest.mark.parametrize("count", [4, 5, 6, 8, 12, 25])
def test_right_matches_stay_however_few_there_are(count: int) -> None:
    """The plane has three parameters: at four matches the median departure says nothing of their noise."""
    refused = [count - consistent(_depths(count, seed), 1e-4).size for seed in range(200)]
    assert np.mean(np.array(refused) > 0) <= 0.01


@pytest.mark.parametrize("count", [12, 25])
def test_a_wrong_match_among_few_is_refused(count: int) -> None:
    """Its parallax is off by 40 sigma."""
    for seed in range(50):
        depths = _depths(count, seed)
        depths.parallax_rad[0] += 40.0 * SIGMA_RAD
        assert 0 not in consistent(depths, 1e-4)

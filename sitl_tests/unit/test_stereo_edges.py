"""An edge near the axis: which of two surfaces is asked for, a few matches cannot tell, and the sigma says so."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.stereo.inverse_depth import InverseDepthEstimate, RangeProduct, robust_inverse_depth
from companion.core.stereo.triangulation import Depths

NEAR_M, FAR_M = 55.0, 63.0
SIGMA_PM = 5e-5
MATCHES, LEAST = 150, 8


def _walls(seed: int, edge: float, wrong: int = 0) -> Depths:
    """Two walls that meet at a tangent to the right of the axis, and some matches that are wrong by 30 sigmas or so."""
    rng = np.random.default_rng(seed)
    tangent = rng.uniform(-0.35, 0.35, (MATCHES, 2))
    inverse = np.where(tangent[:, 0] < edge, 1.0 / NEAR_M, 1.0 / FAR_M) + SIGMA_PM * rng.standard_normal(MATCHES)
    inverse[rng.choice(MATCHES, wrong, replace=False)] += 30.0 * SIGMA_PM * rng.standard_normal(wrong)
    return Depths(inverse, np.full(MATCHES, SIGMA_PM), tangent, np.zeros(MATCHES), np.zeros(MATCHES))


def _ahead(depths: Depths) -> InverseDepthEstimate:
    estimate = robust_inverse_depth(depths, RangeProduct.MEDIAN, LEAST, one_surface=False)
    assert estimate is not None
    return estimate


@pytest.mark.slow
def test_of_ranges_to_a_wall_that_ends_near_the_axis_few_lie_beyond_what_they_state() -> None:
    edges = np.random.default_rng(0).uniform(-0.1, 0.1, 300)
    wrong = 0
    for seed, edge in enumerate(edges.tolist()):
        estimate, true_pm = _ahead(_walls(seed, edge)), 1.0 / (NEAR_M if edge > 0.0 else FAR_M)
        off_pm = abs(estimate.inverse_pm - true_pm)
        wrong += off_pm > 5.0 * estimate.sigma_pm and off_pm > 0.05 * true_pm
    assert wrong <= 9  # without the second innermost departure: 22


def test_a_wall_with_one_wrong_match_in_twenty_keeps_its_sigma_nearly_always() -> None:
    estimates = [_ahead(_walls(seed, 1.0, wrong=7)) for seed in range(200)]
    assert sum(each.sigma_pm > 3.0 * SIGMA_PM / np.sqrt(MATCHES) for each in estimates) <= 20
    assert all(abs(each.inverse_pm - 1.0 / NEAR_M) < 4.0 * each.sigma_pm for each in estimates)


def _over_roofs(seed: int, roof: float, edge: float) -> InverseDepthEstimate | None:
    """Ground with a roof a fifth nearer, whose half width is ``roof``, its edge ``edge`` to the right of the axis."""
    rng = np.random.default_rng(seed)
    tangent = rng.uniform(-0.35, 0.35, (MATCHES, 2))
    on_roof = (np.abs(tangent[:, 0] - edge + roof) < roof) & (np.abs(tangent[:, 1]) < roof)
    inverse = np.where(on_roof, 1.25, 1.0) / FAR_M + SIGMA_PM * rng.standard_normal(MATCHES)
    depths = Depths(inverse, np.full(MATCHES, SIGMA_PM), tangent, np.zeros(MATCHES), np.zeros(MATCHES))
    return robust_inverse_depth(depths, RangeProduct.MEDIAN, LEAST)


def test_a_roof_under_the_axis_is_the_range_though_most_matches_are_on_the_ground() -> None:
    """One plane through all read the ground around it: 25 % too far, at 80 sigma."""
    estimates = [estimate for seed in range(40) if (estimate := _over_roofs(seed, 0.15, 0.15)) is not None]
    assert all(abs(each.inverse_pm - 1.25 / FAR_M) < 5.0 * each.sigma_pm for each in estimates)
    assert sum(each.sigma_pm < 0.01 * each.inverse_pm for each in estimates) >= 36


@pytest.mark.slow
def test_of_ranges_to_ground_beside_a_roof_few_lie_beyond_what_they_state() -> None:
    edges = np.random.default_rng(1).uniform(-0.1, 0.1, 300)
    wrong = 0
    for seed, edge in enumerate(edges.tolist()):
        estimate, true_pm = _over_roofs(seed, 0.2, edge), (1.25 if edge > 0.0 else 1.0) / FAR_M
        assert estimate is not None
        off_pm = abs(estimate.inverse_pm - true_pm)
        wrong += off_pm > 5.0 * estimate.sigma_pm and off_pm > 0.05 * true_pm
    assert wrong <= 9  # of one plane through all: 180


def test_rays_that_meet_behind_the_cameras_give_no_range_and_spoil_none() -> None:
    """A toe wrong by a radian: sigmas below and near 0, whose inverse squares made a singular fit of them."""
    walls = _walls(1, 1.0)
    behind = Depths(-walls.inverse_pm, -walls.sigma_pm, walls.tangent, walls.parallax_rad, walls.sigma_rad)
    behind.sigma_pm[::3] = 0.0
    assert robust_inverse_depth(behind, RangeProduct.MEDIAN, LEAST) is None
    both = Depths(
        *(
            np.concatenate([getattr(walls, name), getattr(behind, name)])
            for name in ("inverse_pm", "sigma_pm", "tangent", "parallax_rad", "sigma_rad")
        )
    )
    mixed, alone = (robust_inverse_depth(each, RangeProduct.MEDIAN, LEAST) for each in (both, walls))
    assert mixed is not None
    assert alone is not None
    assert mixed.inverse_pm == alone.inverse_pm


def _shore(seed: int, begins: float, tilt: float) -> InverseDepthEstimate | None:
    """Water without texture below the axis, FAR_M away, and a shore that rises from the tangent ``begins`` on."""
    rng = np.random.default_rng(seed)
    tangent = np.column_stack([rng.uniform(begins, 0.4, 60), rng.uniform(-0.3, 0.3, 60)])
    inverse = (1.0 + tilt * (tangent[:, 0] - begins)) / FAR_M + SIGMA_PM * rng.standard_normal(60)
    return robust_inverse_depth(
        Depths(inverse, np.full(60, SIGMA_PM), tangent, np.zeros(60), np.zeros(60)), RangeProduct.MEDIAN, LEAST
    )


def test_a_plane_continued_to_where_nothing_was_seen_has_the_gap_in_its_sigma() -> None:
    """The shore's plane goes on below the water: 20 % off, at 40 sigma of the matches alone."""
    for seed, tilt in enumerate((0.3, 0.6, 1.0)):
        estimate = _shore(seed, 0.2, tilt)
        assert estimate is not None
        assert abs(estimate.inverse_pm - 1.0 / FAR_M) < 2.0 * estimate.sigma_pm
        assert estimate.sigma_pm > 0.1 * estimate.inverse_pm


def test_an_axis_beside_few_matches_by_less_than_they_lie_apart_is_no_gap() -> None:
    estimates = [_shore(seed, 0.02, 0.3) for seed in range(40)]
    assert sum(each is not None and each.sigma_pm < 0.01 * each.inverse_pm for each in estimates) >= 38

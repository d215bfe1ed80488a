"""Blur and its minima against their numpy versions."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.trigger.blur import BlurForecast, _image_motion_maps, _without_cameras, streaks
from companion.core.trigger.instants import still_instants
from companion.params.files import load_airframe
from companion.records import Floats
from sitl_tests.reference.kernels import trigger as plain

STEP_NS = 2_000_000


def _spread(rng: np.random.Generator, n: int, size: float) -> Floats:
    root = size * rng.standard_normal((n, 2, 2))
    return root @ root.swapaxes(1, 2)


def _forecast(rng: np.random.Generator, n: int, maps: object) -> BlurForecast:
    t_s = 1e-9 * STEP_NS * np.arange(n)
    rates = np.stack([np.sin(rng.uniform(20, 60) * t_s + rng.uniform(0, 6)) for _ in range(2)], axis=1)
    covariance, nearness = _spread(rng, n, 0.01), float(rng.choice([0.0, 0.02]))
    timing = (1e5 * rng.standard_normal(2), np.abs(1e5 * rng.standard_normal(2)))
    rest = (rng.standard_normal(3), 20.0 * rng.standard_normal(3), nearness)
    arguments = (rates, covariance, 1e-9 * STEP_NS, *timing, *rest)
    got, expected = streaks(maps, *arguments), plain.streak_px(maps, *arguments)
    for name, actual, desired in zip(got._fields, got, expected, strict=True):
        np.testing.assert_allclose(actual, desired, rtol=1e-10, atol=1e-12 * np.abs(desired).max(), err_msg=name)
    image, per_rate, acceleration, rms = got
    t_ns = 10**12 + STEP_NS * np.arange(n)
    spring = -1e3 * rng.random((2, 2))
    return BlurForecast(t_ns, image, per_rate, acceleration, covariance, _spread(rng, n, 1e-4), spring, rms)


@pytest.mark.parametrize("cameras", ["none", "nadir-2m", "forward-2m"])
def test_blur_and_its_minima_are_those_of_numpy(cameras: str) -> None:
    maps, instant_count = _without_cameras(), 0
    if cameras != "none":
        airframe = load_airframe(cameras)
        assert airframe.left_camera is not None
        assert airframe.right_camera is not None
        maps = _image_motion_maps(airframe, (airframe.left_camera, airframe.right_camera))
    for seed in range(25):
        rng = np.random.default_rng(seed)
        blur = _forecast(rng, int(rng.integers(2, 150)), maps)
        from_ns = int(blur.t_host_ns[0]) + int(rng.integers(0, 50)) * STEP_NS
        expected = plain.minima(
            blur.t_host_ns, from_ns, blur.motion, blur.motion_per_rate, blur.acceleration_radps2,
            blur.rate_covariance, blur.q_covariance, blur.spring, blur.rms_px,
        )  # fmt: skip
        instants = still_instants(blur, from_ns)
        assert len(instants) == len(expected)
        for instant, (t_ns, sigma_ns, px) in zip(instants, expected, strict=True):
            assert instant.t_host_ns - blur.t_host_ns[0] == pytest.approx(t_ns, abs=1.0)
            assert instant.sigma_ns == pytest.approx(sigma_ns, abs=1.0, rel=1e-6)
            assert instant.blur_px == pytest.approx(px, rel=1e-7, abs=1e-12)
        instant_count += len(instants)
    assert instant_count > 20

"""The slipping spring in C against its plain version."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.wing.effects.damping.hysteresis import derivatives_along, stretch_along
from sitl_tests.reference.kernels import springs as plain


@given(st.integers(0, 2**32), st.integers(0, 300), st.integers(1, 3), st.floats(0.0, 3.0))
def test_a_spring_slips_as_the_plain_version_does(seed: int, count: int, rows: int, reach_m: float) -> None:
    deflection_m = np.cumsum(np.random.default_rng(seed).standard_normal((rows, count)), axis=1)
    np.testing.assert_array_equal(stretch_along(deflection_m, reach_m), plain.stretch_along(deflection_m, reach_m))


@given(st.integers(0, 2**32), st.integers(1, 120), st.integers(1, 2), st.floats(0.0, 3.0))
def test_a_stretch_comes_from_the_path_since_it_slipped(seed: int, count: int, rows: int, reach_m: float) -> None:
    rng = np.random.default_rng(seed)
    deflection_m, weight = np.cumsum(rng.standard_normal((rows, count)), axis=1), rng.uniform(0.1, 1.0, count)
    reaches_m = np.array([reach_m, 0.5])
    expected = plain.derivatives_along(deflection_m, reaches_m, weight)
    np.testing.assert_allclose(derivatives_along(deflection_m, reaches_m, weight), expected, atol=1e-4)


def test_a_path_with_gaps_in_memory_is_refused() -> None:
    with pytest.raises(TypeError, match="slipping_spring"):
        stretch_along(np.zeros((2, 40))[:, ::2], 1.0)

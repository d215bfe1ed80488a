"""The slipping spring in C against its plain version."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.wing.effects.damping.hysteresis import stretch_along
from sitl_tests.reference.kernels import springs as plain


@given(st.integers(0, 2**32), st.integers(0, 300), st.integers(1, 3), st.floats(0.0, 3.0))
def test_a_spring_slips_as_the_plain_version_does(seed: int, count: int, rows: int, reach_m: float) -> None:
    deflection_m = np.cumsum(np.random.default_rng(seed).standard_normal((rows, count)), axis=1)
    np.testing.assert_array_equal(stretch_along(deflection_m, reach_m), plain.stretch_along(deflection_m, reach_m))


def test_a_path_with_gaps_in_memory_is_refused() -> None:
    with pytest.raises(TypeError, match="slipping_spring"):
        stretch_along(np.zeros((2, 40))[:, ::2], 1.0)

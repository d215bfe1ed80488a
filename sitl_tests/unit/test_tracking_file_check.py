"""Sentences about constants of the airframe file that a flight contradicts."""

from __future__ import annotations

import pytest

from companion.core.tracking.file_check import _sentence


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("slope.further_symmetric.0", "slope factor of further symmetric 0 is +0.3 rad/m"),
        ("further_symmetric.0", "frequency of further symmetric 0 is +0.3 Hz"),
        ("second_antisymmetric", "frequency of second antisymmetric is +0.3 Hz"),
        ("slope.symmetric", "slope factor of symmetric is +0.3 rad/m"),
        ("left.kz", "left vertical scale is +30 %"),
    ],
)
def test_a_constant_that_is_off_is_called_by_its_name(name: str, said: str) -> None:
    assert _sentence(name, 0.3, 0.05).startswith(said)

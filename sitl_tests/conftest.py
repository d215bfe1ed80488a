"""What holds for all tests."""

from __future__ import annotations

import functools
import sys
from collections.abc import Iterator

import pytest
from hypothesis import settings

# the first call may have to compile, and a shared machine may stop for seconds: time is no verdict
settings.register_profile("spanwise", deadline=None)
settings.load_profile("spanwise")


@pytest.fixture(scope="session", autouse=True)
def _textures_are_made_once() -> Iterator[None]:
    """The noise that surfaces are painted with follows from a seed alone, and is a quarter of what a renderer costs."""
    texture = sys.modules.get("companion.sim.texture")  # none of the tests chosen may need it
    with pytest.MonkeyPatch.context() as patch:
        if texture is not None:
            patch.setattr(texture, "noise_period", functools.lru_cache(maxsize=8)(texture.noise_period))
        yield

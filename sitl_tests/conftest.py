"""Fixtures of all tests."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

try:
    import companion.native.library
except Exception:  # missing, or older than its sources
    ROOT = Path(__file__).resolve().parents[1]
    subprocess.run([sys.executable, "setup.py", "-q", "build_ext", "--inplace"], cwd=ROOT, check=True)
    import companion.native.library  # noqa: F401

# the first call may have to compile, and a shared machine may stop for seconds: time is no verdict
settings.register_profile("spanwise", deadline=None)
settings.load_profile("spanwise")
os.environ.setdefault("DEPTHAI_TELEMETRY", "0")  # tests import the library themselves


@pytest.fixture(scope="session", autouse=True)
def _textures_are_made_once() -> Iterator[None]:
    """The noise that surfaces are painted with follows from a seed alone, and is a quarter of what a renderer costs."""
    texture = sys.modules.get("companion.sim.vision.texture")  # none of the tests chosen may need it
    with pytest.MonkeyPatch.context() as patch:
        if texture is not None:
            patch.setattr(texture, "noise_period", functools.lru_cache(maxsize=8)(texture.noise_period))
        yield


@pytest.fixture(autouse=True)
def _no_defect_is_contained(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A defect that the service survives fails the test all the same, unless the test makes it (mark defect)."""
    containment = sys.modules.get("companion.core.containment")
    if containment is None or request.node.get_closest_marker("defect"):
        yield
        return
    refuse, raised = containment._refused, []

    def refused(state: Any, record: Any, error: Exception) -> Any:
        raised.append(error)
        return refuse(state, record, error)

    monkeypatch.setattr(containment, "_refused", refused)
    yield
    if raised:
        raise raised[0]

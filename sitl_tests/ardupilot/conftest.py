"""Where the executables are: ``--arduplane``, ``--arducopter``, ``--ardurover``, or ``SPANWISE_ARDUPLANE`` ..."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_VEHICLES = ("arduplane", "arducopter", "ardurover")


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("ardupilot", "real ArduPilot executables (SITL)")
    for name in _VEHICLES:
        group.addoption(f"--{name}", metavar="FILE", help=f"an {name} executable built for SITL")


def _executable(config: pytest.Config, name: str) -> Path:
    variable = f"SPANWISE_{name.upper()}"
    # the option exists only where pytest was started on this folder
    program = config.getoption(name, default=None) or os.environ.get(variable)
    if not program:
        pytest.skip(f"no {name} executable: give --{name} FILE or set {variable} (sitl_tests/README.md)")
    path = Path(program)
    if not os.access(path, os.X_OK):
        pytest.fail(f"{program} is not an executable file (--{name} or {variable})")
    return path


@pytest.fixture(scope="session")
def arduplane(request: pytest.FixtureRequest) -> Path:
    return _executable(request.config, "arduplane")


@pytest.fixture(scope="module", params=["arducopter", "ardurover"])
def proximity_vehicle(request: pytest.FixtureRequest) -> Path:
    """One after the other, the vehicles that have proximity."""
    return _executable(request.config, str(request.param))

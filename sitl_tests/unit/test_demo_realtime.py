"""The demo in real time: what its aircraft's process is given is what that takes, and its end is an error."""

from __future__ import annotations

import inspect
import multiprocessing
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from companion.cli.steps import demo_realtime
from companion.errors import DeviceError
from companion.params.files import load_airframe
from companion.sim.flight.flight import build_flight
from companion.sim.flight.worlds import FAIR


class Stillborn:
    """A process that is given what its target takes, and ends at once."""

    exitcode = 1

    def __init__(self, target: Callable[..., None], args: tuple[Any, ...], name: str) -> None:
        self.arguments = inspect.signature(target).bind(*args).arguments

    def start(self) -> None: ...

    def is_alive(self) -> bool:
        return False

    def terminate(self) -> None: ...

    def join(self) -> None: ...


def test_an_aircraft_that_ends_without_a_report_ends_the_demo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    context = SimpleNamespace(Pipe=multiprocessing.Pipe, Process=Stillborn)
    monkeypatch.setattr(demo_realtime.multiprocessing, "get_context", lambda _: context)
    flight = build_flight(load_airframe("nadir-2m"), 1, 5.0, world=FAIR)
    with demo_realtime._vehicle(flight, 1, tmp_path) as vehicle:
        assert vehicle.aircraft.arguments["conditions"] is FAIR  # type: ignore[attr-defined]
        with pytest.raises(DeviceError, match=r"aircraft's process has ended \(1\)"):
            vehicle.ended()

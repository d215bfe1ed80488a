"""Our adapter keeps the simulated autopilot's time over a link that loses frames, and over its restart."""

from __future__ import annotations

import pytest

from companion.params.files import load_airframe
from companion.sim.flight.flight import build_flight
from tools.bench import clock_flight


@pytest.mark.slow
def test_the_bound_is_true_and_narrow_and_a_restart_is_over_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock_flight, "REBOOT_S", 30.0)
    flight = build_flight(clock_flight._light(load_airframe("nadir-2m")), 2, 61.0)
    row = clock_flight._row("", flight, 400, 0.0, 60.0)
    assert float(row["true"]) >= 0.999
    assert float(row["excess_ms"]) <= 0.3
    assert float(row["error_ms"]) <= 0.3
    assert float(row["lock_s"]) < 3.0

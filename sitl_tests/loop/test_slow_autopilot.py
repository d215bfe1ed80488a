"""An autopilot at ArduPlane's default loop of 50 Hz: the operator learns what to change, the wing is tracked anyway."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.params.files import load_airframe
from companion.records import Deflection, Notice, Reject, Validity
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.simulated_service import EPOCH_NS, MS, SimulatedService

FLOWN_S = 14.0


@pytest.mark.slow
def test_forty_samples_a_second_are_told_with_the_remedy_and_tracked_with() -> None:
    flight = build_flight(load_airframe("nadir-2m"), 3, FLOWN_S + 1.0)
    blind = dataclasses.replace(flight.airframe, left_camera=None, right_camera=None)
    service = SimulatedService(flight, airframe=blind, parameters={"SCHED_LOOP_RATE": 50.0})
    service.fly(FLOWN_S)
    service.close()
    heard = "".join(service.world.report()["statustexts"])
    highest_hz = max(blind.wing.symmetric.frequency_hz.value, blind.wing.antisymmetric.frequency_hz.value)
    assert f"{highest_hz:.1f} Hz mode needs" in heard
    assert "set SCHED_LOOP_RATE 100, reboot" in heard
    assert any("tracker restarted" in notice.text and "root" in notice.text for notice in service.tape.of(Notice))
    tracker = service.loop.state.tracker
    assert service.loop.state.validity in (Validity.TRACKING, Validity.SETTLING)
    errors, spread = [], []
    for back_ms in range(500, 900, 10):
        t_ns = tracker._next_ns - back_ms * MS
        deflection = tracker.smooth(t_ns)
        assert not isinstance(deflection, Reject)
        assert isinstance(deflection, Deflection)
        truth = flight.truth.at(t_ns - EPOCH_NS)
        errors.append(deflection.slope_rad - truth.slope_rad)
        spread.append(truth.slope_rad)
    moving = np.std(np.array(errors), axis=0) / np.std(np.array(spread), axis=0)
    print(f"error of the moving slope over its own: left {moving[0]:.3f}, right {moving[1]:.3f}")
    assert (moving < 0.15).all()

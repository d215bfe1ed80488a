"""The plan of a flight in which nothing moves but what the test moves, for closed forms."""

from __future__ import annotations

from companion.sim.flight.aircraft import AltitudeStep, FlightPlan


def still_plan(duration_s: float) -> FlightPlan:
    """Straight and level at 60 m without any wobble."""
    return FlightPlan(duration_s, 22.0, 0.0, (AltitudeStep(0.0, 60.0),), (), (), 0.0, 0.0, 0.0, 0.0)

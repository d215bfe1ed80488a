"""A root at ten samples a second, which an airframe file may state, still makes epochs."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.tracking.tracker import WingTracker
from companion.params.settings import Settings
from companion.records import Station
from sitl_tests.unit.tracking_samples import batch, plain_airframe, swinging

MS = 1_000_000


@pytest.mark.parametrize(("rate_hz", "least"), [(10, 0.3), (20, 0.6), (50, 0.9), (1000, 0.9)])
def test_a_slow_root_is_covered(rate_hz: int, least: float) -> None:
    """At 10 Hz two samples lie further apart than the reorder window waits: some epochs go without."""
    airframe = plain_airframe()
    slow = dataclasses.replace(airframe, root=dataclasses.replace(airframe.root, rate_hz=float(rate_hz)))
    tracker = WingTracker(slow, Settings())
    t_ns, values = swinging(5.0, 0.01)
    every, covered = 1000 // rate_hz, []
    epochs_of = tracker._front_end.epochs

    def noted(*arguments: int) -> object:
        epochs = epochs_of(*arguments)
        covered.append(epochs.root_covered)
        return epochs

    tracker._front_end.epochs = noted  # type: ignore[method-assign, assignment]
    for first in range(0, len(t_ns), 20):
        span = slice(first, first + 20)
        for station in (Station.LEFT, Station.RIGHT):
            tracker.add(batch(station, t_ns[span], values[station][span]))
        at = np.arange(first, first + 20)[np.arange(first, first + 20) % every == 0]
        if len(at):
            tracker.add(batch(Station.ROOT, t_ns[at], values[Station.ROOT][at]))
        tracker.advance(int(t_ns[first]) + 30 * MS)
    assert np.concatenate(covered)[250:].mean() > least

"""Averaging cells: when a tip's first moment tells something of its bending."""

from __future__ import annotations

import numpy as np
import pytest

from companion.core.mode.layout import M_LEFT, M_RIGHT, Z_LEFT, Z_RIGHT, make_layout
from companion.core.mode.rigid import FrontEnd
from companion.core.mode.stream import Stream
from companion.records import Station
from sitl_tests.unit.mode_samples import EPOCH_NS, MS, batch, plain_airframe, swinging

STEP_NS = 4 * MS


@pytest.mark.parametrize(("shaken_hz", "share"), [(0.0, 1.0), (2.0, 1.0), (90.0, 0.2)])
def test_moments_count_where_the_root_moves_as_its_means_say(shaken_hz: float, share: float) -> None:
    """A support that shakes faster than cells resolve moves the wing inside a cell; a slow or quiet one does not."""
    airframe = plain_airframe()
    t, values = swinging(1.2, 0.005)
    streams = tuple(Stream(airframe.sensor(station)) for station in Station)
    for station, v in values.items():
        v[:, 2] += 3.0 * np.sin(2 * np.pi * shaken_hz * (t - EPOCH_NS) * 1e-9)
        streams[station].add(batch(station, t, v), 0)
    cells = FrontEnd(make_layout(airframe), (streams[0], streams[1], streams[2])).cells(
        EPOCH_NS + 25 * STEP_NS, STEP_NS, 250
    )
    assert cells.present[:, [Z_LEFT, Z_RIGHT]].all()
    heard = cells.present[:, [M_LEFT, M_RIGHT]].mean()
    assert heard == 1.0 if share == 1.0 else heard < share

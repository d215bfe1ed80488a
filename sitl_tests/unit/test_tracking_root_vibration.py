"""The root's vibration is told from blows; an engine's in calm air costs no ranges."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.tracking.root_vibration import RootVibration
from companion.records import Bools, Floats
from companion.sim.flight.aircraft import FlightPlan
from companion.sim.flight.worlds import WORLDS
from tools.bench import world_flight
from tools.bench.world_rows import CampaignRow

STEP_NS, SECOND = 4_000_000, 250
CALM = 0.05  # of the airframe's gusts


def _noted(vibration: RootVibration, first_ns: int, variance: Floats) -> Bools:
    vibration.note(first_ns, variance)
    return vibration.includes(variance)


def _judged(vibration: RootVibration, variance: Floats) -> Bools:
    """Answers for epochs (n,), ten at a time."""
    return np.concatenate([
        _noted(vibration, 1 + STEP_NS * first, variance[first : first + 10]) for first in range(0, len(variance), 10)
    ])  # fmt: skip


def test_motion_that_goes_on_is_vibration_after_three_blocks() -> None:
    variance = np.random.default_rng(1).chisquare(2, 10 * SECOND)
    vibrates = _judged(RootVibration(), variance)
    assert not vibrates[: SECOND // 2].any()
    assert vibrates[SECOND:].mean() > 0.99


def test_a_blow_is_none_whether_the_root_vibrates_or_not() -> None:
    for level in (0.0, 1.0):
        variance = level * np.random.default_rng(2).chisquare(2, 10 * SECOND)
        for second in (4, 6):  # two in five seconds
            variance[second * SECOND + 7 : second * SECOND + 12] = 400.0
        vibrates = _judged(RootVibration(), variance)
        assert not vibrates[variance == 400.0].any()
        assert vibrates[2 * SECOND :][variance[2 * SECOND :] < 400.0].mean() > 0.99


@pytest.mark.slow
def test_a_petrol_engine_in_calm_air_drowns_no_wing(monkeypatch: pytest.MonkeyPatch) -> None:
    """The root's vibration was counted as load: the deflection went to 79 mm, and half of the ranges were withheld."""
    rough = WORLDS["rough"]
    calm = dataclasses.replace(rough, weather=dataclasses.replace(rough.weather, deflection_ratio=(CALM, CALM)))
    monkeypatch.setitem(WORLDS, "rough", calm)  # type: ignore[arg-type]
    plan = FlightPlan(
        26.0, heave_wobble_mps2=0.08, roll_wobble_rad=0.003, pitch_wobble_rad=0.0016, yaw_wobble_rad=0.0016
    )
    monkeypatch.setattr(CampaignRow, "plan", lambda row: plan)
    row = CampaignRow("rough", "forward-2m", "vertical")
    flown = world_flight.fly(row, row.first_number + 21)
    columns = dict(zip(flown["columns"], np.array(flown["judged"]).T, strict=True))
    settled = (columns["t_s"] > 15.0) & (columns["toe_sigma"] > 0.0)
    trusted = columns["trusted"][settled] > 0.5
    assert trusted.mean() > 0.6  # ahead nothing is near enough for the others
    error = (columns["toe"] - columns["true_toe"])[settled][trusted] / columns["toe_sigma"][settled][trusted]
    assert np.abs(error).max() < 4.0

"""A real ArduPlane lands the flexible aeroplane; and what it is told and asked, without it."""

from __future__ import annotations

import json
import math
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.evaluation.landing.landing_rows import RangeKind
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.sim.landing.aerodynamics import Controls
from companion.sim.landing.autolander import LandingStage
from companion.sim.landing.landing_flight import LandingFlight, TrueRange
from companion.sim.landing.trim import trimmed
from sitl_tests.ardupilot.plane_landing import IMAGES_HZ, PlanePilot, fly_with_plane
from sitl_tests.ardupilot.plane_link import circuit

AIRFRAME = load_airframe("nadir-2m")


class FakeLink:
    """An ArduPlane that holds its trim and says what it is told to say, each text when a frame's number has come."""

    def __init__(self, controls: Controls, texts: list[tuple[int, str]]) -> None:
        self._controls, self._coming = controls, deque(texts)
        self.frames = 0
        self.lines: list[bytes] = []
        self.ranges: list[float | None] = []
        self.texts: list[tuple[float, str]] = []

    def exchange(self, line: bytes) -> Controls:
        self.lines.append(line)
        self.frames += 1
        return self._controls

    def talk(self, t_s: float, range_m: float | None) -> None:
        self.ranges.append(range_m)
        while self._coming and self._coming[0][0] <= self.frames:
            self.texts.append((t_s, self._coming.popleft()[1]))


def flown(texts: list[tuple[int, str]], seconds: float) -> tuple[LandingFlight, Any]:
    """A landing flown by a fake ArduPlane."""
    landing = LandingFlight(AIRFRAME, 3, gusts=False)
    link: Any = FakeLink(trimmed(landing.aircraft.plane, landing.approach.airspeed_mps).controls, texts)
    landing.pilot = PlanePilot(link, landing)
    while landing.now_ns < seconds * 1e9 and not landing.over:
        landing.advance(61.0)
    return landing, link


def test_the_mission_takes_off_circles_and_lands_at_the_origin() -> None:
    items = circuit(900.0, 570.0, 60.0, -1.5)
    commands = [item.command for item in items]
    assert commands[1] == mavlink.MAV_CMD_NAV_TAKEOFF
    assert commands[-1] == mavlink.MAV_CMD_NAV_LAND
    assert [item.seq for item in items] == list(range(len(items)))
    home, land, slope = items[0], items[-1], items[-2]
    assert (land.x, land.y) == (home.x, home.y)
    assert land.z == -1.5
    assert (home.x - slope.x) * 1e-7 * 6_378_137.0 * math.pi / 180.0 == pytest.approx(570.0, rel=1e-3)


def test_every_step_of_the_flight_is_a_frame_and_they_are_one_motion() -> None:
    """Velocity is the integral of the specific force turned into NED, plus gravity; no frame is left out."""
    landing, link = flown([], 1.0)
    rows = [json.loads(line) for line in link.lines]
    assert len(rows) == len(landing.truth.knots) - 1 - 10  # the newest period has not been asked for
    assert np.allclose(np.diff([row["timestamp"] for row in rows]), 0.002, atol=2e-6)
    pitch = np.array([row["attitude"][1] for row in rows])
    force = np.array([row["imu"]["accel_body"] for row in rows])
    sink_change = -np.sin(pitch) * force[:, 0] + np.cos(pitch) * force[:, 2] + 9.80665
    gained = np.cumsum(0.001 * (sink_change[1:] + sink_change[:-1]))
    sink = np.array([row["velocity"][2] for row in rows])
    assert np.abs(sink[1:] - sink[0] - gained).max() < 2e-3
    assert set(link.ranges) == {61.0}


def test_the_stage_is_what_arduplane_says() -> None:
    landing, _ = flown(
        [(100, "Landing glide slope 6.0 degrees"), (200, "Flare 3.4m sink=1.76 speed=17.3 dist=55.8")], 1.0
    )
    assert landing.pilot.stage is LandingStage.FLARE
    assert landing.flare is not None
    assert landing.flare.t_s == pytest.approx(0.4, abs=0.05)
    landing, _ = flown([(100, "Landing aborted, climbing to 42m")], 60.0)
    assert landing.pilot.stage is LandingStage.GO_AROUND
    assert "climbing to 42m" in landing.pilot.why
    assert landing.now_ns < 4e9, "a flight ends soon after its go-around"


def test_a_flight_that_begins_elsewhere_is_the_same_flight() -> None:
    """Begun at the state that it would have taken by itself, a landing is equal to the last bit."""
    usual = LandingFlight(AIRFRAME, 5, gusts=True)
    start = trimmed(usual.aircraft.plane, usual.approach.airspeed_mps)
    state = start.state(usual.approach.height_m, usual.approach.start_north_m)
    other = LandingFlight(AIRFRAME, 5, gusts=True, state=state)
    for flight in (usual, other):
        source = TrueRange(flight)
        for _ in range(100):
            flight.advance(source.reading_m(flight.now_ns))
    assert np.array_equal(usual.truth.knots, other.truth.knots)


@pytest.mark.long
@pytest.mark.parametrize("kind", [RangeKind.TRUTH, RangeKind.SPANWISE])
def test_arduplane_lands_by_the_range(kind: RangeKind, arduplane: Path, tmp_path: Path) -> None:
    """It takes off, flies its circuit and lands; and by Spanwise's range as softly as by the true one."""
    settings = Settings().replace("TRG_RATE", IMAGES_HZ)
    row = fly_with_plane(arduplane, tmp_path, AIRFRAME, 1, kind, settings, gusts=False)
    assert row["outcome"] == "landed"
    assert any(text.startswith("Takeoff complete") for text in row["texts"])
    assert row["touch"]["sink_mps"] < 1.0
    assert abs(row["touch"]["north_m"]) < 60.0

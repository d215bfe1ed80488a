"""A real ArduCopter and a real Rover with our obstacle sectors as proximity sensor; rates and time on both."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.params.files import load_airframe
from companion.records import CorrectedRange, ObstacleSectors, Station
from sitl_tests.ardupilot.bench import Run
from sitl_tests.ardupilot.evidence import Tape, boot_clock, frames_ns
from sitl_tests.ardupilot.pace import skip_if_busy
from sitl_tests.ardupilot.station import COMPANION, Heard

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(600)]

SECOND_NS = 1_000_000_000
SEED, FLOWN_S = 1, 50.0
READY_S = 8.0
PROXIMITY_ID = 10
# AP_Proximity forgets a face 1 s after its last update (PROXIMITY_FACE_RESET_MS) and looks every 0.75 s
# (PROXIMITY_BOUNDARY_3D_TIMEOUT_MS); a DISTANCE_SENSOR counts only when the next one comes (AP_Proximity_MAV.cpp puts
# it into a temporary boundary first), which alive without range takes half a second at most; and ours go out after the
# smoother's lag
HELD_NS, OUT_NS = 2_250_000_000, 500_000_000
PARAMETERS = {"FRAME_CLASS": 1, "PRX1_TYPE": 2, "RNGFND1_ORIENT": 0, "AVOID_ENABLE": 0}


@dataclass
class Flown:
    run: Run
    sectors: list[Heard]
    ahead: list[Heard]
    proximity: list[Heard]
    tape: Tape


@pytest.fixture(scope="module")
def flown(proximity_vehicle: Path, tmp_path_factory: pytest.TempPathFactory) -> Flown:
    folder = tmp_path_factory.mktemp(proximity_vehicle.name)
    airframe = load_airframe("forward-2m")
    with Run(proximity_vehicle, folder, airframe, "forward-2m", PARAMETERS, SEED, FLOWN_S, eyes=True) as run:
        run.station.stream(mavlink.MAVLink_distance_sensor_message, 20)
        run.service("TRG_RATE=1")
        run.await_service(READY_S)
        run.launch()
        run.sleep_until(run.flight_ns + round(FLOWN_S * SECOND_NS))
        run.end_service()
    tape = Tape(run.recording)
    over_ns = run.flight_ns + round(FLOWN_S * SECOND_NS)
    skip_if_busy(frames_ns(run.report), tape.ticks_ns(), run.flight_ns, over_ns)
    from_autopilot = run.station.heard("DISTANCE_SENSOR", 1)
    return Flown(
        run,
        run.station.heard("OBSTACLE_DISTANCE", COMPANION),
        run.station.heard("DISTANCE_SENSOR", COMPANION),
        [entry for entry in from_autopilot if entry.message.id >= PROXIMITY_ID],
        tape,
    )


def nearest_ahead_m(sectors: ObstacleSectors) -> float | None:
    """The nearest obstacle within 22.5 degrees of straight ahead, the autopilot's sector 0."""
    ahead = [i % 72 for i in range(-4, 5)]
    obstacles_m = [float(sectors.distance_m[i]) for i in ahead if sectors.known[i] and not sectors.clear[i]]
    return min(obstacles_m, default=None)


def sent_ahead(flown: Flown) -> list[tuple[int, float]]:
    """Obstacles that the service's own recording shows as sent: instants of exposure, and distances ahead in metres."""
    sent = [(s.t_host_ns, nearest_ahead_m(s)) for s in flown.tape.of(ObstacleSectors)]
    sent += [(r.t_host_ns, r.range_m) for r in flown.tape.of(CorrectedRange) if r.trusted]
    return [(at_ns, distance_m) for at_ns, distance_m in sent if distance_m is not None]


def test_obstacle_sectors_go_out_as_the_full_circle(flown: Flown) -> None:
    assert len(flown.sectors) > 20
    for entry in flown.sectors:
        message = entry.message
        assert (len(message.distances), message.increment_f, message.frame) == (72, 5.0, mavlink.MAV_FRAME_BODY_FRD)


def test_the_vehicles_proximity_is_what_we_sent(flown: Flown) -> None:
    """Its sector ahead shows a distance that we sent as shortly before as it forgets, to the centimetre."""
    sent = sent_ahead(flown)
    ahead = [e for e in flown.proximity if e.message.orientation == 0]
    reports = [e for e in ahead if e.message.current_distance < e.message.max_distance]
    assert len(reports) > 20, "proximity ahead was never reported"
    strange = []
    for entry in reports:
        near = [d for at_ns, d in sent if 0.8 * OUT_NS < entry.at_ns - at_ns < OUT_NS + HELD_NS]
        if not any(abs(0.01 * entry.message.current_distance - d) <= 0.015 for d in near):
            strange.append((entry.message.current_distance, sorted(near)))
    assert not strange, strange[:5]
    used = {distance_m for sectors in flown.tape.of(ObstacleSectors) if (distance_m := nearest_ahead_m(sectors))}
    assert any(min(abs(0.01 * e.message.current_distance - d) for d in used) <= 0.015 for e in reports)


def test_it_sees_nothing_where_nothing_was_looked_at(flown: Flown) -> None:
    """Sectors beside and behind are unknown, and the autopilot invents nothing there."""
    behind = [e for e in flown.proximity if e.message.orientation in (2, 3, 4, 5, 6)]
    assert all(e.message.current_distance >= e.message.max_distance for e in behind)


def test_inertial_messages_come_as_fast_as_a_400_hz_loop_gives_them(flown: Flown) -> None:
    ends_ns = flown.tape.last_ns() - SECOND_NS
    rate_hz = flown.tape.rate_hz(Station.ROOT, ends_ns - 10 * SECOND_NS, ends_ns)
    assert rate_hz == pytest.approx(333.3, rel=0.02)


def test_the_boot_clock_is_inside_its_bound(flown: Flown) -> None:
    judged, outside, _ = boot_clock(flown.run.report, flown.tape)
    assert judged > 15
    assert len(outside) <= 0.001 * judged, f"ms from the earliest, from the latest, bound: {outside}"

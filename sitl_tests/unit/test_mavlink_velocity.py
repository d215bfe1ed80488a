"""Velocity over ground and the receiver's accuracy of it: from GPS_RAW_INT and GLOBAL_POSITION_INT to the record."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.decoder import Decoder
from companion.adapters.recordings.mcap.codec import dumps, loads
from companion.params.files import load_airframe
from companion.records import RawChunk, VehicleState
from companion.sim.flight.flight import build_flight
from companion.sim.flight.offline import flight_records
from companion.sim.flight.worlds import FAIR
from sitl_tests.loop.test_sim_autopilot import Peer

MS = 1_000_000
FIXED, LOST = mavlink.GPS_FIX_TYPE_3D_FIX, mavlink.GPS_FIX_TYPE_NO_FIX


def _receiver(vel_acc: int, fix: int = FIXED) -> Any:
    return mavlink.MAVLink_gps_raw_int_message(0, fix, 1, 1, 0, 80, 120, 2200, 0, 14, vel_acc=vel_acc)


def _state_after(messages: list[Any], pause_ms: int = 0) -> VehicleState:
    """The state after these messages and, so much later, velocity and attitude."""
    packer, decoder = mavlink.MAVLink(None, 3, 1), Decoder(load_airframe("nadir-2m"), component_id=191)
    beat = mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
    later = [
        mavlink.MAVLink_global_position_int_message(5000, 470000000, 80000000, 0, 0, 2200, 0, 0, 0),
        mavlink.MAVLink_vfr_hud_message(22.0, 22.0, 0, 60, 50.0, 0.0),
        mavlink.MAVLink_attitude_message(5000, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    ]
    records = []
    for at_ms, batch in ((10_000, [beat, *messages]), (10_000 + pause_ms, later)):
        frames = b"".join(message.pack(packer) for message in batch)
        records += decoder.decode_chunk(RawChunk(0, at_ms * MS, frames))
    (state,) = [record for record in records if isinstance(record, VehicleState)]
    assert state.velocity_ned_mps == pytest.approx((22.0, 0.0, 0.0))
    return state


def test_the_receivers_accuracy_comes_with_the_velocity() -> None:
    """``vel_acc`` is in mm/s; the newest counts."""
    assert _state_after([_receiver(420), _receiver(150)], 1000).velocity_sigma_mps == pytest.approx(0.15)


@pytest.mark.parametrize(
    ("messages", "pause_ms"),
    [([], 0), ([_receiver(0)], 0), ([_receiver(150, LOST)], 0), ([_receiver(150), _receiver(0)], 0)],
)
def test_no_accuracy_without_a_statement_or_a_fix(messages: list[Any], pause_ms: int) -> None:
    """The field is an extension: 0 where it is not sent."""
    assert _state_after(messages, pause_ms).velocity_sigma_mps is None


def test_an_accuracy_of_long_ago_is_not_that_of_the_velocity() -> None:
    assert _state_after([_receiver(150)], 2900).velocity_sigma_mps == pytest.approx(0.15)
    assert _state_after([_receiver(150)], 3100).velocity_sigma_mps is None


def test_a_recording_from_before_the_accuracy_is_read() -> None:
    state = _state_after([_receiver(150)])
    assert loads(VehicleState, dumps(VehicleState, state)) == state
    before = dumps(VehicleState, state).replace(b', "velocity_sigma_mps": 0.15', b"")
    assert b"sigma" not in before
    assert loads(VehicleState, before).velocity_sigma_mps is None


def test_the_simulated_receiver_states_what_its_world_draws() -> None:
    """In messages and in the records of a flight without sockets."""
    flight = build_flight(load_airframe("nadir-2m"), 4, 3.0, world=FAIR)
    peer = Peer(flight)
    peer.run(1.5)
    assert {message.vel_acc for _, message in peer.of("GPS_RAW_INT")} == {150}
    states = [record for record in flight_records(flight) if isinstance(record, VehicleState)]
    assert {state.velocity_sigma_mps for state in states} == {0.15}

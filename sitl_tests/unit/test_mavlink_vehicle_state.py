"""An autopilot's state ages, and another autopilot or a reboot begins without it."""

from __future__ import annotations

import math
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.adapters.mavlink.decode.decoder import Decoder
from companion.adapters.recordings.mcap.codec import dumps, loads
from companion.params.files import load_airframe
from companion.records import RawChunk, VehicleState

MS, S = 1_000_000, 1_000_000_000
AIRBORNE, GROUNDED = mavlink.MAV_LANDED_STATE_IN_AIR, mavlink.MAV_LANDED_STATE_ON_GROUND


class Radio:
    """A decoder, and what vehicles say to it."""

    def __init__(self) -> None:
        self._decoder = Decoder(load_airframe("nadir-2m"), component_id=191)

    def hear(self, at_ms: int, *messages: Any, system: int = 1) -> list[VehicleState]:
        """States that these messages make."""
        packer = mavlink.MAVLink(None, system, 1)
        frames = b"".join(message.pack(packer) for message in messages)
        records = self._decoder.decode_chunk(RawChunk(0, at_ms * MS, frames))
        return [record for record in records if isinstance(record, VehicleState)]


def beat(status: int = mavlink.MAV_STATE_ACTIVE) -> Any:
    return mavlink.MAVLink_heartbeat_message(1, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, status, 3)


def landed(state: int) -> Any:
    return mavlink.MAVLink_extended_sys_state_message(mavlink.MAV_VTOL_STATE_UNDEFINED, state)


def attitude(boot_ms: int) -> Any:
    return mavlink.MAVLink_attitude_message(boot_ms, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0)


AIR = mavlink.MAVLink_vfr_hud_message(20.0, 20.0, 0, 60, 50.0, -5.0)


@pytest.mark.parametrize(("silent_ms", "states"), [(2_900, 1), (3_100, 0)])
def test_a_climb_of_long_ago_is_not_that_of_the_attitude(silent_ms: int, states: int) -> None:
    radio = Radio()
    radio.hear(10_000, beat(), AIR)
    assert len(radio.hear(10_000 + silent_ms, attitude(5_000))) == states


def test_a_state_says_since_when_its_climb_is_known() -> None:
    radio = Radio()
    radio.hear(10_000, beat(), AIR)
    (state,) = radio.hear(11_500, attitude(5_000))
    assert (state.air_host_ns, state.received_host_ns) == (10_000 * MS, 11_500 * MS)
    assert loads(VehicleState, dumps(VehicleState, state)) == state
    before = dumps(VehicleState, state).replace(b', "air_host_ns": 10000000000', b"")
    assert loads(VehicleState, before).air_host_ns is None, "a recording from before"


@pytest.mark.parametrize(("climb_mps", "states"), [(-5.0, 1), (math.nan, 0)])
def test_without_an_airspeed_the_speed_over_ground_stands_in(climb_mps: float, states: int) -> None:
    """PX4 sends NaN where it has no pitot tube; attitude, climb and velocity are sound."""
    radio = Radio()
    heard = radio.hear(
        10_000, beat(), mavlink.MAVLink_vfr_hud_message(math.nan, 21.0, 0, 60, 50.0, climb_mps), attitude(5)
    )
    assert [(state.airspeed_mps, state.climb_mps, state.throttle) for state in heard] == [(21.0, -5.0, 0.6)] * states


def test_another_vehicle_is_not_on_the_ground_because_the_last_one_was() -> None:
    radio = Radio()
    (state,) = radio.hear(10_000, beat(), landed(GROUNDED), AIR, attitude(5_000))
    assert state.on_ground is True
    for second in range(11, 40):
        radio.hear(1_000 * second, beat(), system=2)
    assert radio.hear(40_000, attitude(70_000), system=2) == [], "nor has it the last one's airspeed"
    (state,) = radio.hear(40_100, AIR, attitude(70_100), system=2)
    assert state.on_ground is False


def test_a_vehicle_that_boots_again_is_no_longer_in_the_air() -> None:
    radio = Radio()
    (state,) = radio.hear(10_000, beat(), landed(AIRBORNE), AIR, attitude(60_000))
    assert state.on_ground is False
    radio.hear(20_000, attitude(3_000))
    (state,) = radio.hear(21_000, beat(mavlink.MAV_STATE_STANDBY), AIR, attitude(4_000))
    assert state.on_ground is True


def test_a_copy_by_a_slow_link_is_no_reboot() -> None:
    radio = Radio()
    radio.hear(10_000, beat(), landed(AIRBORNE), AIR, attitude(60_000))
    radio.hear(10_500, attitude(58_000))
    (state,) = radio.hear(10_600, attitude(60_600))
    assert state.on_ground is False


@pytest.mark.parametrize(("silent_s", "grounded"), [(4, True), (6, False)])
def test_a_landed_state_that_is_no_longer_told_gives_way_to_the_heartbeat(silent_s: int, grounded: bool) -> None:
    radio = Radio()
    radio.hear(10_000, beat(), landed(GROUNDED))
    (state,) = radio.hear(1_000 * (10 + silent_s), beat(), AIR, attitude(5_000))
    assert state.on_ground is grounded


@pytest.mark.parametrize(("silent_s", "moves"), [(4, False), (6, True)])
def test_a_filter_that_was_astray_long_ago_forbids_no_velocity(silent_s: int, moves: bool) -> None:
    radio = Radio()
    radio.hear(10_000, beat(), mavlink.MAVLink_ekf_status_report_message(0, 0, 0, 0, 0, 0))
    velocity = mavlink.MAVLink_global_position_int_message(5_000, 470000000, 80000000, 0, 0, 2200, 0, 0, 0)
    (state,) = radio.hear(1_000 * (10 + silent_s), velocity, AIR, attitude(5_000))
    assert (state.velocity_ned_mps is not None) is moves

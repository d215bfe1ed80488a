"""Velocity of the aircraft in body axes from what an autopilot tells, and a pair that climbs between its exposures."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from companion.core.stereo.correction import Correction
from companion.core.stereo.geometry import Rig
from companion.core.stereo.vehicle_motion import VehicleTrack, velocity_of
from companion.params.settings import Settings
from companion.records import Deflection, MatchSet, RelativeRotation, Side, VehicleState
from sitl_tests.unit.stereo_cases import bend, forward, match_set, raw_pixels

MS = 1_000_000
AT_NS = 1000 * MS
SPEED_MPS, ATTACK_RAD = 22.0, 0.05


def _state(t_ns: int, roll_rad: float, pitch_rad: float, climb_mps: float, airspeed_mps: float = 22.0) -> VehicleState:
    return VehicleState(0, t_ns, roll_rad, pitch_rad, 1.0, airspeed_mps, climb_mps, 0.5, True)


def _flying(climb_mps: float, roll_rad: float = 0.0) -> VehicleTrack:
    """Steadily, wing at a constant angle of attack."""
    track, pitch_rad = VehicleTrack(), ATTACK_RAD + np.arcsin(climb_mps / SPEED_MPS)
    for t_ns in range(0, 2 * AT_NS, 100 * MS):
        track.add(_state(t_ns, roll_rad, pitch_rad, climb_mps))
    return track


@pytest.mark.parametrize("climb_mps", [-4.0, 0.0, 3.0])
def test_the_air_meets_a_steady_climb_at_the_angle_of_attack(climb_mps: float) -> None:
    """Body axes: V (cos a, 0, sin a), whatever the climb."""
    velocity = _flying(climb_mps).motion(AT_NS).velocity_mps
    assert velocity == pytest.approx([SPEED_MPS * np.cos(ATTACK_RAD), 0.0, SPEED_MPS * np.sin(ATTACK_RAD)], abs=1e-9)


def test_a_bank_turns_the_climb_toward_the_lower_wing() -> None:
    """Rolled right by 90 degrees, body y points down: 3 m/s of climb are -3 m/s along it, with no angle of attack."""
    track = VehicleTrack()
    track.add(_state(AT_NS, np.pi / 2.0, 0.0, 3.0))
    assert track.motion(AT_NS).velocity_mps == pytest.approx([np.sqrt(22.0**2 - 9.0), -3.0, 0.0], abs=1e-9)


def test_a_state_by_itself_has_the_velocity_of_its_track() -> None:
    """Over ground where it is told: with 10 m/s of tailwind 22 m/s through the air are 32 m/s."""
    for ned in (None, (32.0 * np.cos(1.0), 32.0 * np.sin(1.0), -1.0)):
        state = dataclasses.replace(_state(AT_NS, 0.3, 0.1, 1.0), velocity_ned_mps=ned)
        track = VehicleTrack()
        track.add(state)
        assert velocity_of(state) == pytest.approx(track.motion(AT_NS).velocity_mps, abs=1e-9)
    assert np.linalg.norm(velocity_of(state)) == pytest.approx(np.hypot(32.0, 1.0))


def test_what_nobody_tells_is_uncertain() -> None:
    motion = VehicleTrack().motion(AT_NS)
    assert not motion.velocity_mps.any()
    assert np.sqrt(np.diag(motion.covariance)) == pytest.approx([3.0, 3.0, 0.5])


def test_the_covariance_is_of_wind_in_every_attitude() -> None:
    """Wind is level: banked by 90 degrees its cross part lies along body z."""
    level, banked = (_flying(0.0, roll).motion(AT_NS).covariance for roll in (0.0, np.pi / 2.0))
    assert banked[2, 2] == pytest.approx(level[1, 1], rel=0.01)
    assert np.linalg.eigvalsh(banked) == pytest.approx(np.linalg.eigvalsh(level))


def test_between_two_states_all_is_interpolated_and_old_attitudes_are_left_out() -> None:
    track = VehicleTrack()
    assert not track.motion(AT_NS).velocity_mps.any()
    assert track.attitude(AT_NS) is None
    track.add(_state(AT_NS, 0.1, 0.0, 0.0, 20.0))
    track.add(_state(AT_NS + 200 * MS, 0.3, 0.1, 2.0, 24.0))
    assert track.attitude(AT_NS + 100 * MS) == pytest.approx((0.2, 0.05))
    assert np.linalg.norm(track.motion(AT_NS + 100 * MS).velocity_mps) == pytest.approx(22.0)
    assert track.attitude(AT_NS + 5000 * MS) is None
    assert track.motion(AT_NS + 5000 * MS).velocity_mps == pytest.approx([24.0, 0.0, 0.0])


@pytest.mark.parametrize(("later_s", "on_ground"), [(4.0, True), (6.0, None)])
def test_a_vehicle_that_is_silent_may_have_taken_off(later_s: float, on_ground: bool | None) -> None:
    track = VehicleTrack()
    track.add(dataclasses.replace(_state(1_000_000_000, 0.0, 0.0, 0.0), on_ground=True))
    assert track.on_ground(1_000_000_000 + round(1e9 * later_s)) is on_ground


def test_a_climb_rate_beyond_the_airspeed_is_still_a_velocity() -> None:
    track = VehicleTrack()
    track.add(_state(AT_NS, 0.0, 0.0, 5.0, 0.0))
    assert track.motion(AT_NS).velocity_mps == pytest.approx([0.0, 0.0, -5.0])


class _Still:
    distrust = None

    def smooth(self, t_host_ns: int) -> Deflection:
        return bend((0.02, 0.02), t_ns=t_host_ns, slope_sigma_rad=2e-5)


def _seen_in_flight(rig: Rig, number: int, t_ns: tuple[int, int], velocity_mps: np.ndarray) -> MatchSet:
    """Things from 12 to 80 m ahead, each camera at its own instant."""
    rng = np.random.default_rng(number)
    points = np.column_stack([np.ones(150), rng.uniform(-0.3, 0.3, 150), rng.uniform(-0.25, 0.25, 150)])
    points *= np.where(rng.random(150) < 0.6, 40.0, rng.uniform(12.0, 80.0, 150))[:, np.newaxis]
    middle_ns = sum(t_ns) // 2
    pixels = [
        raw_pixels(rig, points - 1e-9 * (t_ns[side] - middle_ns) * velocity_mps, (0.02, 0.02))[side] for side in Side
    ]
    return match_set(pixels[0], pixels[1] + 0.1 * rng.standard_normal(pixels[1].shape), mid_exposure_ns=t_ns)


@pytest.mark.parametrize("climb_mps", [-4.0, 3.0])
@pytest.mark.parametrize("wind_mps", [(0.0, 0.0, 0.0), (-4.0, 3.0, 0.3)])
def test_a_climb_between_unequal_exposures_is_no_toe(climb_mps: float, wind_mps: tuple[float, float, float]) -> None:
    """5 ms: a climb of 4 m/s taken along body z is 20 mm of baseline, and was 3 mrad of toe before near things."""
    airframe = forward(rotation_sigma_rad=3e-4)
    rig, correction = Rig.from_airframe(airframe), Correction.create(airframe, Settings())
    correction.vehicle = _flying(climb_mps)
    velocity_mps = _flying(climb_mps).motion(AT_NS).velocity_mps + np.array(wind_mps)
    over = []
    for number in range(5):
        exposed_ns = AT_NS + number * 120 * MS
        pair = _seen_in_flight(rig, number, (exposed_ns, exposed_ns + 5 * MS), velocity_mps)
        assert not list(correction.add(pair))
        for output in correction.due(_Still(), exposed_ns + 1000 * MS):
            if isinstance(output, RelativeRotation):
                over.append(output.rotation_rad[1] / np.sqrt(output.covariance[1, 1]))
                assert abs(output.rotation_rad[1]) < 1e-3
    assert len(over) == 5
    assert np.abs(over).max() < 3.0


def test_a_roll_through_half_a_turn_is_not_upright_between_its_states() -> None:
    track = VehicleTrack()
    for t_ns, roll_rad in ((AT_NS - 50 * MS, 3.1), (AT_NS + 50 * MS, -3.1)):
        track.add(_state(t_ns, roll_rad, 0.0, 0.0))
    attitude = track.attitude(AT_NS)
    assert attitude is not None
    assert np.cos(attitude[0]) == pytest.approx(-1.0, abs=1e-6)

"""A real ArduPlane, powered and standing still: rates, time, parameters, the arming check, the cameras' command."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.params.files import load_airframe
from companion.params.settings import Settings, tunables
from companion.records import ClockName, ClockState, ServiceStatus, Station
from companion.sim.flight.flight import build_flight
from sitl_tests.ardupilot.bench import Run
from sitl_tests.ardupilot.evidence import RANGE_GOOD, RANGE_TOO_FAR, Tape, boot_clock, frames_ns, rangefinder_log
from sitl_tests.ardupilot.pace import skip_if_busy
from sitl_tests.ardupilot.physics import CAMERA_CHANNELS
from sitl_tests.ardupilot.station import COMPANION

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(600)]

SECOND_NS = 1_000_000_000
CAPTURES = 5
SEED = 1
SETTLE_S = 6.0
RECORDED_S = 25.0


@dataclass
class Ground:
    """Steps on the ground, and their results."""

    run: Run
    refused: list[str] = field(default_factory=list)
    accepted: list[str] = field(default_factory=list)
    service_ns: int = 0
    announced: int = 0
    listed: dict[int, str] = field(default_factory=dict)
    set_to: float | None = None
    set_too_far: float | None = None
    set_texts: list[str] = field(default_factory=list)
    unknown: float | None = None
    armed: int | None = None
    captures: list[tuple[int, int | None]] = field(default_factory=list)
    feedback: list[tuple[int, int]] = field(default_factory=list)
    heartbeats: list[mavlink.MAVLink_heartbeat_message] = field(default_factory=list)
    ended_ns: int = 0
    echo: list[tuple[float, int]] = field(default_factory=list)
    tape: Tape | None = None

    @property
    def recording(self) -> Tape:
        assert self.tape is not None
        return self.tape


@pytest.fixture(scope="module")
def ground(arduplane: Path, tmp_path_factory: pytest.TempPathFactory) -> Ground:
    folder = tmp_path_factory.mktemp("plane-ground")
    with Run(arduplane, folder, load_airframe("nadir-2m"), "nadir-2m", {"RNGFND1_ORIENT": 25}, SEED) as run:
        steps = Ground(run)
        station = run.station
        for kind in (mavlink.MAVLink_distance_sensor_message, mavlink.MAVLink_rangefinder_message):
            station.stream(kind, 10)
        steps.refused = prearm_texts(run)
        run.service()
        run.await_service()
        steps.service_ns = time.monotonic_ns()
        run.sleep_until(steps.service_ns + round(SETTLE_S * SECOND_NS))
        steps.announced = len(station.heard("PARAM_VALUE", COMPANION))
        exchange_parameters(steps)
        steps.accepted = prearm_texts(run)
        arm(steps)
        capture(steps)
        run.sleep_until(steps.service_ns + round(RECORDED_S * SECOND_NS))
        steps.ended_ns = time.monotonic_ns()
        steps.heartbeats = [entry.message for entry in station.heard("HEARTBEAT", COMPANION, steps.service_ns)]
        run.end_service()
    echoes = station.heard("DISTANCE_SENSOR", 1, steps.service_ns + 3 * SECOND_NS, steps.ended_ns)
    steps.echo = [(entry.message.current_distance * 0.01, entry.message.signal_quality) for entry in echoes]
    steps.feedback = [
        (entry.message.cam_idx, entry.message.img_idx) for entry in station.heard("CAMERA_FEEDBACK", component=1)
    ]
    steps.tape = Tape(run.recording)
    began_ns = steps.service_ns + round(SETTLE_S * SECOND_NS)
    skip_if_busy(frames_ns(run.report), steps.tape.ticks_ns(), began_ns, steps.ended_ns)
    return steps


def prearm_texts(run: Run) -> list[str]:
    """Objections of the autopilot to arming now; while it starts up it has no more to say than that."""
    for _ in range(20):
        began = time.monotonic_ns()
        run.station.command(mavlink.MAV_CMD_RUN_PREARM_CHECKS)
        run.sleep_until(time.monotonic_ns() + SECOND_NS)
        texts = [text for text in run.station.texts(began) if text.startswith("PreArm")]
        if not any("not initialised" in text for text in texts):
            return texts
    return ["the autopilot does not finish its start"]


def exchange_parameters(steps: Ground) -> None:
    """List, set, overreach and misname our parameters from the ground station, through the autopilot."""
    station = steps.run.station
    station.say(mavlink.MAVLink_param_request_list_message(1, COMPANION))
    count = len(list(tunables()))
    ends = time.monotonic() + 15
    while len(steps.listed) < count and time.monotonic() < ends:
        time.sleep(0.1)
        steps.listed = {
            entry.message.param_index: entry.message.param_id for entry in station.heard("PARAM_VALUE", COMPANION)
        }
    began = time.monotonic_ns()
    steps.set_to = station.set("TRG_RATE", 5, COMPANION)
    steps.set_too_far = station.set("TRG_RATE", 1000, COMPANION)
    time.sleep(0.5)
    steps.set_texts = [e.message.text for e in station.heard("STATUSTEXT", COMPANION, began)]
    steps.unknown = station.read("NO_SUCH_NAME", COMPANION, seconds=0.5, tries=1)


def arm(steps: Ground) -> None:
    """Arm, as soon as the filter is content."""
    for _ in range(20):
        steps.armed = steps.run.station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        if steps.armed == mavlink.MAV_RESULT_ACCEPTED:
            return
        steps.run.sleep_until(time.monotonic_ns() + 2 * SECOND_NS)


def capture(steps: Ground) -> None:
    """Take pictures with all cameras."""
    for number in range(CAPTURES):
        at_ns = time.monotonic_ns()
        result = steps.run.station.command(mavlink.MAV_CMD_IMAGE_START_CAPTURE, 0, 0, 1, number + 1)
        steps.captures.append((at_ns, result))
        steps.run.sleep_until(at_ns + SECOND_NS // 2)


# ------------------------------------------------------------------------------------------------------- rates, time


def test_inertial_messages_come_as_fast_as_a_400_hz_loop_gives_them(ground: Ground) -> None:
    """333 Hz asked; ArduPilot gives whole milliseconds at the next turn of its loop, so 3 ms become 333 a second."""
    rate_hz = ground.recording.rate_hz(Station.ROOT, ground.ended_ns - 10 * SECOND_NS, ground.ended_ns)
    assert rate_hz == pytest.approx(333.3, rel=0.02)


def test_the_boot_clock_is_inside_its_bound(ground: Ground) -> None:
    """Against the physics, which gave every frame its stamp and knows when; a frame is the clock's own step.

    Judged are the instants at which that clock runs: while the machine keeps the physics from its frames it stands, as
    no autopilot's crystal does, and nobody can know until the next exchange.
    """
    judged, outside, median_ns = boot_clock(ground.run.report, ground.recording)
    assert judged > 15, "the clock stood at the other instants: busy machine?"
    assert len(outside) <= 0.001 * judged, f"ms from the earliest, from the latest, bound: {outside}"
    assert median_ns < 3_000_000


def test_the_nodes_clocks_are_inside_their_bounds(ground: Ground) -> None:
    flight = build_flight(ground.run.airframe, SEED, ground.run.duration_s)
    for name in (ClockName.NODE_LEFT, ClockName.NODE_RIGHT):
        states = [s for s in ground.recording.of(ClockState) if s.clock == name and s.synced]
        assert len(states) > 15
        truth = flight.real.clocks[name]
        error = [s.at_host_ns + s.offset_ns - truth.from_boot(s.at_host_ns - ground.run.start_ns) for s in states]
        outside = sum(abs(e) > s.bound_ns for e, s in zip(error, states, strict=True))
        assert outside <= 0.001 * len(states), f"{name}: {outside} of {len(states)}"


# ------------------------------------------------------------------------------------------- identity and parameters


def test_the_ground_station_hears_our_heartbeat_once_a_second(ground: Ground) -> None:
    seconds = (ground.ended_ns - ground.service_ns) / SECOND_NS
    assert len(ground.heartbeats) == pytest.approx(seconds, abs=2)
    for beat in ground.heartbeats:
        assert (beat.type, beat.autopilot) == (mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID)
        assert beat.get_srcSystem() == 1
        assert beat.system_status != mavlink.MAV_STATE_CRITICAL
    assert ground.recording.of(ServiceStatus)


def test_a_new_ground_station_is_told_of_our_parameters(ground: Ground) -> None:
    assert ground.announced >= 1


def test_our_parameters_are_listed_and_set_through_the_autopilot(ground: Ground) -> None:
    assert ground.listed == {index: row.name for index, row in enumerate(tunables())}
    assert ground.set_to == 5.0


def test_a_value_out_of_range_is_answered_with_the_one_in_force_and_a_reason(ground: Ground) -> None:
    assert ground.set_too_far == 5.0
    assert any("TRG_RATE" in text for text in ground.set_texts), ground.set_texts
    assert ground.unknown is None


# ------------------------------------------------------------------------------------------------ alive without range


def test_arming_is_refused_while_nobody_sends_ranges(ground: Ground) -> None:
    assert any("Rangefinder 1: No Data" in text for text in ground.refused), ground.refused


def test_alive_without_range_clears_the_arming_check(ground: Ground) -> None:
    assert not any("Rangefinder" in text for text in ground.accepted), ground.accepted
    assert ground.armed == mavlink.MAV_RESULT_ACCEPTED, ground.accepted


def test_alive_without_range_is_not_flown_on(ground: Ground) -> None:
    """The autopilot repeats "beyond the limit, worst quality", and its own log never calls the rangefinder good."""
    assert len(ground.echo) > 50
    for distance_m, quality in ground.echo:
        assert distance_m == pytest.approx(Settings().max_range_m + 0.01)
        assert quality == 1
    statuses = {status for _, _, status in rangefinder_log(ground.run.folder)}
    assert RANGE_TOO_FAR in statuses
    assert RANGE_GOOD not in statuses


# ----------------------------------------------------------------------------------------------------------- cameras


def test_one_capture_command_fires_both_cameras(ground: Ground) -> None:
    """IMAGE_START_CAPTURE with param1 0: both servos rise at the same frame, soon after the command."""
    assert [result for _, result in ground.captures] == [mavlink.MAV_RESULT_ACCEPTED] * CAPTURES
    edges = ground.run.report["edges"]
    for channel in CAMERA_CHANNELS:
        rose = [at_ns for at_ns, which in edges if which == channel]
        assert len(rose) == CAPTURES
        delays_ms = [(at - sent) * 1e-6 for at, (sent, _) in zip(rose, ground.captures, strict=True)]
        assert 0 < min(delays_ms) <= max(delays_ms) < 100, delays_ms


def test_feedback_comes_in_pairs(ground: Ground) -> None:
    """Once per camera and picture, when the repetitions that ArduPilot sends are taken out."""
    once = set(ground.feedback)
    pictures = {camera: sorted(image for which, image in once if which == camera) for camera in {c for c, _ in once}}
    assert len(pictures) == 2
    assert all(len(images) == CAPTURES for images in pictures.values()), pictures

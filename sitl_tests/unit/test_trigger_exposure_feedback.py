"""Exposures stamped by the autopilot's hot-shoe pin: where that is the best stamp, and of the right picture."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.core.clock.bank import ClockBank
from companion.core.pipeline import start, step
from companion.core.trigger.exposure_feedback import WRAP_NS, ExposureFeedback
from companion.core.trigger.latency import LatencyModel
from companion.core.trigger.scheduling import Scheduling
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import (
    CameraFeedback,
    ClockName,
    ClockRestart,
    MatchSet,
    Notice,
    Record,
    Reject,
    Rejected,
    Shot,
    TimesyncReply,
)
from sitl_tests.unit.test_mavlink_decode import MS, S, Stream, packed, pilot_heartbeat

START_NS = 9_000 * S
BOOT_NS = WRAP_NS - 5 * S  # the 32 bits begin again five seconds from the start
EXPOSURE_NS = 2 * MS
ROUND_TRIP_NS = 600_000


def airframe(stamp_sigma_s: float) -> Airframe:
    base = load_airframe("nadir-2m")
    assert base.left_camera is not None
    assert base.right_camera is not None
    left, right = (
        dataclasses.replace(camera, stamp_sigma_s=stamp_sigma_s) for camera in (base.left_camera, base.right_camera)
    )
    return dataclasses.replace(base, left_camera=left, right_camera=right)


def exchanges(seconds: float) -> list[TimesyncReply]:
    sent = range(START_NS, START_NS + round(seconds * S), 100 * MS)
    return [
        TimesyncReply(ClockName.BOOT, at, BOOT_NS + at + ROUND_TRIP_NS // 2 - START_NS, at + ROUND_TRIP_NS)
        for at in sent
    ]


def clock_bank(seconds: float = 20.0) -> ClockBank:
    bank = ClockBank()
    for exchange in exchanges(seconds):
        bank.exchange(exchange)
    return bank


def edge(camera: int, at_host_ns: int, image: int = 1) -> CameraFeedback:
    t_ns = (BOOT_NS + at_host_ns - START_NS) % WRAP_NS // 1000 * 1000
    return CameraFeedback(camera, image, t_ns, at_host_ns + 12 * MS)


def pair(plan_id: int, left_ns: int, right_ns: int, clock: ClockName = ClockName.HOST) -> MatchSet:
    empty = np.zeros((0, 2))
    stamps = np.array([left_ns, right_ns], dtype=np.int64)
    return MatchSet(1, plan_id, (clock, clock), stamps, EXPOSURE_NS, 0, empty, empty, np.zeros(0), right_ns + 60 * MS)


def exposure_feedback(stamp_sigma_s: float, bank: ClockBank) -> ExposureFeedback:
    believed = airframe(stamp_sigma_s)
    return ExposureFeedback(believed, bank, LatencyModel(believed))


def fired(stamp_sigma_s: float, at_ns: int = START_NS + 19 * S) -> ExposureFeedback:
    feedback = exposure_feedback(stamp_sigma_s, clock_bank())
    feedback.shot(Shot(7, at_ns, at_ns))
    assert feedback.edge(edge(0, at_ns + 9 * MS)) is None
    assert feedback.edge(edge(1, at_ns + 10 * MS)) is None
    return feedback


@pytest.mark.parametrize("after_s", [3.0, 19.0])  # before and after the 32 bits begin again
def test_a_worse_stamp_is_replaced_by_the_edge_plus_half_the_exposure(after_s: float) -> None:
    at_ns = START_NS + round(after_s * S)
    camera_pair = pair(7, at_ns + 18 * MS, at_ns + 19 * MS)
    stamped, by_pin, sigma_s = fired(0.003, at_ns).stamped(camera_pair)
    assert by_pin == 2
    assert 5e-5 < sigma_s < 1e-9 * ROUND_TRIP_NS, "the stamps are as good as the pin's"
    true = np.array([at_ns + 9 * MS, at_ns + 10 * MS]) + EXPOSURE_NS // 2
    assert np.abs(stamped.mid_exposure_ns - true).max() <= ROUND_TRIP_NS
    assert stamped.clocks == (ClockName.HOST, ClockName.HOST)


def test_a_better_stamp_is_kept() -> None:
    camera_pair = pair(7, START_NS + 19 * S + 10 * MS, START_NS + 19 * S + 11 * MS)
    assert fired(0.00002).stamped(camera_pair) == (camera_pair, 0, 0.00002)


def test_frames_on_a_clock_that_nobody_knows_become_usable() -> None:
    stamped, by_pin, _ = fired(0.0).stamped(pair(7, 5, 6, ClockName.CAM_LEFT))
    assert by_pin == 2
    assert stamped.clocks == (ClockName.HOST, ClockName.HOST)


def test_each_picture_gets_its_own_edge() -> None:
    """The next shot's edges are not taken for one that told none; a pair of no plan takes the nearest."""
    at_ns = START_NS + 19 * S
    feedback = fired(0.003, at_ns)
    feedback.shot(Shot(8, at_ns + 300 * MS, at_ns + 300 * MS))
    feedback.shot(Shot(9, at_ns + 600 * MS, at_ns + 600 * MS))
    assert feedback.edge(edge(0, at_ns + 609 * MS, image=3)) is None
    assert feedback.stamped(pair(8, at_ns + 310 * MS, at_ns + 310 * MS))[1] == 0
    assert feedback.stamped(pair(9, at_ns + 610 * MS, at_ns + 610 * MS))[1] == 1
    assert feedback.stamped(pair(-1, at_ns + 12 * MS, at_ns + 13 * MS))[1] == 2
    assert feedback.stamped(pair(-1, at_ns + 150 * MS, at_ns + 150 * MS))[1] == 0


def late_airframe(stamp_sigma_s: float, believed_s: float) -> Airframe:
    base = airframe(stamp_sigma_s)
    assert base.left_camera is not None
    assert base.right_camera is not None
    latency = Uncertain(believed_s, 0.004)
    left, right = (dataclasses.replace(each, latency_s=latency) for each in (base.left_camera, base.right_camera))
    return dataclasses.replace(base, left_camera=left, right_camera=right)


@pytest.mark.parametrize("own_clock", [True, False])
@pytest.mark.parametrize("prior_error_ms", [-4, 4])
@pytest.mark.parametrize(("latency_ms", "interval_ms"), [(60, 50), (120, 100), (9, 100)])
def test_exposures_that_come_after_the_next_command_get_their_own_edges(
    latency_ms: int, interval_ms: int, prior_error_ms: int, own_clock: bool
) -> None:
    """They got the edge of the shot before, one interval early; own stamps are of the host's clock, or of none known.

    Every tenth shot has no edge.
    """
    believed = late_airframe(0.003, 1e-3 * (latency_ms + prior_error_ms))
    scheduling, random = Scheduling.create(believed, Settings()), np.random.default_rng(5)
    feedback = ExposureFeedback(believed, clock_bank(), scheduling.latency)
    true_ns, by_pin = {}, 0
    for number in range(84):
        fired_ns = START_NS + 12 * S + number * interval_ms * MS
        feedback.shot(Shot(number, fired_ns, fired_ns))
        scheduling.fired(Shot(number, fired_ns, fired_ns))
        true_ns[number] = fired_ns + latency_ms * MS + EXPOSURE_NS // 2
        if number < 3:
            continue
        seen_number = number - 3
        edges = [edge(camera, true_ns[seen_number] - EXPOSURE_NS // 2) for camera in (0, 1)]
        if seen_number % 10 != 5:
            assert [feedback.edge(each) for each in edges] == [None, None]
        left_ns, right_ns = true_ns[seen_number] + (2e6 * random.standard_normal(2)).astype(np.int64)
        clock = ClockName.HOST if own_clock else ClockName.CAM_LEFT
        stamped = feedback.stamped(pair(seen_number, left_ns, right_ns, clock))
        by_pin += stamped.by_pin
        verdict = scheduling.exposed(stamped.matches, stamped.sigma_s)
        if seen_number % 10 != 5:
            assert stamped.by_pin == 2
            assert np.abs(stamped.matches.mid_exposure_ns - true_ns[seen_number]).max() <= ROUND_TRIP_NS
            assert verdict is None
    assert by_pin == 2 * 73


def test_an_edge_far_from_the_cameras_own_stamp_is_of_another_exposure() -> None:
    """A latency that nobody believed: the stamp, good to 3 ms, tells that the edge 50 ms before it is another's."""
    believed, at_ns = late_airframe(0.003, 0.009), START_NS + 19 * S
    feedback = ExposureFeedback(believed, clock_bank(), LatencyModel(believed))
    for number in range(3):
        fired_ns = at_ns + number * 50 * MS
        feedback.shot(Shot(number, fired_ns, fired_ns))
        assert feedback.edge(edge(0, fired_ns + 60 * MS)) is None
    stamp_ns = at_ns + 50 * MS + 61 * MS
    camera_pair = pair(1, stamp_ns, stamp_ns)
    assert feedback.stamped(camera_pair) == (camera_pair, 0, 0.003)


def test_an_edge_without_a_known_clock_of_long_ago_or_of_a_third_camera_is_refused_by_its_reason() -> None:
    at_ns = START_NS + 19 * S
    assert exposure_feedback(0.003, ClockBank()).edge(edge(0, at_ns)) is Reject.CLOCK_UNSYNCED
    late = dataclasses.replace(edge(0, at_ns - 3 * S), received_host_ns=at_ns)
    synced = exposure_feedback(0.003, clock_bank())
    assert synced.edge(late) is Reject.OUT_OF_WINDOW
    assert synced.edge(dataclasses.replace(edge(0, at_ns), camera=2)) is Reject.FOREIGN_SOURCE


def test_in_the_pipeline_latency_and_correction_see_the_autopilots_stamp_and_it_is_said_once() -> None:
    state, at_ns = start(airframe(0.003), Settings()), START_NS + 19 * S
    said = []
    inputs: list[Record] = [*exchanges(20.0), Shot(7, at_ns, at_ns), edge(0, at_ns + 9 * MS), edge(1, at_ns + 9 * MS)]
    for record in [*inputs, pair(7, at_ns + 20 * MS, at_ns + 20 * MS)]:
        state, outputs = step(state, record)
        said += outputs
    assert state.counters["exposures stamped by the autopilot"] == 2
    assert sum("hot-shoe" in entry.text for entry in said if isinstance(entry, Notice)) == 1
    assert state.correction is not None
    assert np.abs(state.correction.pending[-1].matches.mid_exposure_ns - (at_ns + 10 * MS)).max() <= ROUND_TRIP_NS
    state, _ = step(state, ClockRestart(ClockName.BOOT, at_ns + S))
    _, outputs = step(state, edge(0, at_ns + S))
    assert [entry.reason for entry in outputs if isinstance(entry, Rejected)] == [Reject.CLOCK_UNSYNCED]


def feedback_frame(time_us: int, camera: int, image: int) -> bytes:
    message = mavlink.MAVLink_camera_feedback_message(time_us, 0, camera, image, 0, 0, 0, 0, 0, 0, 0, 0, 0, image)
    return packed(message)


def test_the_decoder_gives_edges_of_the_pin_once_and_no_gps_time() -> None:
    stream = Stream()
    stream(packed(pilot_heartbeat()))
    records = stream(
        feedback_frame(5_000_000, 0, 1),
        feedback_frame(5_000_200, 1, 1),
        feedback_frame(5_000_000, 0, 1),  # ArduPilot repeats the other camera's
        feedback_frame(1_700_000_000_000_000, 0, 2),  # no pin: GPS time of the command
        feedback_frame(0, 1, 2),  # nor GPS
    )
    assert records == [CameraFeedback(0, 1, 5_000_000_000, stream.now), CameraFeedback(1, 1, 5_000_200_000, stream.now)]

"""A real ArduPlane carried along a flight: it fires our cameras, we range through the bent wing, it uses the range."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.params.files import load_airframe
from companion.records import CorrectedRange, MatchSet, ModeState, Shot, Station
from sitl_tests.ardupilot.bench import Run
from sitl_tests.ardupilot.evidence import RANGE_GOOD, Tape, frames_ns, rangefinder_log
from sitl_tests.ardupilot.pace import skip_if_busy
from sitl_tests.ardupilot.physics import CAMERA_CHANNELS
from sitl_tests.ardupilot.station import COMPANION, Heard

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(600)]

SECOND_NS = 1_000_000_000
SEED, FLOWN_S = 1, 40.0
READY_S = 8.0
SHOTS_HZ = 3
# what it was sent stands until the next comes, 0.5 s at most (AP_RANGEFINDER_MAVLINK_TIMEOUT_MS); it is told 20 times
# a second, and the copy that the autopilot passes on to the ground station may be heard a little later than it is used
HELD_S, TOLD_S, HEARD_S = 0.5, 0.05, 0.03
# exposure, match, smoother's lag; on a busy machine vision waits its turn as well
OUT_S = 1.5
MOST_CLIMB_MPS = 5.0  # of the flight that it is carried along, up or down
# from the request leaving our process to the servo's edge: link, a turn of a 400 Hz loop, a turn of the 50 Hz camera
SLOWEST_SHOT_NS = 60_000_000


@dataclass
class Flown:
    run: Run
    tape: Tape
    service: list[Heard]
    echo: list[Heard]
    feedback: list[Heard]
    made: list[tuple[int, CorrectedRange]]

    def flight_s(self, host_ns: int) -> float:
        return (host_ns - self.run.flight_ns) * 1e-9


@pytest.fixture(scope="module")
def flown(arduplane: Path, tmp_path_factory: pytest.TempPathFactory) -> Flown:
    folder = tmp_path_factory.mktemp("plane-flight")
    airframe = load_airframe("nadir-2m")
    with Run(arduplane, folder, airframe, "nadir-2m", {"RNGFND1_ORIENT": 25}, SEED, FLOWN_S, eyes=True) as run:
        for kind in (mavlink.MAVLink_distance_sensor_message, mavlink.MAVLink_rangefinder_message):
            run.station.stream(kind, 20)
        run.service(f"TRG_RATE={SHOTS_HZ}")
        run.await_service(READY_S)
        run.launch()
        run.sleep_until(run.flight_ns + round(FLOWN_S * SECOND_NS))
        run.end_service()
    station, tape = run.station, Tape(run.recording)
    over_ns = run.flight_ns + round(FLOWN_S * SECOND_NS)
    skip_if_busy(frames_ns(run.report), tape.ticks_ns(), run.flight_ns, over_ns)
    return Flown(
        run,
        tape,
        station.heard("DISTANCE_SENSOR", COMPANION),
        station.heard("DISTANCE_SENSOR", 1),
        station.heard("CAMERA_FEEDBACK", 1),
        [(made_ns, measured) for made_ns, measured in tape.made(CorrectedRange) if measured.trusted],
    )


def test_all_sensors_arrive_at_their_rates(flown: Flown) -> None:
    window = (flown.run.flight_ns + 20 * SECOND_NS, flown.run.flight_ns + 30 * SECOND_NS)
    assert flown.tape.rate_hz(Station.ROOT, *window) == pytest.approx(333.3, rel=0.02)
    for station in (Station.LEFT, Station.RIGHT):
        assert flown.tape.rate_hz(station, *window) == pytest.approx(1000.0, rel=0.02)


def test_the_wings_own_frequency_is_found(flown: Flown) -> None:
    truth_hz = flown.run.flight.real.actual.wing.symmetric.frequency_hz.value
    last = [state for state in flown.tape.of(ModeState) if flown.flight_s(state.t_host_ns) < FLOWN_S - 1][-1]
    sigma_hz = last.symmetric.frequency_sigma_hz
    assert abs(last.symmetric.frequency_hz - truth_hz) < max(4 * sigma_hz, 0.02 * truth_hz)


def test_the_autopilot_fires_what_was_planned(flown: Flown) -> None:
    """Each request of ours is a rising edge on both camera servos, within the time that link and loop may take."""
    shots = flown.tape.of(Shot)
    assert len(shots) > 20
    for channel in CAMERA_CHANNELS:
        edges = np.array([at for at, which in flown.run.report["edges"] if which == channel])
        delay = np.array([np.min(np.where(edges > s.fired_host_ns, edges, 1 << 62)) - s.fired_host_ns for s in shots])
        served = delay < SLOWEST_SHOT_NS
        assert served.mean() > 0.95, f"servo {channel}: {served.sum()} of {len(shots)}"
        assert len(edges) <= len(shots)


def test_both_cameras_are_fed_back_alike(flown: Flown) -> None:
    edges = [at for at, which in flown.run.report["edges"] if which == CAMERA_CHANNELS[0]]
    once = {(entry.message.cam_idx, entry.message.img_idx) for entry in flown.feedback}
    counts = [sum(camera == which for camera, _ in once) for which in sorted({camera for camera, _ in once})]
    assert len(counts) == 2
    assert counts[0] == counts[1]
    assert counts[0] == pytest.approx(len(edges), abs=2)


def test_shots_become_matched_pairs(flown: Flown) -> None:
    edges = [at for at, which in flown.run.report["edges"] if which == CAMERA_CHANNELS[0] and flown.flight_s(at) > 0]
    matched = {m.pair_id for m in flown.tape.of(MatchSet)}
    assert len(matched) > 0.8 * len(edges)


def true_range_m(flown: Flown, measured: CorrectedRange) -> float:
    """Along the body's z axis to the ground plane z = 0, from the flight's truth at mid-exposure."""
    truth = flown.run.flight.truth.at(measured.t_host_ns - flown.run.flight_ns)
    return float(-truth.position_ned_m[2] / truth.body_from_ned[2, 2])


def test_no_wrong_range_is_published(flown: Flown) -> None:
    """Wrong: off by more than 5 sigma and 5 % while declared trusted."""
    trusted = [r for r in flown.tape.of(CorrectedRange) if r.trusted]
    assert len(trusted) > 20
    error = [(r.range_m - true_range_m(flown, r), r.sigma_m, r.range_m) for r in trusted]
    wrong = [e for e in error if abs(e[0]) > 5 * e[1] and abs(e[0]) > 0.05 * e[2]]
    assert not wrong
    rigid = np.array([r.rigid_range_m for r in trusted if r.rigid_range_m > 0])
    true = np.array([true_range_m(flown, r) for r in trusted if r.rigid_range_m > 0])
    assert np.median(np.abs([e[0] for e in error])) < 0.2 * np.median(np.abs(rigid - true))


def sent_just_before(flown: Flown, at_ns: int) -> list[int]:
    """Ranges [cm] that the autopilot had so lately that it may still go by them.

    As it passed them on to the ground station, and as we made them: on a crowded machine the copy may be later than
    what the autopilot does with it.
    """
    first_ns, last_ns = at_ns - round((HELD_S + TOLD_S) * SECOND_NS), at_ns + round(HEARD_S * SECOND_NS)
    near = [e.message for e in flown.service if first_ns <= e.at_ns <= last_ns]
    made = [round(100 * r.range_m) for made_ns, r in flown.made if first_ns <= made_ns <= at_ns]
    return [*(message.current_distance for message in near if message.signal_quality > 1), *made]


def test_every_range_sent_is_one_that_was_just_measured(flown: Flown) -> None:
    """To the centimetre, but for what the aircraft has climbed since the exposure."""
    trusted = [r for r in flown.tape.of(CorrectedRange) if r.trusted]
    sent = [e for e in flown.service if e.message.signal_quality > 1]
    assert len(sent) > 20
    for entry in sent:
        ages_s = [((entry.at_ns - r.t_host_ns) / SECOND_NS, r.range_m) for r in trusted]
        lately = [(age_s, range_m) for age_s, range_m in ages_s if 0 < age_s < OUT_S]
        told_m = 0.01 * entry.message.current_distance
        near = (abs(range_m - told_m) <= 0.006 + MOST_CLIMB_MPS * age_s for age_s, range_m in lately)
        assert any(near), f"{told_m} m, measured {lately}"


def test_the_autopilot_repeats_our_range_as_its_rangefinder(flown: Flown) -> None:
    """Its echo is the distance sent just before, to the centimetre."""
    used = [e for e in flown.echo if e.message.signal_quality > 1]
    assert len(used) > 20
    for entry in used:
        # it keeps metres as a float, and cuts where it sends centimetres again
        echoed_cm, sent = entry.message.current_distance, sent_just_before(flown, entry.at_ns)
        assert any(cm - echoed_cm in (0, 1) for cm in sent), f"{echoed_cm} cm: a number that we did not send ({sent})"


def test_the_autopilot_flies_on_it(flown: Flown) -> None:
    """Its own log calls the rangefinder good, and only with distances that we had just sent."""
    good = [(t, d) for t, d, status in rangefinder_log(flown.run.folder) if status == RANGE_GOOD]
    assert len(good) > 50
    for at_s, distance_m in good:
        sent = sent_just_before(flown, flown.run.start_ns + round(at_s * SECOND_NS))
        assert any(abs(0.01 * cm - distance_m) < 0.006 for cm in sent), f"{distance_m:.2f} m at {at_s:.2f} s ({sent})"

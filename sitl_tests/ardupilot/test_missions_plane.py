"""The missions against a real ArduPlane: its modes, its mission state machine, its routing of the ranges."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.recording_factory import open_recording
from companion.params.files import load_airframe
from companion.records import ImuBatch, Station
from mission_scripts import calibrate_target, climb_sweep, excite_wing, landing_approach
from mission_scripts.common.outcome import Exit
from sitl_tests.ardupilot.flyer import Flyer
from sitl_tests.loop.rehearsals import interrupt

pytestmark = [pytest.mark.realtime, pytest.mark.long]

LOITER, RTL, GUIDED = 12, 11, 15


def test_the_climb_sweep_is_flown_with_ranges_through_the_autopilot(arduplane: Path, tmp_path: Path) -> None:
    with Flyer(arduplane, tmp_path) as flyer:
        assert flyer.fly(climb_sweep.main, ["--heights", "50", "70", "--bearing=0"]) == Exit.DONE
        assert flyer.mode == LOITER
    rows = [line for line in flyer.log().splitlines() if "ranges trusted" in line]
    assert len(rows) == 2
    recording = open_recording(tmp_path / "flight.tlog", load_airframe(str(flyer.airframe_path)))
    counts: Counter[Station] = Counter()
    for record in recording.records():
        if isinstance(record, ImuBatch):
            counts[record.station] += len(record.t_ns)
    assert min(counts[station] for station in Station) > 1000


def test_doublets_reach_the_attitude_and_airspeed_is_kept(arduplane: Path, tmp_path: Path) -> None:
    with Flyer(arduplane, tmp_path) as flyer:
        assert flyer.fly(excite_wing.main, ["--airspeeds", "19", "22", "--doublets=1"]) == Exit.DONE
        assert flyer.mode == LOITER
    flown = np.degrees(np.array([(roll, pitch) for mode, roll, pitch in flyer.attitudes_rad if mode == GUIDED]))
    # pitch doublets of 6 degrees either side; roll doublets of 15 to both sides, where the circles are all to the right
    assert np.ptp(flown[:, 1]) > 10.0
    assert flown[:, 0].min() < -10.0
    assert "ABORT" not in flyer.log()


def test_an_approach_without_trusted_ranges_goes_around(arduplane: Path, tmp_path: Path) -> None:
    with Flyer(arduplane, tmp_path) as flyer:
        flyer.when(
            lambda: max(flyer.heights_m) > 75.0 and flyer.heights_m[-1] < 42.0,
            lambda: setattr(flyer.ranges, "untrusted", True),
        )
        assert flyer.fly(landing_approach.main, ["--slope=6", "--bearing=0"]) == Exit.ABORTED
        top = int(np.argmax(flyer.heights_m))
        assert 18.0 < min(flyer.heights_m[top:]) < 42.0
        assert flyer.mode == LOITER
    assert "GO AROUND" in flyer.log()
    assert "no trusted range" in flyer.log()


def test_an_approach_with_good_ranges_lands(arduplane: Path, tmp_path: Path) -> None:
    with Flyer(arduplane, tmp_path) as flyer:
        assert flyer.fly(landing_approach.main, ["--slope=6", "--bearing=0", "--land"]) == Exit.DONE
        assert not flyer.armed
        assert abs(flyer.heights_m[-1]) < 3.0


def test_a_calibration_over_level_ground_finds_the_toe(arduplane: Path, tmp_path: Path) -> None:
    with Flyer(arduplane, tmp_path) as flyer:
        flyer.ranges.toe_rad = 0.004
        options = ["--ground=0", "--heights", "40", "80", "--length=500", "--bearing=0"]
        assert flyer.fly(calibrate_target.main, options) == Exit.DONE
    (line,) = [line for line in flyer.log().splitlines() if "convergence offset" in line]
    assert float(line.split("offset")[1].split("+-")[0]) == pytest.approx(4.0, abs=1.0)


def test_control_c_holds(arduplane: Path, tmp_path: Path) -> None:
    with Flyer(arduplane, tmp_path) as flyer:
        flyer.when(lambda: flyer.heights_m[-1] > 55.0, interrupt)
        assert flyer.fly(climb_sweep.main, ["--heights", "60", "90", "--bearing=0"]) == Exit.INTERRUPTED
        assert flyer.mode == LOITER

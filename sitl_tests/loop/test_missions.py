"""Each mission to its end and along each way out, over real UDP against the simulated vehicle, many times real time."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import pytest

from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.main import main as spanwise
from companion.params.files import load_airframe
from companion.records import ImuBatch, Station
from companion.sim.vehicle.faults import Faults
from companion.sim.vehicle.scripted_pilot import FlightMode
from mission_scripts import calibrate_target, climb_sweep, excite_wing, landing_approach, obstacle_pass
from mission_scripts.common.outcome import Exit
from sitl_tests.loop.rehearsals import SPEED, Stage, interrupt

pytestmark = pytest.mark.realtime

SWEEP = ("--heights=40", "--length=250", "--bearing=0")


def samples(stage: Stage) -> Counter[Station]:
    """Records that our reader finds in the tap's recording."""
    recording = open_recording(stage.folder / "flight.tlog", load_airframe(str(stage.airframe_path)))
    counts: Counter[Station] = Counter()
    for record in recording.records():
        if isinstance(record, ImuBatch):
            counts[record.station] += len(record.t_ns)
    return counts


# ------------------------------------------------------------------------------------------ to the end


def test_climb_sweep_flies_its_legs_and_leaves_a_recording_of_all_three_stations(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    assert stage.fly(climb_sweep.main, "--heights", "40", "70", "--length=250", "--bearing=90") == Exit.DONE
    assert stage.pilot.mode is FlightMode.LOITER
    assert stage.pilot.height_m == pytest.approx(70.0, abs=4.0)
    rows = [line for line in stage.log().splitlines() if "ranges trusted" in line]
    assert [row.split()[2] for row in rows] == ["40", "70"]
    counts = samples(stage)
    flown_s = stage.vehicle.boot_ns * 1e-9
    for station in Station:
        # asked for 333 Hz, refused, granted 50 Hz; the first seconds went by before it was asked
        assert counts[station] > 50.0 * 0.5 * flown_s


def test_excite_wing_flies_doublets_at_each_airspeed(tmp_path: Path) -> None:
    stage = Stage(tmp_path, speed=3.0)
    rolls: list[float] = []
    pitches: list[float] = []
    stage.every(lambda: rolls.append(stage.pilot.roll_rad))
    stage.every(lambda: pitches.append(stage.pilot.pitch_rad))
    speeds: list[float] = []
    stage.every(lambda: speeds.append(stage.pilot.airspeed_mps))
    options = ("--airspeeds", "19", "22", "--doublets=1", "--rest=0.3", "--floor=15")
    assert stage.fly(excite_wing.main, *options) == Exit.DONE
    assert stage.log().count("doublet 1:") == 4
    assert min(speeds) == pytest.approx(19.0, abs=1.0)
    assert max(pitches) - min(pitches) > 0.15
    assert min(rolls) < -0.15, "to the left too: the circles are flown to the right"
    assert stage.pilot.mode is FlightMode.LOITER
    assert min(samples(stage).values()) > 0


def test_calibration_finds_the_toe_that_was_put_in(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    stage.ranges.toe_rad = 0.004
    options = ("--ground=0", "--heights", "30", "60", "--length=300", "--bearing=0", "--known-sigma=0.1")
    assert stage.fly(calibrate_target.main, *options) == Exit.DONE
    result = json.loads((tmp_path / "calibration.json").read_text())
    assert abs(result["toe_mrad"] - 4.0) < 4 * result["toe_sigma_mrad"]
    assert 0.05 < result["toe_sigma_mrad"] < 0.5
    # for a pair that looks down theta = 2 s q: 4 mrad are 1.44 mm of trim bend at 1.39 rad/m
    assert result["write"]["wing.trim_bend_m"]["value"] == pytest.approx(0.004 / 2.78, rel=0.25)


def test_a_still_target_is_calibrated_without_a_single_order(tmp_path: Path) -> None:
    stage = Stage(tmp_path, height_m=0.0)
    stage.vehicle.companion._distance_m = lambda: 50.0
    stage.ranges.toe_rad = -0.003
    assert stage.fly(calibrate_target.main, "--still=50", "--seconds=2", "--known-sigma=0.02") == Exit.DONE
    result = json.loads((tmp_path / "calibration.json").read_text())
    assert result["toe_mrad"] == pytest.approx(-3.0, abs=0.8)
    assert not stage.pilot.armed
    assert stage.pilot.mode is FlightMode.MANUAL


def test_calibration_against_a_mark_ahead_turns_the_cameras(tmp_path: Path) -> None:
    stage = Stage(tmp_path, orientation=0, height_m=40.0, obstacle_m=(500.0, 0.0))
    stage.ranges.toe_rad = 0.005
    options = (
        "--mark=47.0044916,8.0",
        "--bearing=0",
        "--length=120",
        "--heights=40",
        "--turn-off=50",
        "--known-sigma=0.5",
    )
    assert stage.fly(calibrate_target.main, *options) == Exit.DONE
    result = json.loads((tmp_path / "calibration.json").read_text())
    assert abs(result["toe_mrad"] - 5.0) < 4 * result["toe_sigma_mrad"]
    left, right = (result["write"][f"{side}_camera.rotation_rad"][1] for side in ("left", "right"))
    assert right - left == pytest.approx(1e-3 * result["toe_mrad"])


def test_obstacle_pass_ranges_the_obstacle_and_passes_it(tmp_path: Path) -> None:
    stage = Stage(tmp_path, orientation=0, height_m=40.0, obstacle_m=(400.0, 0.0))
    assert stage.fly(obstacle_pass.main, "--obstacle=47.0035932,8.0", "--bearing=0", "--length=200") == Exit.DONE
    assert stage.pilot.north_m > 500.0
    assert "trusted ranges of it" in stage.log()


def test_low_pass_ends_with_a_climb_out_and_landing_on_the_ground(tmp_path: Path) -> None:
    low = Stage(tmp_path)
    assert low.fly(landing_approach.main, "--bearing=0", "--slope=8") == Exit.DONE
    assert "): range good" in low.log()
    assert low.pilot.height_m > 60.0
    down = Stage(tmp_path)
    assert down.fly(landing_approach.main, "--bearing=0", "--slope=8", "--land") == Exit.DONE
    assert down.pilot.height_m == 0.0
    assert not down.pilot.armed


def test_a_mission_takes_off_from_the_ground_when_asked(tmp_path: Path) -> None:
    grounded = Stage(tmp_path, height_m=0.0)
    assert grounded.fly(climb_sweep.main, *SWEEP, "--no-ranges") == Exit.REFUSED
    assert not grounded.pilot.armed
    stage = Stage(tmp_path, height_m=0.0)
    assert stage.fly(climb_sweep.main, *SWEEP, "--no-ranges", "--take-off=40") == Exit.DONE
    assert stage.pilot.height_m > 30.0


# ------------------------------------------------------------------------------------------ the ways out


def test_control_c_holds_and_closes_the_recording(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    stage.on_item(2, interrupt)
    assert stage.fly(climb_sweep.main, *SWEEP) == Exit.INTERRUPTED
    assert stage.pilot.mode is FlightMode.LOITER
    assert "confirms HOLD" in stage.log()
    assert min(samples(stage).values()) > 0


def test_control_c_may_mean_home(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    stage.on_item(2, interrupt)
    assert stage.fly(climb_sweep.main, *SWEEP, "--on-abort=rtl") == Exit.INTERRUPTED
    assert stage.pilot.mode is FlightMode.RTL


def test_a_lost_link_that_comes_back_is_used_to_go_home(tmp_path: Path) -> None:
    away = Faults(silences=((1, 12 * SPEED, 16 * SPEED),))
    stage = Stage(tmp_path, faults=away)
    code = stage.fly(climb_sweep.main, "--heights", "40", "60", "80", "--length=900", "--bearing=0", "--link-loss=1.5")
    assert "link lost" in stage.log()
    assert code == Exit.ABORTED
    assert stage.pilot.mode is FlightMode.RTL


def test_low_battery_goes_home(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    stage.on_item(2, lambda: setattr(stage.pilot, "battery", 0.2))
    assert stage.fly(climb_sweep.main, *SWEEP) == Exit.ABORTED
    assert stage.pilot.mode is FlightMode.RTL
    assert "battery at 20%" in stage.log()


def test_who_takes_the_aircraft_keeps_it(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    stage.on_item(2, lambda: setattr(stage.pilot, "mode", FlightMode.FBWA))
    assert stage.fly(climb_sweep.main, *SWEEP) == Exit.HANDS_OFF
    assert stage.pilot.mode is FlightMode.FBWA


def test_leaving_the_track_is_noticed(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    stage.on_item(2, lambda: setattr(stage.pilot, "wind_east_mps", 30.0))
    code = stage.fly(climb_sweep.main, "--heights=40", "--length=1200", "--bearing=0", "--off-track=60")
    assert code == Exit.ABORTED
    assert "off the track" in stage.log()
    assert stage.pilot.mode is FlightMode.LOITER


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        ({"untrusted": True}, "no trusted range"),
        ({"silent": True}, "range stale"),
        ({"jump_m": 12.0}, "range jumps"),
        ({"toe_rad": 0.012}, "is expected"),
    ],
    ids=["untrusted", "stale", "jump", "apart"],
)
def test_an_approach_goes_around_when_the_range_fails(tmp_path: Path, wrong: dict[str, float], why: str) -> None:
    stage = Stage(tmp_path)

    def spoil() -> None:
        for name, value in wrong.items():
            setattr(stage.ranges, name, value)

    lowest = [1e3]
    stage.every(lambda: lowest.append(stage.pilot.height_m))
    stage.on_item(3, spoil, below_m=45.0)
    options = ("--bearing=0", "--slope=6", "--blind=0.4", "--stale=0.3", "--decision=15")
    if "toe_rad" in wrong:
        options += ("--jump=50",)
    assert stage.fly(landing_approach.main, *options) == Exit.ABORTED
    assert "GO AROUND" in stage.log()
    assert why in stage.log()
    assert min(lowest) > 16.0
    assert stage.pilot.height_m > 50.0
    assert stage.pilot.mode is FlightMode.LOITER


def test_on_the_ground_nothing_is_ordered_any_more(tmp_path: Path) -> None:
    """A go-around or RTL would start the motor there."""
    stage = Stage(tmp_path, speed=3.0, height_m=40.0)
    stage.on_item(3, interrupt, below_m=0.5)
    options = ("--bearing=0", "--slope=10", "--height=40", "--gate=30", "--decision=12", "--land")
    assert stage.fly(landing_approach.main, *options) == Exit.HANDS_OFF
    assert stage.pilot.mode is FlightMode.AUTO
    assert "GO AROUND" not in stage.log()


def test_an_obstacle_too_near_ahead_breaks_the_pass_off(tmp_path: Path) -> None:
    # a second pole, on the leg itself
    stage = Stage(tmp_path, orientation=0, height_m=40.0, obstacle_m=(400.0, -30.0))
    code = stage.fly(obstacle_pass.main, "--obstacle=47.0035932,8.0", "--bearing=0", "--length=200", "--least=60")
    assert code == Exit.ABORTED
    assert stage.pilot.mode is FlightMode.RTL
    assert "least 60 m" in stage.log()


def test_a_wing_that_swings_too_far_ends_the_excitation(tmp_path: Path) -> None:
    stage = Stage(tmp_path, speed=3.0)
    stage.vehicle.companion.bend_mm = (70.0, 0.0)
    code = stage.fly(excite_wing.main, "--airspeeds=22", "--doublets=1", "--bend-limit=60", "--floor=15")
    assert code == Exit.ABORTED
    assert "bends by 70 mm" in stage.log()


# ------------------------------------------------------------------------------------------ nothing begins


def test_no_vehicle_is_told_and_no_file_is_left_open(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = climb_sweep.main(
        ["--connect=udpin://127.0.0.1:14999", "--wait=1", f"--out={tmp_path}", "--airframe=sitl-plane"]
    )
    assert code == Exit.REFUSED
    assert "no autopilot" in capsys.readouterr().out


def test_without_ranges_nothing_that_needs_them_begins(tmp_path: Path) -> None:
    stage = Stage(tmp_path)
    stage.ranges.silent = True
    assert stage.fly(landing_approach.main, "--bearing=0") == Exit.REFUSED
    assert stage.pilot.mode is FlightMode.LOITER
    assert "no DISTANCE_SENSOR" in stage.log()


def test_wrong_options_are_wrong_usage(tmp_path: Path) -> None:
    for script, options in (
        (excite_wing.main, ["--airspeeds", "22", "18"]),
        (landing_approach.main, ["--decision=70"]),
        (climb_sweep.main, ["--heights=10"]),
        (calibrate_target.main, []),
        (obstacle_pass.main, ["--obstacle=here", "--bearing=0"]),
    ):
        with pytest.raises(SystemExit) as caught:
            script([f"--out={tmp_path}", "--connect=udpin://127.0.0.1:1", *options])
        assert caught.value.code == Exit.USAGE


def test_an_airframe_that_does_not_exist_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code = climb_sweep.main(["--connect=udpin://127.0.0.1:1", f"--out={tmp_path}", "--airframe=no-such-plane"])
    assert code == Exit.REFUSED
    assert "no-such-plane" in capsys.readouterr().out


# ------------------------------------------------------------------------------------------ ready to go on with


@pytest.mark.slow
def test_the_recording_of_a_sweep_identifies_the_wing(tmp_path: Path) -> None:
    """The truth is drawn from priors half a hertz wide; the recording of a minute knows it to half a percent."""
    stage = Stage(tmp_path, seconds=70.0, speed=3.0, parameters={"SCHED_LOOP_RATE": 400.0})
    options = ("--heights", "60", "75", "--length=450", "--bearing=0", "--no-ranges")
    assert stage.fly(climb_sweep.main, *options) == Exit.DONE
    identified = tmp_path / "found"
    recording = str(tmp_path / "flight.tlog")
    assert spanwise(["identify", "flight", recording, f"--airframe={stage.airframe_path}", f"--out={identified}"]) == 0
    wing, truth = load_airframe(str(identified / "airframe.toml")).wing, stage.flight.real.actual.wing
    for mode, true in ((wing.symmetric, truth.symmetric), (wing.antisymmetric, truth.antisymmetric)):
        assert mode.frequency_hz.value == pytest.approx(true.frequency_hz.value, rel=0.005)


@pytest.mark.slow
def test_a_service_that_is_started_with_the_mission_records_it(tmp_path: Path) -> None:
    """The real service on a second link, in real time; Ctrl-C in between, and both files are whole."""
    stage = Stage(tmp_path, speed=1.0, seconds=40.0, parameters={}, second_link=True)
    stage.on_item(1, interrupt)
    options = ("--service", f"udpin:127.0.0.1:{stage.second_port}", "--no-ranges", *SWEEP)
    assert stage.fly(climb_sweep.main, *options) == Exit.INTERRUPTED
    recording = open_recording(tmp_path / "flight.mcap")
    kinds = Counter(type(record).__name__ for record in recording.records())
    assert recording.replayable
    assert not [notice.text for notice in recording.notices]
    assert kinds["ImuBatch"] > 100
    assert kinds["ServiceStatus"] > 1
    assert min(samples(stage).values()) > 0

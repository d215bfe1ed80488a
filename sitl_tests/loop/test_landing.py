"""The service beside the aeroplane that lands: sensors of a flight that is being flown, and a landing by its ranges."""

from __future__ import annotations

import numpy as np
import pytest

from companion.cli.steps.landing_lockstep import LandingService
from companion.cli.steps.landing_tasks import fly_one
from companion.evaluation.landing.landing_rows import RangeKind
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Reject, Side, Station, Validity
from companion.service.config import ServiceConfig
from companion.sim.flight.sensors import station_readings
from companion.sim.landing.approach import Approach
from companion.sim.landing.landing_flight import LandingFlight, TrueRange
from companion.sim.landing.live_sensors import LiveNode, LiveSensor

AIRFRAME = load_airframe("nadir-2m")


def flown(seconds: float, gusts: bool = True) -> LandingFlight:
    return LandingFlight(AIRFRAME, 3, gusts=gusts, approach=Approach(height_m=30.0, level_s=seconds))


def test_a_nodes_samples_are_the_motion_at_its_station_within_its_errors() -> None:
    """Sampled by segments of 20 ms and joined: no gap, no repeat, and only scale, mounting, bias and noise between."""
    landing = flown(3.0)
    node, source = LiveNode(landing, Station.RIGHT), TrueRange(landing)
    segments = [node.until()]
    for _ in range(100):
        landing.advance(source.reading_m(landing.now_ns))
        segments.append(node.until())
    stamps = np.concatenate([segment.stamp_ns for segment in segments])
    values = np.concatenate([segment.values for segment in segments])
    assert np.abs(np.diff(stamps) - 1_000_000).max() <= 1000, "a stamp has whole microseconds"
    clock = landing.real.clocks[segments[0].clock]
    boot = np.round((stamps - clock.epoch_ns) / (1 + 1e-6 * clock.skew_ppm)).astype(np.int64)
    sensor = landing.real.actual.sensor(Station.RIGHT)
    true = station_readings(landing.truth, landing.model, Station(1 + Side.RIGHT), sensor, boot, 1_000_000)
    error = values - true
    assert np.abs(error[:, :3].mean(axis=0)).max() < 0.25, "half a per cent of scale and mounting, of 1 g; and bias"
    assert error[:, 2].std() < 0.08
    assert np.corrcoef(values[:, 2], true[:, 2])[0, 1] > 0.98


def test_the_autopilots_samples_go_through_its_low_pass_without_a_seam() -> None:
    """Segments of 20 ms filtered one after another are as smooth at their joints as inside."""
    landing = flown(3.0)
    source, sensor = TrueRange(landing), LiveSensor(landing, Station.ROOT, 1_000_000)
    joints, values = [], [sensor.until()[2]]
    for _ in range(100):
        landing.advance(source.reading_m(landing.now_ns))
        joints.append(sum(len(segment) for segment in values))
        values.append(sensor.until()[2])
    steps = np.abs(np.diff(np.concatenate(values)[:, 2]))
    at_joints = steps[np.array(joints[5:]) - 1]
    assert np.median(at_joints) < 2.0 * np.median(steps)
    assert at_joints.max() <= steps.max()


@pytest.mark.slow
def test_the_service_follows_a_flight_that_is_flown_meanwhile() -> None:
    """Clocks lock, every sample is taken, the wing is tracked; no message is wrong; no image is asked for."""
    settings = Settings().replace("TRG_POLICY", 2.0)
    landing = flown(4.0)
    with LandingService(ServiceConfig(AIRFRAME, settings, ()), landing) as service:
        while service.clock.flown_s < 4.0:
            service.loop.run_once()
        counters, received = service.loop.state.counters, service.world.autopilot.received
        assert service.loop.state.validity is not None
    assert counters["samples left"] > 3000
    assert counters["samples root"] > 1000
    assert received.problems == []
    assert counters[str(Reject.NOT_FINITE)] == counters[str(Reject.TIME_BACKWARDS)] == 0


@pytest.mark.slow
def test_a_lift_that_changes_inside_an_epoch_contradicts_no_wing() -> None:
    """Turbulence moves the load of the static bend faster than the root's samples show: first moments are left out.

    With them, six landings of six had no range: 7.6 squared sigmas a row, and 2.4 a row of all.
    """
    landing = LandingFlight(AIRFRAME, 2, gusts=True, approach=Approach(height_m=30.0, level_s=12.0))
    with LandingService(ServiceConfig(AIRFRAME, Settings().replace("TRG_POLICY", 2.0), ()), landing) as service:
        while service.clock.flown_s < 12.0:
            service.loop.run_once()
        state = service.loop.state
    assert state.validity is Validity.TRACKING
    assert state.tracker.distrust is None
    assert state.tracker._kalman.nis < 1.5


@pytest.mark.long
@pytest.mark.parametrize("gusts", [False, True])
def test_a_landing_by_spanwise_is_that_of_the_true_range(gusts: bool) -> None:
    """It flares where it should to a fifth, and meets the ground as softly as with the true range, to 0.5 m/s."""
    settings = Settings().replace("TRG_RATE", 5.0)
    rows = [fly_one(AIRFRAME, 1, kind, settings, gusts=gusts) for kind in (RangeKind.SPANWISE, RangeKind.TRUTH)]
    ours, true = rows
    assert ours["outcome"] == true["outcome"] == "landed"
    assert ours["flare"]["height_m"] == pytest.approx(ours["flare"]["intended_m"], rel=0.2)
    assert ours["touch"]["sink_mps"] < true["touch"]["sink_mps"] + 0.5
    assert abs(ours["touch"]["north_m"] - true["touch"]["north_m"]) < 25.0

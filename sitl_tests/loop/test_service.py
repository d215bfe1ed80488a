"""The service against the simulated vehicle: in simulated time, and once for real (``spanwise demo --realtime``)."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.cli.main import main
from companion.params.files import load_airframe
from companion.records import CorrectedRange, Firing, Health, ServiceStatus, TriggerPlan
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.simulated_service import EPOCH_NS, GROUND_M, MS, SimulatedService

BASELINE_M = 1.98
FLOWN_S = 16.0  # the tracker lets no range pass in its first ten seconds


@pytest.fixture(scope="module")
def service() -> Iterator[SimulatedService]:
    run = SimulatedService(build_flight(load_airframe("nadir-2m"), 4, FLOWN_S + 2.0))
    run.fly(FLOWN_S)
    yield run
    run.close()


def toe_mrad(range_m: Any) -> Any:
    """Relative toe that a range error amounts to: B (1/Z - 1/Z_true)."""
    return 1e3 * BASELINE_M * (1.0 / np.asarray(range_m) - 1.0 / GROUND_M)


@pytest.mark.long
def test_ranges_are_true_although_the_wing_bends(service: SimulatedService) -> None:
    trusted = [measured for measured in service.tape.of(CorrectedRange) if measured.trusted]
    assert len(trusted) > 20
    error_m = np.array([measured.range_m - GROUND_M for measured in trusted])
    sigma_m = np.array([measured.sigma_m for measured in trusted])
    assert np.abs(error_m / sigma_m).max() < 5.0
    corrected, rigid = (
        np.sqrt(np.mean(toe_mrad([getattr(measured, name) for measured in trusted]) ** 2))
        for name in ("range_m", "rigid_range_m")
    )
    assert rigid > 20.0, "1 g bends the tips by 15 mm, 41 mrad of toe"
    assert corrected < 0.05 * rigid


@pytest.mark.long
def test_the_vehicle_uses_the_ranges_and_never_misses_a_message(service: SimulatedService) -> None:
    report = service.world.report()
    assert report["problems"] == []
    assert report["range_timeouts"] == 0
    assert report["ranges_used"] > 20
    arrivals = np.array([entry["arrival_boot_ns"] for entry in report["ranges"]])
    assert np.diff(arrivals).max() <= 500 * MS, "ArduPilot counts half a second of silence as a dead range finder"


@pytest.mark.long
def test_every_used_range_is_that_of_the_present_in_the_vehicles_own_time(service: SimulatedService) -> None:
    """The smoother's lag makes a range 0.6 s old; it is moved on by the climb rate and stamped at sending."""
    used = [entry for entry in service.world.report()["ranges"] if entry["used"]]
    age_ms = np.array([entry["arrival_boot_ns"] / MS - entry["time_boot_ms"] for entry in used])
    assert age_ms.min() > -5
    assert np.percentile(age_ms, 90) < 100


@pytest.mark.long
def test_the_heartbeat_and_the_plans_tell_how_it_stands(service: SimulatedService) -> None:
    health = [status.health for status in service.tape.of(ServiceStatus)]
    assert health[0] is Health.BOOT
    assert health[-1] is Health.ACTIVE
    assert Health.CRITICAL not in health
    plans = service.tape.of(TriggerPlan)
    assert any(plan.firing is Firing.PEAK for plan in plans)
    assert all(plan.reject is not None for plan in plans if plan.firing is Firing.SKIP)
    assert all(plan.command_host_ns > plan.planned_host_ns > EPOCH_NS for plan in plans if plan.reject is None)


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.timeout(600)
def test_the_demo_flies_in_real_time_and_its_recording_replays_to_what_was_published(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["demo", "--realtime", "--duration", "25", "--no-compare", "--json", "--out", str(tmp_path)]) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary == json.loads((tmp_path / "summary.json").read_text())
    assert (tmp_path / "summary.png").stat().st_size > 10_000
    toe = summary["toe_error_mrad"]
    assert toe["corrected"]["rms"] < 0.1 * toe["rigid"]["rms"]
    assert summary["published"]["received"]["DISTANCE_SENSOR"] > 100
    assert summary["published"]["problems"] == []
    assert summary["sigma"]["published_beyond_5_sigma"] == 0
    assert summary["published"]["ranges_used"] > 50
    assert main(["replay", str(tmp_path / "flight.mcap"), "--json"]) == 0
    replayed = json.loads(capsys.readouterr().out)
    assert replayed["reproduced"] is True
    assert replayed["compared"] > 500

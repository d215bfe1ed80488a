"""Faults strike a tracked flight: nothing crashes, no wrong range goes out, the health tells, and ranges come back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from companion.records import Health
from companion.sim.flight.flight import Flight
from sitl_tests.faults import link_faults
from sitl_tests.faults.link_faults import LinkOutcome
from sitl_tests.faults.lying_samples import ROOT, lie
from sitl_tests.faults.vehicle_faults import FAULTS, Fault, Outcome, build, line, main, strike, table, write

BY_NAME = {fault.name: fault for fault in FAULTS}
HARMLESS = ("none", "flood at 20 x the rate", "foreign TIMESYNC answers")
# what goes missing is missed: ranges stop, the heartbeat says so, and they come back by themselves
HARMFUL = ("link silent both ways", "autopilot reboots, 2 s", "left node reboots, 2 s", "right node sends NaN")
# a clock is locked again after 1.5 s, the tracker settles in 1 s or so, and a range waits for the smoother's lag
RECOVERY_S = 6.0


@pytest.fixture(scope="module")
def flight() -> Flight:
    return build()


@pytest.mark.long
@pytest.mark.parametrize("name", HARMLESS)
def test_what_others_send_changes_nothing(flight: Flight, name: str) -> None:
    outcome = strike(flight, BY_NAME[name])
    assert outcome.wrong == 0
    assert outcome.recovery_s == 0.0
    assert set(outcome.healths) == {Health.ACTIVE}


@pytest.mark.long
@pytest.mark.parametrize("name", HARMFUL)
def test_ranges_stop_truthfully_and_come_back(flight: Flight, name: str) -> None:
    outcome = strike(flight, BY_NAME[name])
    assert outcome.wrong == 0
    assert outcome.trusted > 0
    assert outcome.recovery_s <= RECOVERY_S
    if outcome.gap_s > 2.0:
        assert Health.CRITICAL in outcome.healths
    assert outcome.healths[-1] is Health.ACTIVE


def test_the_table_is_put_between_its_marks_and_replaced(tmp_path: Path) -> None:
    page = tmp_path / "README.md"
    page.write_text("# Tests\n\nwords\n")
    first = Outcome("one", 1.0, 1.5, 100, 3, {"stream stopped": 2}, 0, 50, (Health.ACTIVE, Health.CRITICAL))
    second = Outcome("two", 0.0, 0.2, 100, 0, {}, 0, 90, (Health.ACTIVE,))
    write([first], page)
    assert "| one | active > critical | 1.50 s | 1.00 s | 3 | 2 stream stopped | 50 / 0 |" in page.read_text()
    write([second], page)
    text = page.read_text()
    assert text.startswith("# Tests\n\nwords\n")
    assert "| one |" not in text
    assert text.count("| two |") == 1
    assert table([second]) in text
    write([second], page, [LinkOutcome("cable", "again", 1.25, 3, 0)])
    assert "| cable | again | 1.25 s | 3 | 0 |" in page.read_text()


def test_one_flight_is_told_in_a_line() -> None:
    usual = Outcome("none", 0.0, 0.2, 100, 0, {}, 0, 90, (Health.ACTIVE,))
    worst = Outcome("cut", 1.0, 1.5, 100, 3, {}, 2, 50, (Health.ACTIVE, Health.CRITICAL))
    summary = line(7, [usual, worst])
    assert summary == "seed 7: 2 faults, 140 ranges trusted, 2 wrong; longest time without a range 1.50 s (cut)"


def test_asking_for_help_strikes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["--help"])
    assert stopped.value.code == 0
    assert "--seeds" in capsys.readouterr().out


@pytest.mark.realtime
@pytest.mark.slow
@pytest.mark.parametrize("make", [link_faults.SerialCable, link_faults.TcpCable, link_faults.UdpCable])
def test_a_link_that_breaks_comes_back_with_true_samples(make: Any) -> None:
    outcome = link_faults.broken("", "", make)
    assert outcome.recovery_s < 10.0
    assert outcome.wrong == 0
    assert outcome.lost < 100, "what was sent before it broke had arrived"


# ranges come every 0.18 s or so: a single sample may add 50 ms to the longest pause, a burst or a blow 300 ms
WORST_HANDS = (
    "root z -4 m/s2, one sample",
    "root z 100 m/s2, one sample",
    "left z 1e+30 m/s2, one sample",
    "root p 10 rad/s, one sample",
    "root z +-5 m/s2, 20 ms",
    "blow of 10 m/s2 to the fuselage",
)


@pytest.mark.long
@pytest.mark.parametrize("name", WORST_HANDS)
def test_what_a_sensor_says_for_a_moment_costs_at_most_a_moment(flight: Flight, name: str) -> None:
    usual, outcome = strike(flight, BY_NAME["none"]), strike(flight, BY_NAME[name])
    assert outcome.wrong == 0
    assert set(outcome.healths) == {Health.ACTIVE}
    assert outcome.gap_s <= usual.gap_s + (0.05 if "one sample" in name else 0.3)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(9))
def test_a_root_sample_off_by_4_to_5_never_makes_a_wrong_range(seed: int) -> None:
    rng = np.random.default_rng(seed)
    by, begin_s = float(rng.choice([-1.0, 1.0]) * rng.uniform(4.0, 5.0)), float(rng.uniform(10.5, 16.0))
    usual = strike(build(seed), BY_NAME["none"])
    outcome = strike(build(seed), Fault("root z", hand=lie(ROOT, "zacc", by), begin_s=begin_s))
    assert outcome.wrong == 0
    assert outcome.trusted > 0
    assert outcome.gap_s <= usual.gap_s + 0.05

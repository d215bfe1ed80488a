"""Figures, table and picture of made-up landings."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from companion.cli.main import main
from companion.cli.steps.landing_demo import sentence
from companion.cli.steps.landing_tasks import landing_tasks
from companion.evaluation.landing.false_reading import OneFalseReading
from companion.evaluation.landing.landing_rows import RangeKind, figures
from companion.evaluation.landing.landing_table import cells, markdown
from companion.evaluation.pages.landing_picture import draw_landings
from companion.params.files import load_airframe
from companion.sim.landing.approach import Approach
from companion.sim.landing.landing_flight import LandingFlight, TrueRange


def landed(kind: str, seed: int, flare_m: float, sink_mps: float = 0.5, north_m: float = -10.0) -> dict[str, Any]:
    path = [(0.2 * k, -400.0 + 3.4 * k, max(42.0 - 0.36 * k, 0.0), 42.0 if k < 40 else None) for k in range(120)]
    return {
        "range": kind, "gusts": False, "seed": seed, "outcome": "landed", "why": "", "settings": "",
        "flare": {"t_s": 20.0, "height_m": flare_m, "intended_m": 3.5}, "path": path,
        "touch": {"t_s": 23.5, "north_m": north_m, "east_m": 0.0, "sink_mps": sink_mps, "airspeed_mps": 14.0},
    }  # fmt: skip


def gone_around(kind: str, seed: int) -> dict[str, Any]:
    row = landed(kind, seed, 0.0)
    return row | {"outcome": "went around", "why": "slope too steep", "flare": None, "touch": None}


ROWS = [
    landed("spanwise", 1, 3.6),
    landed("spanwise", 2, 3.2, 0.7, 12.0),
    landed("rigid", 1, 50.0, 4.0),
    gone_around("rigid", 2),
    landed("rigid", 3, 2.0) | {"outcome": "landed without flare", "flare": None},
]


def test_a_flare_half_as_high_again_is_counted() -> None:
    rigid = figures([row for row in ROWS if row["range"] == "rigid"])
    assert (rigid.flights, rigid.landed, rigid.went_around, rigid.no_flare, rigid.high_flares) == (3, 2, 1, 1, 1)
    assert rigid.flare_error_m.tolist() == [46.5]
    spanwise = figures([row for row in ROWS if row["range"] == "spanwise"])
    assert spanwise.high_flares == 0
    assert spanwise.flare_error_m == pytest.approx([0.1, -0.3])
    assert figures([]).flights == 0


def test_the_table_has_a_row_for_each_range_finder_and_air() -> None:
    assert [row[:3] for row in cells(ROWS)] == [("calm", "rigid stereo", "3"), ("calm", "Spanwise", "2")]
    assert "| 0.60 (0.50 to 0.70) | 1 (-10 to 12) |" in markdown(ROWS)
    assert "none" in cells([gone_around("truth", 1)])[0]
    assert cells([landed("truth", 1, 3.6)])[0][3] == "0.1", "a single landing has no extremes"


def test_settings_that_differ_make_a_row_of_their_own() -> None:
    rows = [landed("spanwise", 1, 3.5), landed("spanwise", 1, 3.5) | {"settings": "TRK_LAG=0.1"}]
    assert [row[1] for row in cells(rows)] == ["Spanwise", "Spanwise, TRK_LAG=0.1"]


@pytest.mark.slow
def test_the_picture_is_drawn_for_landings_and_go_arounds(tmp_path: Path) -> None:
    draw_landings(ROWS, tmp_path / "landing.png")
    assert (tmp_path / "landing.png").stat().st_size > 20_000


def test_a_landing_is_told_in_a_line() -> None:
    assert sentence(ROWS[0]) == (
        "seed 1, calm, spanwise: landed, flare at 3.6 m (intended 3.5), touch-down at 0.50 m/s -10 m from the point"
    )
    assert sentence(ROWS[3]).endswith("went around (slope too steep)")


@pytest.mark.long
def test_a_false_reading_comes_once_for_a_tenth_of_a_second_and_the_truth_is_untouched() -> None:
    landing = LandingFlight(load_airframe("nadir-2m"), 4, gusts=False, approach=Approach(height_m=50.0, level_s=1.0))
    false, true = OneFalseReading(landing, (100.0, 120.0)), TrueRange(landing)
    readings = []
    while not landing.over:
        reading, right = false.reading_m(landing.now_ns), true.reading_m(landing.now_ns)
        readings.append((reading, right))
        landing.advance(right)
    wrong = [place for place, (reading, right) in enumerate(readings) if reading != right]
    assert len(wrong) == 5, "periods of 20 ms"
    assert wrong == list(range(wrong[0], wrong[0] + 5))
    assert {readings[place][0] for place in wrong} == {readings[wrong[0]][0]}
    assert 100.0 < (readings[wrong[0]][0] or 0.0) < 120.0


def test_parts_of_different_landings_lie_apart(tmp_path: Path) -> None:
    tasks = [
        task
        for rate in ("TRG_RATE=5", "TRG_RATE=10")
        for task in landing_tasks("nadir-2m", range(3), list(RangeKind), tmp_path, [rate])
    ]
    assert len({task.result_file for task in tasks}) == len(tasks) == 2 * 3 * 2 * len(RangeKind)


def test_a_pair_that_looks_ahead_cannot_land(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--landing", "--airframe", "forward-2m", "--out", str(tmp_path)]) == 1
    assert "does not look down" in capsys.readouterr().err


def test_options_of_the_other_flights_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--landing", "--world", "fair", "--out", str(tmp_path)]) == 1
    assert "leave out" in capsys.readouterr().err

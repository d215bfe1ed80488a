"""A diagnosis in words: what is wrong, what it is worth at 60 m, what to do next; from worked examples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from companion.diagnosis.summary import summary_sentences, worthwhile
from companion.evaluation.pages.diagnosis_page import _views
from companion.evaluation.station_tones import StationAnalysis
from companion.params.files import load_airframe
from companion.records import Axis, ClockName, ImuBatch, Station
from companion.reporting.blocks import Table
from companion.reporting.plotting import with_gaps

CAUSE = {
    "name": "stream-delay",
    "channel": None,
    "group": [],
    "seen_in_samples": None,
    "parameters": {"delay_s": {"value": 0.0052, "sigma": 0.0002, "unit": "s", "meaning": "how much later"}},
    "advice": "strike the fuselage once",
}


def diagnosed(verdict: str, at_60_m: tuple[float, float] | None, **changes: Any) -> dict[str, Any]:
    ranges = {} if at_60_m is None else {"60": {"before": at_60_m[0], "after": at_60_m[1], "unit": "m"}}
    causes = [CAUSE] if verdict == "explained" else []
    near = [CAUSE] if verdict == "unexplained" else []
    return {
        "verdict": verdict,
        "causes": causes,
        "nearest_causes": near,
        "gain": {"range_rms_m": ranges} if verdict != "adequate" else None,
        **changes,
    }


def test_a_cause_is_told_with_its_value_and_what_it_is_worth_in_metres() -> None:
    sentences = summary_sentences(diagnosed("explained", (1.82, 0.46)), [])
    assert "stream-delay (how much later 0.0052 ± 0.0002 s)" in sentences["cause"]
    assert sentences["worth"].startswith("Worth flying: 1.82 m rms become 0.46 m at 60 m")
    assert "--apply" in sentences["next"]
    assert "strike the fuselage once" in sentences["next"]


def test_of_an_unexplained_flight_the_worth_was_not_measured() -> None:
    worth = summary_sentences(diagnosed("unexplained", None, gain=None), [])["worth"]
    assert worth == "What it is worth was not measured on held-out blocks, because no effect explains this recording."
    assert "No image matches" in summary_sentences(diagnosed("explained", None), [])["worth"]


@pytest.mark.parametrize("at_60_m", [(1.82, 1.80), (0.46, 0.43), (0.46, 0.50)])
def test_what_betters_no_range_is_named_but_not_worth_flying(at_60_m: tuple[float, float]) -> None:
    sentences = summary_sentences(diagnosed("explained", at_60_m), [])
    assert sentences["worth"].startswith("Named, but not worth flying")
    assert "--apply" not in sentences["next"]


def test_what_belongs_to_the_recording_is_not_for_the_airframe_file() -> None:
    kick = CAUSE | {"name": "impulsive-forcing"}
    sentences = summary_sentences(diagnosed("explained", None, causes=[kick]), [])
    assert "--apply" not in sentences["next"]
    assert "Not for the airframe file, for it belongs to this recording: impulsive-forcing." in sentences["next"]
    assert "--apply" in summary_sentences(diagnosed("explained", None, causes=[kick, CAUSE]), [])["next"]


def test_the_gain_is_told_in_mrad_of_toe_too() -> None:
    plain = diagnosed("explained", (1.82, 0.46))
    plain["gain"]["toe_rms_rad"] = {"before": 1.0e-3, "after": 0.25e-3}
    assert "(1.00 to 0.25 mrad of relative toe)" in summary_sentences(plain, [])["worth"]


def test_without_matches_nothing_is_said_in_metres() -> None:
    plain = diagnosed("explained", None)
    assert worthwhile(plain) is None
    assert "its worth in metres is unknown" in summary_sentences(plain, [])["worth"]
    assert " m rms" not in summary_sentences(plain, [])["worth"]


def test_an_adequate_recording_asks_for_nothing() -> None:
    sentences = summary_sentences(diagnosed("adequate", None), ["left 7.3 Hz, 4.0 m/s^2"])
    assert sentences["next"] == "Fly on."
    assert "7.3 Hz" not in sentences["cause"]


def test_a_frequency_far_off_in_its_prior_is_told_where_nothing_is_named() -> None:
    rows = [
        {"name": name, "deviation": np.log(ratio), "prior_sigmas_away": away}
        for name, ratio, away in (
            ("symmetric.frequency", 0.85, -2.1), ("antisymmetric.frequency", 1.02, 0.3), ("left.noise", 9.0, 2.5)
        )
    ]  # fmt: skip
    sentences = summary_sentences(diagnosed("adequate", None, airframe_parameters=rows), [])
    assert "with symmetric.frequency -15 % (2.1 sigmas), which" in sentences["cause"]
    assert "spanwise identify flight" in sentences["next"]
    assert "Fly on" not in sentences["next"]


def test_a_steady_tone_is_named_where_no_effect_explains_the_recording() -> None:
    sentences = summary_sentences(diagnosed("unexplained", None), ["left 7.306 Hz, 3.98 m/s^2"])
    assert "left 7.306 Hz, 3.98 m/s^2" in sentences["cause"]
    assert "propeller" in sentences["next"]
    assert "no effect of the catalogue explains it" in sentences["cause"]


def test_the_tones_of_stations_are_told_where_most_windows_have_one() -> None:
    airframe = load_airframe("sitl-plane")
    stations, rng = StationAnalysis(airframe), np.random.default_rng(1)
    t_s = np.arange(0.0, 12.0, 0.003)
    for station, amplitude in ((Station.ROOT, 0.0), (Station.LEFT, 4.0), (Station.RIGHT, 3.6)):
        values = np.zeros((len(t_s), 6))
        values[:, 2] = amplitude * np.sin(2 * np.pi * 7.3 * t_s) - 9.8 + rng.normal(0.0, 0.1, len(t_s))
        t_ns = np.rint(1e9 * t_s).astype(np.int64)
        for first in range(0, len(t_s), 400):
            window = slice(first, first + 400)
            stations.add(ImuBatch(station, ClockName.BOOT, t_ns[window], values[window], Axis.Z, int(t_ns[window][-1])))
    sentences = stations.sentences()
    assert [line.split()[0] for line in sentences] == ["left", "right"]
    for line in sentences:
        assert float(line.split()[1]) == pytest.approx(7.3, abs=0.01)


def test_the_views_are_sorted_by_change_and_the_worst_left_is_marked() -> None:
    views = [
        {"view": "small", "before": 2.0, "after": 1.5},
        {"view": "large", "before": 50.0, "after": 3.0},
        {"view": "left over", "before": 9.0, "after": -8.0},
    ]
    table = _views({"views": views})[1]
    assert isinstance(table, Table)
    assert [row[0] for row in table.rows] == ["large", "left over", "small"]
    assert table.worst == 1


def test_a_gap_in_time_is_a_break_in_the_line() -> None:
    t_s = np.array([0.0, 0.1, 0.2, 0.3, 2.0, 2.1, 2.2])
    drawn_s, drawn = with_gaps(t_s, np.arange(7.0))
    assert np.flatnonzero(np.isnan(drawn)).tolist() == np.flatnonzero(np.isnan(drawn_s)).tolist() == [4]
    np.testing.assert_array_equal(drawn[~np.isnan(drawn)], np.arange(7.0))
    assert not np.isnan(with_gaps(t_s[:4], np.arange(4.0))[1]).any()

"""The audit's report and scores: self-contained, finite, complete; held by worked examples, not by its text."""

from __future__ import annotations

import importlib
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from companion.cli.main import main
from companion.evaluation.metrics import rms
from companion.evaluation.true_geometry import TrueReading
from companion.paper import beam_tables, equations, fig_4, misprints, printed, range_tables, report
from companion.paper.findings import Section, number, percent
from companion.paper.scores import errors
from companion.paper.shots import SlopeSpread
from companion.paper.trials import FULL, QUICK, REPEATED, SEEDS, SETTLE_S, Pace, flight_plan, trials
from companion.params.files import load_airframe


class _Links(HTMLParser):
    """Everything a page would have to fetch or run, and the tags left open."""

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.fetched += [str(value) for name, value in attrs if name in ("src", "href", "data") and value]
        if tag in ("script", "link", "iframe"):
            self.fetched.append(tag)
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def sections() -> list[Section]:
    return [misprints.section(), beam_tables.section(), range_tables.section(), equations.section(), fig_4.section()]


def test_the_page_needs_nothing_from_anywhere(sections: list[Section], tmp_path: Path) -> None:
    pages = {path.name: path.read_text(encoding="utf-8") for path in report.write(sections, tmp_path / "new" / "out")}
    links = _Links()
    links.feed(pages["report.html"])
    assert not links.open
    assert all(link.startswith(("#", "data:image/svg+xml;base64,")) for link in links.fetched)
    anchors = set(re.findall(r'id="([^"]+)"', pages["report.html"]))
    assert {link[1:] for link in links.fetched if link.startswith("#")} == anchors
    assert not re.search(r"url\(|@import", pages["report.html"])
    pictures = sum(len(section.pictures) for section in sections)
    assert len(re.findall(r"--readable: [1-9]\d+px", pages["report.html"])) == pictures > 0


def test_every_section_is_in_all_three_files(sections: list[Section], tmp_path: Path) -> None:
    html, markdown, numbers = (path.read_text(encoding="utf-8") for path in report.write(sections, tmp_path))
    data = json.loads(numbers, parse_constant=lambda name: pytest.fail(f"{name} in the JSON"))
    assert list(data) == [section.key for section in sections]
    for section in sections:
        assert f">{section.title}</h2>" in html
        assert f"## {section.title}" in markdown


def test_markdown_tables_are_rectangular(sections: list[Section], tmp_path: Path) -> None:
    markdown = report.write(sections, tmp_path)[1].read_text(encoding="utf-8")
    widths = [len(re.split(r"(?<!\\)\|", line)) for line in markdown.splitlines() if line.startswith("|")]
    blocks = re.split(r"\n(?!\|)", markdown)
    for block in blocks:
        rows = [line for line in block.splitlines() if line.startswith("|")]
        assert len({len(re.split(r"(?<!\\)\|", row)) for row in rows}) <= 1
    assert len(widths) > 40


def test_every_implementation_that_the_audit_names_exists() -> None:
    for entry in equations.audit():
        if entry.label == "7":
            continue  # its misprint is not implemented anywhere
        path, *further = entry.implementation.split(", ")
        names = path.split(".")
        for depth in range(len(names), 0, -1):
            try:
                implementation: object = importlib.import_module(".".join(["companion", *names[:depth]]))
            except ModuleNotFoundError:
                continue
            for name in names[depth:]:
                parent, implementation = implementation, getattr(implementation, name)
            assert all(hasattr(parent, name) for name in further)
            break
        else:
            pytest.fail(f"companion.{path} is no module")


# ------------------------------------------------------------------------------------------------ misprints


@pytest.mark.parametrize(
    ("where", "wanted"),
    [
        ("Eq. 7", "12, 23, 31, 32"),
        ("Eq. 12", "3.87"),
        ("Stereo vision, last paragraph", "5.197"),
        ("Table 1, A", "5.07e-05"),
        ("Table 1, I", "4.225e-12"),
        ("Table 1, m", "2.260, 2.389, 2.329"),
        ("Table 2, first beta*l", "1.034"),
        ("Table 2, first frequency", "20.1021"),
        ("Table 3", "4.478, 5.370, 5.818"),
        ("Table 4, corrected", "56.85"),
        ("Table 4, text", "55.56"),
    ],
)
def test_each_audited_misprint_is_listed_with_its_number(where: str, wanted: str) -> None:
    misprint_entries = [entry for entry in misprints.misprints() if entry.where == where]
    assert len(misprint_entries) == 1
    assert wanted in misprint_entries[0].instead + misprint_entries[0].shown_by


def test_table_1_s_repairs_are_factors_of_the_print() -> None:
    ratio = {entry.what: entry.printed / entry.corrected for entry in beam_tables.properties()}
    assert ratio["E"] == pytest.approx(1e9)
    assert ratio["I"] == pytest.approx(100.0)
    assert ratio["A"] == pytest.approx(3.07e-8 / (0.0507 * 0.001))
    assert ratio["m"] == pytest.approx(0.035 / 36.5)
    assert ratio["rho"] == ratio["l"] == 1.0


# ------------------------------------------------------------------------------------------------ scores


def test_errors_of_a_worked_example() -> None:
    """10 m read as 8 and as 12.5 m, one beyond infinity, one without reading."""
    readings = [TrueReading(1 / 8, 0.1), TrueReading(1 / 12.5, 0.1), TrueReading(-0.02, 0.1), None]
    scores = errors(readings)
    assert (scores["n"], scores["without"], scores["beyond_infinity"]) == (3, 1, 1)
    assert scores["rms_percent"] == pytest.approx(math.sqrt((20**2 + 25**2) / 2))
    assert scores["median_range_m"] == pytest.approx((8 + 12.5) / 2)
    assert scores["inverse_rms_pm"] == pytest.approx(math.sqrt((0.025**2 + 0.02**2 + 0.12**2) / 3))


def test_scores_of_nothing_are_not_numbers() -> None:
    scores = errors([None])
    assert math.isnan(scores["rms_percent"])
    assert math.isnan(rms([]))
    assert percent(scores["rms_percent"]) == "-"


@pytest.mark.parametrize("phase_deg", [0.0, 12.0, 45.0, 80.0, 90.0])
def test_the_phase_of_a_sine_counts_from_its_peaks(phase_deg: float) -> None:
    amplitude, omega, angle = 0.003, 37.0, math.radians(phase_deg)
    spread = SlopeSpread(
        np.full(2, amplitude / math.sqrt(2)), np.full(2, amplitude * omega / math.sqrt(2)), np.zeros(2)
    )
    for turn in (angle, math.pi - angle, math.pi + angle, -angle):
        slope, rate = amplitude * math.cos(turn), -amplitude * omega * math.sin(turn)
        assert spread.phase_deg(1, slope, rate) == pytest.approx(phase_deg, abs=1e-9)


def test_numbers_are_written_as_a_person_would() -> None:
    assert [number(value) for value in (0.0, 1.5, 20.10574, 1.1e9, None, math.nan)] == [
        "0", "1.500", "20.11", "1.100e+09", "-", "-",
    ]  # fmt: skip
    assert percent(-0.00001) == "0.00\u00a0%"  # no minus zero
    assert percent(1e7) == "factor 1.0e+07"


# ------------------------------------------------------------------------------------------------ trials


def test_every_printed_distance_is_flown() -> None:
    flown = {trial.distance_m: trial for trial in trials() if trial.airframe == "paper-flying-wing"}
    for entry in printed.OBJECTS:
        assert flown[entry.still_m].paper_before_percent == entry.error_percent
    assert flown[printed.FAR_M] is not None
    for name, baseline_m in (("paper-beam", printed.BEAM_BASELINE_M), ("paper-flying-wing", printed.BASELINE_M)):
        airframe = load_airframe(name)
        assert airframe.left_camera is not None
        assert airframe.right_camera is not None
        apart = airframe.right_camera.position_m[1] - airframe.left_camera.position_m[1]
        assert apart == pytest.approx(baseline_m)


def test_shots_begin_when_a_user_would_trust_them_and_manoeuvres_fall_among_them() -> None:
    assert SETTLE_S >= 15.0
    for pace in (FULL, QUICK):
        assert pace.from_s >= SETTLE_S
        plan = flight_plan(next(trial for trial in trials() if trial.manoeuvres), pace)
        assert all(pace.from_s - 2 < roll.from_s < pace.duration_s - 2 for roll in plan.rolls)
        assert all(pace.from_s < pull.from_s < pace.duration_s - 2 for pull in plan.pull_ups)


def test_what_is_repeated_is_of_the_paper_and_exists() -> None:
    of_paper = {trial.key for trial in trials() if trial.of_paper}
    assert set(REPEATED) <= of_paper
    assert len(SEEDS) >= 3


def test_keys_are_unique_and_no_experiment_is_left_out_of_a_section() -> None:
    keys = [trial.key for trial in trials()]
    assert len(set(keys)) == len(keys)
    assert {trial.of_paper for trial in trials()} == {True, False}


@pytest.mark.parametrize("seeds", ["five", "5;6", "", "5,-1"])
def test_seeds_that_are_none_are_wrong_usage(seeds: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["paper", "--seeds", seeds])
    assert stopped.value.code == 2
    assert "seed" in capsys.readouterr().err


@pytest.mark.slow
def test_one_seed_gives_one_report() -> None:
    """Equal to the last bit, or the README's figures could not be repeated."""
    trial = next(trial for trial in trials() if trial.key == "wing_60m")
    first, second = (report.at_peaks(trial, Pace(17.0), 6) for _ in range(2))
    assert first["shots"]
    assert json.dumps(first) == json.dumps(second)

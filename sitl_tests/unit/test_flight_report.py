"""``spanwise report``: the verdict of a flight from its own records, and a page that needs nothing else."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.cli.main import main
from companion.evaluation.flight_log import FlightLog, Spectrum, gather
from companion.evaluation.pages import flight_figures as figures
from companion.evaluation.pages.flight_report import FlightVerdict, lines_sentence
from companion.evaluation.pages.flight_report import verdict as verdict_of
from companion.evaluation.recording_info import AT_THE_END
from companion.params.airframe import Airframe, Uncertain
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import (
    Axis,
    ClockName,
    ClockState,
    CorrectedRange,
    Firing,
    Health,
    ImuBatch,
    ModeEstimate,
    ModeState,
    Record,
    Reject,
    Rejected,
    ServiceStatus,
    Shot,
    Station,
    TriggerPlan,
    Validity,
    VehicleState,
)

AIRFRAME = load_airframe("nadir-2m")
SECOND_NS = 1_000_000_000
LINE_HZ, MODE_HZ = 80.0, 5.0


def ranged(number: int, *, trusted: bool = True, rigid_m: float = 30.0) -> CorrectedRange:
    reject = None if trusted else Reject.SIGMA_TOO_LARGE
    at_ns = number * SECOND_NS // 2
    return CorrectedRange(number, number, at_ns, 25, 60.0, 0.6, 4e-3, 1e-4, rigid_m, 40, trusted, reject)


def mode(at_ns: int, validity: Validity = Validity.TRACKING) -> ModeState:
    estimate = ModeEstimate(MODE_HZ, 0.02, 0.03, 0.002, 0.004, 0.0002, 0.3, 0.05, MODE_HZ, 0.1, 0.003)
    axes = (Axis.ALL, Axis.ALL, Axis.ALL)
    return ModeState(at_ns, estimate, estimate, validity, np.zeros(2), np.full(2, 1e-4), tuple(Station), axes)


def shaken(station: Station) -> list[ImuBatch]:
    """Twenty seconds at 1 kHz: white noise, and at the tips a propeller's line."""
    t_ns = np.arange(20_000, dtype=np.int64) * 1_000_000
    values = np.zeros((len(t_ns), 6))
    values[:, 2] = np.random.default_rng(station).normal(0.0, 0.1, len(t_ns))
    if station is not Station.ROOT:
        values[:, 2] += 0.5 * np.sin(2.0 * np.pi * LINE_HZ * t_ns * 1e-9)
    clock = ClockName.HOST
    return [
        ImuBatch(station, clock, t_ns[i : i + 100], values[i : i + 100], Axis.ALL, int(t_ns[i + 99]))
        for i in range(0, len(t_ns), 100)
    ]


def flight() -> list[Record]:
    records: list[Record] = [batch for station in Station for batch in shaken(station)]
    for number in range(40):
        at_ns = number * SECOND_NS // 2
        plan = TriggerPlan(number, Firing.PEAK, at_ns, at_ns, 1_000_000, 0.3, at_ns + 10, at_ns)
        records += [mode(at_ns), plan, Shot(number, at_ns, at_ns + 20_000), ranged(number, trusted=number % 4 != 0)]
        records.append(ClockState(ClockName.NODE_LEFT, at_ns, 7, 1.0, 150_000, True))
    records.append(Rejected(Reject.CLOCK_UNSYNCED, "left <b>", SECOND_NS, 3))
    records.append(ServiceStatus(10 * SECOND_NS, Health.ACTIVE, ""))
    return records


def verdict(log: FlightLog, airframe: Airframe = AIRFRAME) -> FlightVerdict:
    return verdict_of(SimpleNamespace(path=Path("flight.tlog"), airframe=airframe), log)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def log() -> FlightLog:
    return gather(flight())


def test_peaks_of_manoeuvres_and_of_the_wing_are_no_vibration_lines() -> None:
    f_hz = np.arange(0.0, 150.0, 0.125)
    density = np.full(len(f_hz), 1e-4)
    for peak_hz in (0.5, 5.125, 28.0, 84.0):
        density[round(peak_hz / 0.125)] = 1.0
    assert Spectrum(f_hz, density).lines_hz() == pytest.approx([5.125, 28.0, 84.0])
    assert Spectrum(f_hz, density, (5.0, 6.5)).lines_hz() == pytest.approx([28.0, 84.0])


def test_a_line_where_a_higher_mode_is_believed_is_named_so() -> None:
    f_hz = np.arange(0.0, 150.0, 0.125)
    density = np.full(len(f_hz), 1e-4)
    density[[round(peak_hz / 0.125) for peak_hz in (28.0, 84.0)]] = 2.0, 1.0
    text = lines_sentence({Station.LEFT: Spectrum(f_hz, density)}, AIRFRAME.wing)
    assert "28.0 Hz (perhaps the second symmetric mode)" in text
    assert text.endswith(", 84.0 Hz"), "a propeller's line is no mode"
    assert "No sharp line" in lines_sentence({}, AIRFRAME.wing)


def test_the_nearest_of_two_higher_modes_is_named() -> None:
    """28 Hz are 0.3 sigma from the one and 1.4 from the other, whichever comes first."""
    second = AIRFRAME.wing.second_symmetric
    assert second is not None
    wide, narrow = Uncertain(27.0, 3.0), Uncertain(26.6, 1.0)
    density = np.full(1200, 1e-4)
    density[round(28.0 / 0.125)] = 2.0
    spectra = {Station.LEFT: Spectrum(np.arange(0.0, 150.0, 0.125), density)}
    for symmetric, antisymmetric, nearest in ((wide, narrow, "symmetric"), (narrow, wide, "antisymmetric")):
        wing = dataclasses.replace(
            AIRFRAME.wing,
            second_symmetric=dataclasses.replace(second, frequency_hz=symmetric),
            second_antisymmetric=dataclasses.replace(second, frequency_hz=antisymmetric),
        )
        assert f"28.0 Hz (perhaps the second {nearest} mode)" in lines_sentence(spectra, wing)


def test_a_propellers_line_is_told_at_the_tips_and_not_at_the_root(log: FlightLog) -> None:
    for station in (Station.LEFT, Station.RIGHT):
        spectrum = log.spectrum(station)
        assert spectrum is not None
        assert spectrum.lines_hz()[0] == pytest.approx(LINE_HZ, abs=0.125)
    root = log.spectrum(Station.ROOT)
    assert root is not None
    assert root.lines_hz() == []
    band = root.f_hz[1] - root.f_hz[0]
    assert np.sum(root.density) * band == pytest.approx(0.01, rel=0.05), "the density adds up to the variance"


def test_the_verdict_counts_what_was_published_and_says_why_not_the_rest(log: FlightLog) -> None:
    judged = verdict(log)
    assert (judged.word, judged.grade) == ("usable", "good")
    assert "Usable: 30 of 40 ranges were published (75 %), median sigma 1.0 % of the range" in judged.headline
    assert any("10 withheld: sigma too large" in reason for reason in judged.reasons)


def test_a_long_silence_or_mostly_withheld_ranges_are_no_good_flight() -> None:
    withheld = verdict(gather([mode(0), *(ranged(i, trusted=i < 3) for i in range(10))]))
    assert (withheld.word, withheld.grade) == ("often withheld", "poor")
    late = dataclasses.replace(ranged(1), t_host_ns=60 * SECOND_NS)
    silent = verdict(gather([mode(0), ranged(0), late]))
    assert (silent.word, silent.grade) == ("with long silences", "poor")
    assert any("longest time without a range was 60.0 s" in reason for reason in silent.reasons)


def at(t_s: float, *, trusted: bool = True) -> CorrectedRange:
    return dataclasses.replace(ranged(0, trusted=trusted), t_host_ns=round(t_s * SECOND_NS))


def state(t_s: float, *, on_ground: bool) -> VehicleState:
    at_ns = round(t_s * SECOND_NS)
    return VehicleState(at_ns, at_ns, 0.0, 0.0, 0.0, 20.0, 0.0, 0.5, armed=True, on_ground=on_ground)


def test_the_wait_for_the_first_range_and_the_longest_after_it_are_both_said() -> None:
    every_second = [at(t_s) for t_s in np.arange(12.0, 30.0)]
    judged = verdict(gather([mode(0), *every_second, at(33.0)]))
    first, longest = judged.reasons
    assert first == "first published range exposed 12.0 s after the recording's begin (the wing is learned before)"
    assert longest == "after it, the longest time without a range was 4.0 s"
    assert judged.word == "usable", "a warm-up of this length is what a wing takes"
    slow = verdict(gather([mode(0), at(31.0), at(32.0)]))
    assert (slow.word, slow.grade) == ("late", "fair")


def test_shots_that_gave_no_range_are_counted() -> None:
    shots = [Shot(number, number, number) for number in range(20)]
    lost = Rejected(Reject.FRAME_LOST, "left frames", SECOND_NS, 9)
    ranges = [ranged(number) for number in range(11)]
    sentence = "11 ranges came of 20 shots; 9 images never came: spanwise doctor --log says what to mend"
    assert sentence in verdict(gather([mode(0), *shots, lost, *ranges])).reasons
    assert not any("shots" in reason for reason in verdict(gather([mode(0), *shots[:12], *ranges])).reasons)


def test_ranges_that_end_before_the_samples_do_are_a_silence() -> None:
    samples = shaken(Station.ROOT)  # until 20 s
    log = gather([mode(0), at(1.0), at(2.0), *samples])
    assert log.published.longest_silence_s == pytest.approx(18.0, abs=0.01)
    assert verdict(log).word == "with long silences"


def test_on_the_ground_no_range_is_waited_for() -> None:
    before = [state(t_s, on_ground=True) for t_s in np.arange(0.0, 100.0)]
    flown = [at(t_s) for t_s in np.arange(104.0, 120.0)]
    after = [state(t_s, on_ground=True) for t_s in np.arange(121.0, 200.0)]
    log = gather([mode(0), *before, state(100.0, on_ground=False), *flown, *after])
    assert log.published.first_s == pytest.approx(5.0)
    assert log.published.longest_silence_s == pytest.approx(2.0)
    assert "5.0 s after lift-off" in verdict(log).reasons[0]


def test_modes_are_medians_of_the_tracked_flight_and_not_its_last_state() -> None:
    slower = dataclasses.replace(mode(0).symmetric, frequency_hz=4.0)
    untracked = dataclasses.replace(mode(9, Validity.STALE), symmetric=slower)
    summary = gather([mode(0), mode(1), dataclasses.replace(mode(2), symmetric=slower), untracked]).mode("symmetric")
    assert summary is not None
    assert (summary.frequency_hz, summary.rms_m) == (MODE_HZ, 0.003)
    assert gather([untracked]).mode("symmetric") is None


def stopped_plan(number: int, planned_s: float) -> TriggerPlan:
    at_ns = round(planned_s * SECOND_NS)
    return TriggerPlan(number, Firing.SKIP, at_ns, at_ns, 0, 0.3, at_ns, at_ns, Reject.STALE)


def test_plans_after_the_last_sample_are_the_end_of_the_flight_and_no_stopped_stream() -> None:
    samples = shaken(Station.ROOT)  # until 20 s
    plans = [stopped_plan(1, 12.0), *(stopped_plan(number, 20.0 + 0.1 * number) for number in (2, 3, 4))]
    outcomes = gather([*samples, *plans]).plan_outcomes()
    assert outcomes == {"skipped: stream stopped": 1, f"skipped: {AT_THE_END}": 2}, "the newest still waits"
    # a service that goes on for long without samples has lost them: no end of a flight
    status = ServiceStatus(60 * SECOND_NS, Health.CRITICAL, "stale")
    assert gather([*samples, *plans, status]).plan_outcomes() == {"skipped: stream stopped": 3}


def test_refusals_add_up_to_the_sum_that_stands_above_them(log: FlightLog) -> None:
    rows = figures.refusals_by_reason(log)
    assert {reason: count for reason, (count, _) in rows.items()} == {
        "clock not synced": 3,
        "range withheld: sigma too large": 10,
    }
    assert len(rows["clock not synced"][1]) == 1, "one message stands for three samples"


def test_blur_is_told_apart_by_the_distance_of_the_scene() -> None:
    """Flight past a near scene blurs more: its hump has a name."""
    plans = [TriggerPlan(k, Firing.PEAK, k, k, 1, blur, k, k) for k, blur in enumerate((0.3, 0.4, 1.8))]
    far, near = dataclasses.replace(ranged(0), range_m=100.0), dataclasses.replace(ranged(1), range_m=20.0)
    groups = figures.blur_by_nearness(*gather([plans[0], far, plans[1], near, plans[2]]).blur_px())
    assert {name: blur.tolist() for name, blur in groups.items()} == {
        "beyond 45 m": [0.4],
        "within 45 m": [1.8],
        "no range yet": [0.3],
    }


def test_without_wing_or_cameras_the_verdict_says_so() -> None:
    assert "Nothing was estimated" in verdict(gather([])).headline
    assert "No range was measured: the cameras gave" in verdict(gather([mode(0)])).headline
    blind = load_airframe("sitl-plane")
    assert verdict(gather([mode(0)]), blind).headline == "No range was measured: the airframe has no cameras"


@pytest.mark.slow
def test_the_command_writes_one_page_that_refers_to_nothing_outside(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "flight.mcap"
    writer = McapWriter(path, About.of(AIRFRAME, Settings()))
    for record in flight():
        writer.write(record)
    writer.close()
    assert main(["report", str(path)]) == 0
    assert "30 of 40 ranges" in capsys.readouterr().out
    text = (tmp_path / "flight.html").read_text(encoding="utf-8")
    for outside in ("http://", "https://", "<script", "<link"):
        assert outside not in text
    assert text.count("data:image/png;base64,") == 6
    assert "<title>Flight: usable</title>" in text
    assert "All settings had their defaults." in text
    assert "nan" not in text.split("base64")[0].lower()


def test_a_recording_whose_name_is_no_utf_8_has_its_page(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"bare\xff.mcap")
    writer = McapWriter(path, About.of(AIRFRAME, Settings()))
    writer.write(shaken(Station.ROOT)[0])
    writer.close()
    assert main(["report", str(path)]) == 3
    assert "bare\\udcff.mcap" in path.with_suffix(".html").read_text(encoding="utf-8")


def test_a_recording_without_modes_or_ranges_ends_with_3(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bare.mcap"
    writer = McapWriter(path, About.of(AIRFRAME, Settings()))
    writer.write(shaken(Station.ROOT)[0])
    writer.close()
    assert main(["report", str(path), "--out", str(tmp_path / "bare.html")]) == 3
    assert (tmp_path / "bare.html").exists()
    assert main(["report", str(path), "--out", str(tmp_path / "no" / "bare.html")]) == 1
    assert "no folder" in capsys.readouterr().err


@pytest.mark.filterwarnings("error")
def test_the_page_of_the_folder_that_one_stands_in_lies_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = tmp_path / "lab"
    lab.mkdir()
    (lab / "accel.csv").write_text("t_s,left_z_mps2\n" + "".join(f"{0.002 * i},-9.8\n" for i in range(200)))
    monkeypatch.chdir(lab)
    assert main(["report", ".", "--airframe", "nadir-2m"]) == 3
    assert (tmp_path / "lab.html").is_file()


def test_folders_whose_names_differ_behind_a_dot_have_pages_of_their_own(tmp_path: Path) -> None:
    """Each took the page of the other."""
    for name in ("run.1", "run.2"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "accel.csv").write_text(
            "t_s,left_z_mps2\n" + "".join(f"{0.002 * i},-9.8\n" for i in range(200))
        )
        assert main(["report", str(tmp_path / name), "--airframe", "nadir-2m"]) == 3
    assert sorted(path.name for path in tmp_path.glob("*.html")) == ["run.1.html", "run.2.html"]


@pytest.mark.slow
def test_a_flight_too_short_for_spectra_says_so_instead_of_an_empty_picture(tmp_path: Path) -> None:
    path = tmp_path / "short.mcap"
    writer = McapWriter(path, About.of(AIRFRAME, Settings()))
    for record in flight():
        if not isinstance(record, ImuBatch) or record.received_host_ns < 15 * SECOND_NS:
            writer.write(record)
    writer.close()
    assert main(["report", str(path)]) == 0
    text = (tmp_path / "short.html").read_text(encoding="utf-8")
    assert "No spectra: they need 16 s" in text
    assert text.count("data:image/png;base64,") == 5


@pytest.mark.slow
def test_a_recording_that_was_cut_off_says_so_beneath_its_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cut.mcap"
    writer = McapWriter(path, About.of(AIRFRAME, Settings()))
    for record in flight():
        writer.write(record)
    writer.close()
    path.write_bytes(path.read_bytes()[:-2000])
    assert main(["report", str(path)]) == 0
    assert "note: cut.mcap: truncated at" in capsys.readouterr().out
    assert "of flight, cut off while recording" in (tmp_path / "cut.html").read_text(encoding="utf-8")


def test_a_log_without_estimates_is_not_said_to_show_no_wing() -> None:
    samples = shaken(Station.ROOT)
    for airframe, name in ((AIRFRAME, "nadir-2m"), (dataclasses.replace(AIRFRAME, name="my-wing"), "FILE.toml")):
        said = verdict(gather(samples), airframe).headline
        assert said.startswith("Nothing was estimated in this recording: ")
        assert f"spanwise replay flight.tlog --airframe {name} --out NEW.mcap does" in said
    unsynced = ClockState(ClockName.BOOT, SECOND_NS, 0, 0.0, SECOND_NS, synced=False)
    assert "No wing was tracked" in verdict(gather([unsynced, *samples])).headline

"""``spanwise info``: streams, rates, gaps and losses of a recording, as it was written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from companion.adapters.recordings.mcap.writer import About, McapWriter
from companion.adapters.recordings.recording_factory import open_recording
from companion.cli.main import main
from companion.evaluation.recording_info import AT_THE_END, RecordingInfo, StreamInfo, summarise
from companion.params.files import load_airframe
from companion.params.settings import Settings
from companion.records import Axis, ClockName, Health, ImuBatch, Notice, Reject, Rejected, ServiceStatus, Shot, Station
from companion.service.pace import Overload
from companion.sim.flight.flight import build_flight
from sitl_tests.loop.simulated_service import SimulatedService

AIRFRAME = load_airframe("nadir-2m")
STEP_NS = 1_000_000
S = 1_000_000_000


def batch(station: Station, first_ns: int, count: int) -> ImuBatch:
    t_ns = first_ns + STEP_NS * np.arange(count, dtype=np.int64)
    return ImuBatch(station, ClockName.HOST, t_ns, np.zeros((count, 6)), Axis.ACCEL, int(t_ns[-1]))


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """Two seconds of all stations at 1 kHz; the left node is silent for 0.3 s."""
    path = tmp_path / "flight.mcap"
    writer = McapWriter(path, About.of(AIRFRAME, Settings().replace("RNG_MATCHES", 20)))
    for start in range(0, 2_000, 20):
        for station in Station:
            if station is not Station.LEFT or not 1_000 <= start < 1_300:
                writer.write(batch(station, start * STEP_NS, 20))
    writer.write(Rejected(Reject.CLOCK_UNSYNCED, "left", 2_000 * STEP_NS, 7))
    writer.close()
    return path


def test_streams_have_their_true_rate_and_their_gaps(recorded: Path) -> None:
    info = summarise(open_recording(recorded))
    assert {station: stream.samples for station, stream in info.streams.items()} == {
        Station.ROOT: 2000,
        Station.LEFT: 1700,
        Station.RIGHT: 2000,
    }
    left, right = info.streams[Station.LEFT], info.streams[Station.RIGHT]
    assert left.rate_hz == pytest.approx(1000.0), "a gap is no slow rate"
    assert left.gaps() == (1, pytest.approx(0.301))
    assert right.gaps() == (0, 0.0)
    assert info.duration_s == pytest.approx(1.999)
    assert info.rejected == {"clock not synced": 7}


def test_the_screen_names_what_is_there_and_what_was_changed(
    recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(recorded)]) == 0
    screen = capsys.readouterr().out
    assert "left  1700 samples of xyz at 1000.0 Hz, 1 gap, 0.30 s together" in screen
    assert "7 clock not synced" in screen
    assert "RNG_MATCHES 20" in screen
    assert "can be used for: spanwise replay (estimates as published), spanwise diagnose" in screen
    assert max(map(len, screen.splitlines())) < 200
    assert len(screen.splitlines()) < 25


def test_a_cut_recording_says_how_far_it_goes(recorded: Path, capsys: pytest.CaptureFixture[str]) -> None:
    all_bytes = recorded.read_bytes()
    recorded.write_bytes(all_bytes[: len(all_bytes) * 9 // 10])
    code = main(["info", str(recorded)])
    out = capsys.readouterr()
    assert code in (0, 3)
    assert "truncated" in out.out


def test_what_is_no_recording_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.txt").write_text("nothing")
    assert main(["info", str(tmp_path / "notes.txt")]) == 1
    assert "not a recording that can be read" in capsys.readouterr().err
    assert main(["info", str(tmp_path / "absent.mcap")]) == 1
    assert "no such file" in capsys.readouterr().err


def test_a_file_or_folder_that_cannot_be_read_is_called_what_it_is(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "bare").mkdir()
    for path, sentence in (
        (tmp_path / "empty.mcap", "is empty (0 bytes)"),
        (recorded.parent, "a folder with recordings; give one of them: empty.mcap, flight.mcap"),
        (tmp_path / "bare", "no accel.csv in this folder, and no recording"),
    ):
        assert main(["info", str(path)]) == 1
        assert sentence in capsys.readouterr().err


def test_a_foreign_log_is_shown_without_its_airframe(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = "".join(f"{i / 500},-9.81,-9.80\n" for i in range(600))
    (tmp_path / "accel.csv").write_text("t_s,left_z_mps2,right_z_mps2\n" + rows)
    assert main(["info", str(tmp_path)]) == 0
    printed = capsys.readouterr()
    assert "left  600 samples of z at 500.0 Hz" in printed.out
    assert "note: no --airframe: read as sitl-plane" in printed.err


def test_repeated_stamps_and_empty_batches_give_no_rate_and_no_gap() -> None:
    stream = StreamInfo()
    for count in (0, 3):
        repeated = np.full(count, 9, dtype=np.int64)
        stream.add(ImuBatch(Station.ROOT, ClockName.HOST, repeated, np.zeros((count, 6)), Axis.ALL, 9))
        assert stream.rate_hz is None
    assert stream.gaps() == (0, 0.0)


def test_stamps_that_go_back_last_no_negative_time() -> None:
    info = RecordingInfo()
    stamps_ns = [np.array([0, -1_000_000_000]), np.array([-2_000_000_000, -500_000_000])]
    for t_ns in stamps_ns:
        info.add(ImuBatch(Station.LEFT, ClockName.HOST, t_ns, np.zeros((2, 6)), Axis.Z, 0))
    assert info.duration_s == pytest.approx(2.0)


@pytest.mark.slow
def test_samples_that_are_recorded_as_bytes_and_as_records_count_once(tmp_path: Path) -> None:
    path = tmp_path / "flight.mcap"
    service = SimulatedService(build_flight(AIRFRAME, 1, 4.0), recording=path)
    service.fly(3.0)
    service.close()
    root = summarise(open_recording(path)).streams[Station.ROOT]
    assert root.rate_hz == pytest.approx(AIRFRAME.root.rate_hz, rel=0.01)
    assert root.samples == pytest.approx(3.0 * AIRFRAME.root.rate_hz, rel=0.01)


def status(at_s: float, health: Health, reason: str = "") -> ServiceStatus:
    return ServiceStatus(round(at_s * S), health, reason)


def served(*statuses: ServiceStatus, samples_until_s: float) -> RecordingInfo:
    """Statuses of a service, and samples of the root up to a second."""
    info = RecordingInfo()
    for second in range(round(samples_until_s)):
        info.add(batch(Station.ROOT, second * S, 1000))
    for entry in statuses:
        info.add(entry)
    return info


ACTIVE = [status(second, Health.ACTIVE, "tracking") for second in range(5, 20)]
WARM_UP = [status(second, Health.STANDBY, "settling") for second in range(5)]
STOPPED = status(20.4, Health.CRITICAL, "stale")


def test_the_end_of_the_streams_is_no_state_of_the_service() -> None:
    info = served(*WARM_UP, *ACTIVE, STOPPED, samples_until_s=20.0)
    expected = "active 75 % of the time, first after 5.0 s; with the last samples active: tracking"
    assert info.service.summary() == expected
    assert info.service.answer().startswith("yes: active without a break after a warm-up of 5 s")
    assert info.service.answer().endswith("With the warm-up, active 75 % of the time")
    assert served(*WARM_UP, *ACTIVE, samples_until_s=20.0).service.summary() == expected, (
        "a file that is cut is the same"
    )


def test_samples_that_stop_long_before_the_recording_does_are_said() -> None:
    lost = [status(20.4 + second, Health.CRITICAL, "stale") for second in range(10)]
    service = served(*WARM_UP, *ACTIVE, *lost, samples_until_s=20.0).service
    assert (
        service.summary() == "active 50 % of the time, first after 5.0 s; no samples in the last 9.4 s: critical: stale"
    )
    assert service.answer().startswith(
        "not always: active 60 % of the time (else critical: stale (10 s)) after a warm-up"
    )


def test_a_machine_that_did_not_keep_up_was_not_well() -> None:
    info = served(*WARM_UP, *ACTIVE, samples_until_s=20.0)
    info.add(Notice(4, Overload("vision", "vision needs 1.7 s a second").sentence, 10 * S))
    assert info.service.answer().startswith("mostly: active without a break after a warm-up of 5 s")
    assert "; the machine could not keep up (said once)" in info.service.answer()
    for number in range(10):
        info.add(Shot(number, number * S, number * S))
    info.add(Rejected(Reject.FRAME_LOST, "left frames", 10 * S, 1))
    assert "never came" not in info.service.answer(), "one of twenty is little"
    info.add(Rejected(Reject.FRAME_LOST, "right frames", 10 * S, 4))
    assert "; 5 images of 10 shots never came. With the warm-up" in info.service.answer()


def test_a_service_that_never_was_active_says_so() -> None:
    assert served(*WARM_UP, samples_until_s=5.0).service.answer().startswith("no: it was never active")
    assert served(samples_until_s=5.0).service.answer() == "no status recorded"
    assert "never active" in served(*WARM_UP, samples_until_s=5.0).service.summary()
    first = status(5.4, Health.ACTIVE, "tracking")
    late = served(*WARM_UP, first, samples_until_s=5.0).service
    assert late.answer().startswith("no: it was never active"), "the end after the last sample is none of the flight's"
    assert late.first_active_s is None


def test_what_is_refused_after_the_last_sample_is_the_end_and_no_stopped_stream() -> None:
    ended, lost = (Rejected(Reject.STALE, "pair 4", round(at_s * S)) for at_s in (20.2, 12.0))
    info = served(*ACTIVE, STOPPED, samples_until_s=20.0)
    info.add(ended)
    assert info.refused() == {AT_THE_END: 1}
    info.add(lost)
    assert info.refused() == {AT_THE_END: 1, "stream stopped": 1}


@pytest.mark.parametrize(
    ("station", "sentence"),
    [
        (Station.ROOT, "not for spanwise diagnose, which needs samples of a wing tip"),
        (Station.LEFT, "spanwise diagnose (has wing sensors alone: without a root"),
    ],
)
def test_a_log_of_one_station_says_what_diagnose_can_make_of_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], station: Station, sentence: str
) -> None:
    writer = McapWriter(tmp_path / "one.mcap", About.of(AIRFRAME, Settings()))
    writer.write(batch(station, 0, 1000))
    writer.close()
    assert main(["info", str(tmp_path / "one.mcap")]) == 0
    assert sentence in capsys.readouterr().out
